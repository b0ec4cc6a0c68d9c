"""Two pilots, one of them near obstacles."""

from collections.abc import Mapping
from typing import Any

import torch
from jaxtyping import Float
from tensordict import TensorDictBase
from torch import Tensor

from resc import keys
from resc.envs.stages import Stages, World
from resc.errors import ConfigError
from resc.flying.pilot import Pilot
from resc.maps.distance_field import select
from resc.math.polyline import distances_along, points_along
from resc.quantities import NotNegative, Positive

NEAR, CLEAR = "near", "clear"


class Switch(Pilot):
    """`near` flies where obstacles are near the way ahead, `clear` anywhere else.

    The way are the straight lines to the next two control points, at most `ahead_m` of them.
    Obstacles are near once the distance field falls below `below_m` somewhere on it, and until it
    is at least `below_m + hysteresis_m` everywhere. Both papers fly one policy among obstacles and
    another in free space, and neither says when they change: the rule is ours.

    Both pilots act at every step, so that what either remembers of a flight is whole.

    Args:
        pilots: The two, by the names `near` and `clear`.
        below_m: Distance to an obstacle below which it is near.
        hysteresis_m: By which it must exceed that again.
        ahead_m: Length of the way that is looked at.
    """

    def __init__(
        self,
        *,
        pilots: Mapping[str, Any],
        below_m: Positive = 1.0,
        hysteresis_m: NotNegative = 0.2,
        ahead_m: Positive = 5.0,
    ) -> None:
        if set(pilots) != {NEAR, CLEAR}:
            raise ConfigError(
                f"pilots are {', '.join(pilots)}; expected two of them, {NEAR} and {CLEAR}."
            )
        for name, pilot in pilots.items():
            if not isinstance(pilot, Pilot):
                raise ConfigError(
                    f"pilots.{name} is a {type(pilot).__name__}, which is not a Pilot."
                )
        self.pilots = pilots
        self.below_m = below_m
        self.hysteresis_m = hysteresis_m
        self.ahead_m = ahead_m

    def named(self, name: str) -> Pilot:
        """Gives both pilots their names, too."""
        for own, pilot in self.pilots.items():
            pilot.named(f"{name}.pilots.{own}")
        return super().named(name)

    def check(self, stages: Stages) -> None:
        """Raises a RescError if one of the two cannot fly such an environment."""
        for pilot in self.pilots.values():
            pilot.check(stages)

    def begin(self, flights: int, stages: Stages, maps: World) -> None:
        """Begins with obstacles that are near only where they are below the lower distance."""
        for pilot in self.pilots.values():
            pilot.begin(flights, stages, maps)
        self.maps = maps
        self.cell_m = stages.context.resolution_m
        self.near = torch.zeros(flights, 1, dtype=torch.bool, device=maps[keys.ESDF].device)

    def act(self, world: TensorDictBase, observation: Float[Tensor, "n d"]) -> Float[Tensor, "n a"]:
        """The action of one of the two, each flight for itself."""
        clearance = self._clearance_ahead(world)
        self.near = clearance < torch.where(
            self.near, self.below_m + self.hysteresis_m, self.below_m
        )
        near, clear = (self.pilots[name].act(world, observation) for name in (NEAR, CLEAR))
        return torch.where(self.near, near, clear)

    def facts(self) -> dict[str, str]:
        """Its numbers, and the facts of both."""
        own = {name: f"{getattr(self, name):g}" for name in ("below_m", "hysteresis_m", "ahead_m")}
        parts = {
            f"{name}.{key}": value
            for name, pilot in self.pilots.items()
            for key, value in pilot.facts().items()
        }
        return own | parts

    def _clearance_ahead(self, world: TensorDictBase) -> Float[Tensor, "n 1"]:
        """Least distance to an obstacle [m] on the way ahead, looked up once a cell."""
        position = world[keys.POSITION_W]
        line = torch.cat((position.unsqueeze(1), world[keys.CONTROL_POINTS_W]), 1)
        count = int(self.ahead_m / self.cell_m) + 2
        wanted = torch.linspace(0, self.ahead_m, count, device=position.device)
        wanted = wanted.expand(len(position), -1)
        points = points_along(line, distances_along(line), wanted)
        field = select(
            self.maps[keys.ESDF],
            world[keys.SCENE_INDEX],
            self.maps[keys.MAP_ORIGIN_W],
            self.maps[keys.MAP_SIZE],
            self.cell_m,
        )
        return field.at(points[..., 0].T, points[..., 1].T).amin(0).unsqueeze(-1)
