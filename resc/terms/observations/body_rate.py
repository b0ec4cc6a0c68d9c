"""Angular velocity in the body frame."""

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.term import Observation


class BodyRate(Observation):
    """Body rates p, q, r [rad/s] (facts 3, 8-10)."""

    reads = (keys.BODY_RATE_B,)
    units = ("rad/s",)
    frame = "body"
    columns = ("p", "q", "r")

    def compute(self, body_rate: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        return body_rate
