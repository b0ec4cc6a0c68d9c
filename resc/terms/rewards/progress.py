"""Progress toward the control point's column."""

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.math.geometry import EPSILON, distance
from resc.quantities import Number, Positive
from resc.term import Context, Reward


class Progress(Reward):
    """Distance to the control point's column closed in a step, over the longest possible one [-].

    r = (|p_in - p_prev| - |p_in - p|) / (v_max dt), p_in where the ray from p_prev through p enters
    the column of the control point aimed at, else the control point itself (2025 paper, eq. 7; its
    time penalty is the term `time`). With `column_radius_m: null` p_in is always the control point
    (2024 paper).
    """

    reads = (keys.POSITION_W, keys.previous(keys.POSITION_W), keys.TARGET_W)

    def __init__(
        self,
        *,
        weight: Number,
        speed_mps: Positive = 3.0,
        column_radius_m: Positive | None = 0.5,
        column_half_height_m: Positive = 0.2,
    ) -> None:
        super().__init__(weight=weight)
        if speed_mps <= 0:
            raise ConfigError(f"speed_mps is {speed_mps}; expected a number above zero.")
        self.speed_mps = speed_mps
        self.column_radius_m = column_radius_m
        self.column_half_height_m = column_half_height_m

    def bind(self, context: Context) -> None:
        """Takes the control period."""
        self.longest_m = self.speed_mps * context.dt_s

    def compute(
        self,
        position: Float[Tensor, "n 3"],
        previous: Float[Tensor, "n 3"],
        target: Float[Tensor, "n 3"],
    ) -> Float[Tensor, "n 1"]:
        radius = self.column_radius_m
        aim = (
            target if radius is None else self._entry(previous, position - previous, target, radius)
        )
        return (distance(aim, previous) - distance(aim, position)) / self.longest_m

    def _entry(
        self,
        start: Float[Tensor, "n 3"],
        step: Float[Tensor, "n 3"],
        target: Float[Tensor, "n 3"],
        radius_m: float,
    ) -> Float[Tensor, "n 3"]:
        """Where start + t step, t >= 0, enters the column around `target`, else `target` [m]."""
        offset = start - target
        radius_squared = radius_m**2
        a = step[:, :2].square().sum(-1) + EPSILON
        b = (offset[:, :2] * step[:, :2]).sum(-1)
        c = offset[:, :2].square().sum(-1) - radius_squared
        discriminant = b * b - a * c
        side = (-b - discriminant.clamp(min=0).sqrt()) / a
        height_at_side = offset[:, 2] + side * step[:, 2]
        hits_side = (
            (discriminant >= 0) & (side >= 0) & (height_at_side.abs() <= self.column_half_height_m)
        )
        rise = step[:, 2]
        level = torch.where(rise.abs() < 1e-6, 1e-6, rise)
        cap = (torch.sign(offset[:, 2]) * self.column_half_height_m - offset[:, 2]) / level
        at_cap = offset[:, :2] + cap.unsqueeze(-1) * step[:, :2]
        outside_band = offset[:, 2].abs() > self.column_half_height_m
        hits_cap = outside_band & (cap >= 0) & (at_cap.square().sum(-1) <= radius_squared)
        time = torch.where(hits_side, side, cap).unsqueeze(-1)
        return torch.where((hits_side | hits_cap).unsqueeze(-1), start + time * step, target)
