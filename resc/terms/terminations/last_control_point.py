"""Reaching the goal."""

from jaxtyping import Bool
from torch import Tensor

from resc import keys
from resc.term import Termination


class LastControlPoint(Termination):
    """The last control point has been passed: the episode succeeded."""

    reads = (keys.FINISHED,)
    success = True

    def compute(self, finished: Bool[Tensor, "n 1"]) -> Bool[Tensor, "n 1"]:
        return finished
