"""Kalman filters of many environments at once.

A mean [n, d, c] has c columns, such as the axes of a position, that share one covariance [n, d, d]:
that saves c - 1 of them.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor


def transition(dt_s: float | Tensor, like: Float[Tensor, "..."]) -> Float[Tensor, "2 2"]:
    """F of a position and its velocity after a time."""
    one, zero = like.new_ones(()), like.new_zeros(())
    return torch.stack((torch.stack((one, one * dt_s)), torch.stack((zero, one))))


def white_acceleration(
    dt_s: float, deviation_mps2: float, like: Float[Tensor, "..."]
) -> Float[Tensor, "2 2"]:
    """Q of a position and its velocity, pushed by an acceleration that is drawn for each step.

    sa^2 [[dt^4/4, dt^3/2], [dt^3/2, dt^2]]: `Q_discrete_white_noise(2, dt, sa**2)` of filterpy.
    """
    half, whole = dt_s**2 / 2, dt_s
    rows = [[half * half, half * whole], [half * whole, whole * whole]]
    return deviation_mps2**2 * like.new_tensor(rows)


def predicted_covariance(
    covariance: Float[Tensor, "n d d"], step: Float[Tensor, "... d d"], noise: Float[Tensor, "..."]
) -> Float[Tensor, "n d d"]:
    """F P F^T + Q."""
    return step @ covariance @ step.mT + noise


def gain(
    covariance: Float[Tensor, "n d d"],
    observed: Float[Tensor, "m d"],
    noise: Float[Tensor, "m m"],
) -> tuple[Float[Tensor, "n d m"], Float[Tensor, "n m m"]]:
    """K = P H^T S^-1, and S = H P H^T + R."""
    crossed = covariance @ observed.mT
    spread = observed @ crossed + noise
    if spread.shape[-1] == 1:
        return crossed / spread, spread
    return torch.linalg.solve(spread, crossed, left=False), spread


def corrected(
    mean: Float[Tensor, "n d c"],
    covariance: Float[Tensor, "n d d"],
    *,
    innovation: Float[Tensor, "n m c"],
    observed: Float[Tensor, "m d"],
    noise: Float[Tensor, "m m"],
    used: Bool[Tensor, "n 1"],
    gate: float | None = None,
) -> tuple[Float[Tensor, "n d c"], Float[Tensor, "n d d"]]:
    """Mean and covariance after a measurement, where it is `used`.

    x + K y;  P = (I - K H) P (I - K H)^T + K R K^T, the form of Joseph, which stays symmetric and
    positive whatever the gain.

    Args:
        mean: x.
        covariance: P.
        innovation: y = z - H x.
        observed: H.
        noise: R.
        used: Rows whose measurement has arrived.
        gate: Measurements with y^T S^-1 y, summed over the columns, above its square are dropped.
    """
    weight, spread = gain(covariance, observed, noise)
    if gate is not None:
        used = used & (surprise(innovation, spread) <= gate**2)
    rest = torch.eye(mean.shape[1], dtype=mean.dtype, device=mean.device) - weight @ observed
    after = rest @ covariance @ rest.mT + weight @ noise @ weight.mT
    taken = used.unsqueeze(-1)
    return (
        torch.where(taken, mean + weight @ innovation, mean),
        torch.where(taken, after, covariance),
    )


def surprise(
    innovation: Float[Tensor, "n m c"], spread: Float[Tensor, "n m m"]
) -> Float[Tensor, "n 1"]:
    """y^T S^-1 y, summed over the columns: chi-square with m c degrees of freedom."""
    if spread.shape[-1] == 1:
        return (innovation.square() / spread).sum((-2, -1)).unsqueeze(-1)
    scaled = torch.linalg.solve(spread, innovation)
    return (innovation * scaled).sum((-2, -1)).unsqueeze(-1)
