"""The gyroscope that a rate loop flies by."""

from jaxtyping import Float, Int64
from torch import Tensor

from resc.math import stream
from resc.math.sampling import gaussian


def reading(
    body_rate: Float[Tensor, "n 3"],
    bias: Float[Tensor, "n 3"],
    noise: Float[Tensor, "n 1"],
    place: Int64[Tensor, "n 3"],
) -> tuple[Float[Tensor, "n 3"], Int64[Tensor, "n 3"]]:
    """What it reads [rad/s], and where the sequences of its noise stand afterwards.

    w + b + s z: a constant bias and white noise. The noise comes from the state, not from draws
    of the step, so that a replay moves the vehicle as it moved.
    """
    error = bias + noise * gaussian(stream.uniform(place))
    return body_rate + error, stream.following(place)
