"""The obstacles that move, the nearest first."""

from typing import Unpack

import torch
from jaxtyping import Float, Int
from torch import Tensor

from resc import keys
from resc.maps.movers import distances, motion
from resc.quantities import Count, Positive
from resc.sights import Pose, Shape
from resc.term import Context, Observation, ObservationOptions


class NearestMovers(Observation):
    """Where the nearest movers are, how they move, and how large they are, five numbers for each.

    With d the distance to the surface and c = max(0, 1 - d / range) its closeness: c times the unit
    vector to the centre [-], c times the velocity relative to the vehicle [m/s], and c times half
    the longer edge [m]. So all of them grow as a mover comes nearer, and begin at zero where it
    comes into range: a mover beyond it is not told from none. World-aligned, as a tracker without
    errors would tell it that sees through obstacles.

    Args:
        number: Movers told.
        range_m: How far it sees.
        **options: Of every observation.
    """

    reads = (keys.POSITION_W, keys.VELOCITY_W, keys.CLOCK, keys.SCENE_INDEX, keys.MOVERS_W)
    numbers = ("to_x", "to_y", "velocity_x", "velocity_y", "size")

    def __init__(
        self, *, number: Count = 3, range_m: Positive = 5.0, **options: Unpack[ObservationOptions]
    ) -> None:
        super().__init__(**options)
        self.number = number
        self.range_m = range_m
        self.columns = tuple(f"mover_{i}_{name}" for i in range(number) for name in self.numbers)
        self.units = ("-", "-", "m/s", "m/s", "m") * number

    def bind(self, context: Context) -> None:
        """Takes the control period."""
        self.dt_s = context.dt_s

    def compute(
        self,
        position: Float[Tensor, "n 3"],
        velocity: Float[Tensor, "n 3"],
        clock: Float[Tensor, "n 1"],
        index: Int[Tensor, "n 1"],
        movers: Float[Tensor, "p o 10"],
    ) -> Float[Tensor, "n c"]:
        told = min(self.number, movers.shape[1])
        none = position.new_zeros(len(position), 5 * (self.number - told))
        if not told:
            return none
        own, here = movers[index[:, 0]], position[:, :2]
        centre, moving = motion(own, clock * self.dt_s)
        distance, nearest = distances(here, own, centre).topk(told, largest=False)
        pick = nearest.unsqueeze(-1).expand(-1, -1, 2)
        offset = centre.gather(1, pick) - here.unsqueeze(1)
        toward = offset / torch.linalg.vector_norm(offset, dim=-1, keepdim=True).clamp(min=1e-6)
        relative = moving.gather(1, pick) - velocity[:, None, :2]
        size = own[..., 4:6].amax(-1).gather(1, nearest).unsqueeze(-1)
        closeness = (1 - distance / self.range_m).clamp(0, 1).unsqueeze(-1)
        block = closeness * torch.cat((toward, relative, size), -1)  # [n, told, 5]
        return torch.cat((block.flatten(1), none), -1)

    def sights(self, numbers: Float[Tensor, "t c"], pose: Pose) -> list[Shape]:
        """A line to the surface of each mover in range."""
        to, _, _ = numbers.unflatten(-1, (self.number, 5)).split((2, 2, 1), -1)
        closeness = torch.linalg.vector_norm(to, dim=-1, keepdim=True)
        far = self.range_m * (1 - closeness)
        there = pose.position.unsqueeze(1) + far * to / closeness
        return [Shape("movers", "rays", "ray", there.where(closeness > 0, torch.nan))]
