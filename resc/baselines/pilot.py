"""Planners as pilots: one for every flight, its trajectory flown by a controller or perfectly."""

import copy
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from tensordict import TensorDictBase
from torch import Tensor

from resc import keys
from resc.baselines.perfect import rehearse
from resc.baselines.perfect_tracking import PARTS, placing
from resc.baselines.planned_flight import PlannedFlight
from resc.baselines.planner import TICK_S, Planner, State
from resc.baselines.scene_cells import array, obstacle_cells
from resc.baselines.tracker import Reference, Tracker
from resc.envs.stages import Stages, World
from resc.errors import ConfigError
from resc.flying.cascade import require_body_rates
from resc.flying.pilot import Pilot, PlanningCall
from resc.quantities import Positive

CONTROLLER, PERFECT = "controller", "perfect"


class PlannerPilot(Pilot):
    """Flies the trajectories of a planner, which finds its own way to the goal.

    Args:
        planner: Copied for every flight.
        tracking: `controller`, by body rates and thrust; `perfect`, the vehicle put where the
            trajectory is; or both, as two pilots.
        tracker: The controller.
        patience_s: A planner that fails for so long while the vehicle hovers is given up.
    """

    finds_its_way = True

    def __init__(
        self,
        *,
        planner: object,
        tracking: Sequence[str] = (CONTROLLER,),
        tracker: Tracker | None = None,
        patience_s: Positive = 5.0,
    ) -> None:
        if not isinstance(planner, Planner):
            raise ConfigError(f"planner is a {type(planner).__name__}, which is not a Planner.")
        wrong = [name for name in tracking if name not in (CONTROLLER, PERFECT)]
        if wrong or not tracking or len(set(tracking)) < len(tracking):
            raise ConfigError(
                f"tracking is {list(tracking)}; expected [controller], [perfect] or both."
            )
        self.planner = planner
        self.tracking = tuple(tracking)
        self.tracker = tracker or Tracker()
        self.patience_s = patience_s
        self.perfect = self.tracking == (PERFECT,)
        self.flights: list[PlannedFlight] = []

    def variants(self) -> Sequence[Pilot]:
        """One pilot for each way to follow its trajectories."""
        return [self._by(name) for name in self.tracking]

    def _by(self, tracking: str) -> "PlannerPilot":
        variant = copy.copy(self)
        variant.tracking, variant.perfect = (tracking,), tracking == PERFECT
        variant.name = f"{self.name}_{tracking}" if len(self.tracking) > 1 else self.name
        return variant

    @property
    def parts(self) -> Mapping[str, Any]:
        """An action and dynamics that put the vehicle where the trajectory is."""
        return PARTS if self.perfect else {}

    def facts(self) -> dict[str, str]:
        """What plans, its numbers, and what follows."""
        return {
            "planner": type(self.planner).__name__,
            **self.planner.facts(),
            "tracking": self.tracking[0],
            "patience_s": f"{self.patience_s:g}",
            **({} if self.perfect else {"tracker": str(self.tracker)}),
        }

    def check(self, stages: Stages) -> None:
        """Raises ConfigError if the control steps hold no whole number of ticks."""
        if not self.perfect:
            require_body_rates(stages, self.name)
        ticks = stages.context.dt_s / TICK_S
        if abs(ticks - round(ticks)) > 1e-6:
            raise ConfigError(
                f"env.dt_s is {stages.context.dt_s:g}, but pilot.{self.name} plans every "
                f"{TICK_S:g} s; set a multiple of that."
            )

    def require_still(self, movers: Float[Tensor, "p o 10"]) -> None:
        """Raises ConfigError if there are obstacles that move."""
        if movers.shape[1]:
            raise ConfigError(
                f"pilot.{self.name} knows no obstacles that move; fly scenes without movers."
            )

    def begin(self, flights: int, stages: Stages, maps: World) -> None:
        """Takes a copy of the planner for every flight; where they begin is known when they do."""
        self.check(stages)
        self.require_still(maps[keys.MOVERS_W])
        rehearse(copy.deepcopy(self.planner))
        self.maps = maps
        self.cells: dict[bytes, Float[np.ndarray, "k 3"]] = {}
        ahead_s, patience_s = 0.0 if self.perfect else self.tracker.ahead_s, self.patience_s
        self.dt_s = stages.context.dt_s
        self.flights = [
            PlannedFlight(copy.deepcopy(self.planner), self.dt_s, self.perfect, ahead_s, patience_s)
            for _ in range(flights)
        ]
        self.cascade = None if self.perfect else self.tracker.cascade(stages)
        self.steps = 0

    def act(self, world: TensorDictBase, observation: Float[Tensor, "n d"]) -> Float[Tensor, "n a"]:
        """Plans what is due in every flight that goes on, and follows."""
        position, velocity = world[keys.POSITION_W], world[keys.VELOCITY_W]
        if self.steps == 0:
            self._take_off(world)
        going = np.flatnonzero(array(world, keys.CLOCK)[:, 0] == self.steps).tolist()
        moving = (keys.POSITION_W, keys.VELOCITY_W, keys.ACCELERATION_W)
        states = [array(world, key) for key in moving]
        time_s = self.steps * self.dt_s

        def advance(row: int) -> None:
            self.flights[row].advance(time_s, State(*(column[row] for column in states)))

        with ThreadPoolExecutor(torch.get_num_threads()) as pool:
            list(pool.map(advance, going))
        self.steps += 1
        asked = np.stack([flight.asked for flight in self.flights])
        reference = Reference(*torch.from_numpy(asked).to(position.device).unbind(1))
        if self.cascade is None:
            moved = (reference.position - position.double()).float()
            return placing(moved, reference.velocity.float(), reference.acceleration.float())
        reference = Reference(*(part.float() for part in reference))
        state = (position, velocity, world[keys.ATTITUDE_WB])
        return self.tracker.action(self.cascade, state, reference)

    def measured(self) -> Mapping[str, Float[Tensor, " n"]]:
        """Of every flight: the energy of its trajectories, and how far off them it was (RMS)."""
        energy = torch.tensor([flight.energy_m2ps5 for flight in self.flights])
        error = torch.tensor([flight.error_m for flight in self.flights])
        return {"planned_energy": energy, "tracking_error": error}

    def calls(self) -> Sequence[PlanningCall]:
        """All calls of the planners."""
        return [
            PlanningCall(row, *plan)
            for row, flight in enumerate(self.flights)
            for plan in flight.planner.plans
        ]

    def _take_off(self, world: TensorDictBase) -> None:
        start, goal = array(world, keys.POSITION_W), array(world, keys.ROUTE_W)[:, -3:]
        entries = array(world, keys.SCENE_INDEX)[:, 0].astype(int).tolist()
        for row, flight in enumerate(self.flights):
            cells = obstacle_cells(self.maps, entries[row], self.cells)
            flight.begin(cells, start[row], goal[row])
