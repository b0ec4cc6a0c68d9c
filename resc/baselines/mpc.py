"""Model predictive control: a point mass along the searched path, again and again."""

import time

import numpy as np
import torch
from jaxtyping import Bool, Float
from tensordict import TensorDictBase
from torch import Tensor

from resc import keys
from resc.baselines.mpc_flight import MpcFlight, Obstacles
from resc.baselines.mpc_programme import MassPoint, Programme, Weights
from resc.baselines.scene_cells import array, standing
from resc.baselines.tracker import Reference, Tracker
from resc.envs.stages import Stages, World
from resc.errors import ConfigError
from resc.flying.cascade import require_body_rates
from resc.flying.pilot import Pilot, PlanningCall
from resc.quantities import Count, NotNegative, Positive

ARRIVED_M = 0.5
"""To the goal: what the pilot measures itself ends there, as all clocks."""


class Mpc(Pilot):
    """Plans the next `steps * step_s` seconds every `step_s`, and follows by the tracker.

    The horizon is drawn along the straight lines from the start through the control points, each of
    its steps to a point `lookahead_m` further than it was expected to come, within limits on the
    norms of speed, acceleration and jerk, and in half-planes that keep `margin_m` from the
    obstacles. All obstacles of the scene are known. A plan goes on from the last one, or from where
    the vehicle is if that is more than `restart_m` away. The height is that of the next control
    point.

    Args:
        speed_mps: Limit of the speed.
        acceleration_mps2: Limit of the acceleration.
        jerk_mps3: Limit of the jerk.
        margin_m: Kept from obstacles at `POINTS` points of every step.
        steps: Of the horizon.
        step_s: A step of the horizon, a multiple of the control step.
        lookahead_m: How far each step is drawn on.
        beside_m: Greatest distance to the straight lines, whose control points are to be passed.
        along: Price of being short of that.
        across: Price of being beside the path.
        jerk: Price of the jerk.
        restart_m: Distance from the plan at which it is given up.
        tracker: Follows the plan.
    """

    def __init__(
        self,
        *,
        speed_mps: Positive = 2.95,
        acceleration_mps2: Positive = 5.8,
        jerk_mps3: Positive = 20.0,
        margin_m: NotNegative = 0.34,
        steps: Count = 15,
        step_s: Positive = 0.1,
        lookahead_m: Positive = 0.5,
        beside_m: Positive = 0.6,
        along: Positive = 1.0,
        across: Positive = 0.05,
        jerk: Positive = 1e-3,
        restart_m: Positive = 0.2,
        tracker: Tracker | None = None,
    ) -> None:
        self.numbers = {name: value for name, value in locals().items() if name != "self"}
        self.programme = Programme(
            steps=steps,
            step_s=step_s,
            speed_mps=speed_mps,
            acceleration_mps2=acceleration_mps2,
            jerk_mps3=jerk_mps3,
            beside_m=beside_m,
            weights=Weights(along=along, across=across, jerk=jerk),
        )
        self.step_s = step_s
        self.margin_m = margin_m
        self.lookahead_m = lookahead_m
        self.restart_m = restart_m
        self.tracker = tracker or Tracker()

    def facts(self) -> dict[str, str]:
        """Its numbers."""
        return {name: str(value) for name, value in self.numbers.items()}

    def check(self, stages: Stages) -> None:
        """Raises ConfigError if it cannot act there, or plans between two control steps."""
        require_body_rates(stages, self.name)
        every = self.step_s / stages.context.dt_s
        if every < 1 or abs(every - round(every)) > 1e-6:
            raise ConfigError(
                f"pilot.{self.name}.step_s is {self.step_s:g}; expected a multiple of env.dt_s, "
                f"{stages.context.dt_s:g}."
            )

    def begin(self, flights: int, stages: Stages, maps: World) -> None:
        """Takes the maps; where the flights begin is known when they do."""
        self.check(stages)
        if maps[keys.MOVERS_W].shape[1]:
            raise ConfigError(
                f"pilot.{self.name} knows no obstacles that move; fly scenes without movers."
            )
        self.maps = maps
        self.dt_s = stages.context.dt_s
        self.every = round(self.step_s / self.dt_s)
        self.cascade = self.tracker.cascade(stages)
        self.flights: list[MpcFlight] = []
        self.planned: list[PlanningCall] = []
        self.energy = np.zeros(flights)
        self.errors = np.zeros((flights, 2))  # sum of squares, number
        self.steps = 0

    def act(self, world: TensorDictBase, observation: Float[Tensor, "n d"]) -> Float[Tensor, "n 4"]:
        """Plans where a step of the horizon is over, and follows the plan."""
        moving = (keys.POSITION_W, keys.VELOCITY_W, keys.ACCELERATION_W)
        states = [array(world, key)[:, :2] for key in moving]
        if self.steps == 0:
            self.flights = self._take_off(world)
        going = array(world, keys.CLOCK)[:, 0] == self.steps
        if self.steps % self.every == 0:
            passed = array(world, keys.ROUTE_INDEX)[:, 0].astype(int)
            for row in np.flatnonzero(going).tolist():
                self.flights[row].next = int(passed[row]) + 1
                self._plan(row, MassPoint(*(column[row] for column in states)))
        since = (self.steps % self.every) * self.dt_s
        asked = [self._asked(flight, since) for flight in self.flights]
        reference = np.stack(asked).astype(np.float32)  # [n, 4, 2]
        self._measure(world, states[0], reference, going)
        self.steps += 1
        return self._follow(world, torch.from_numpy(reference).to(world[keys.POSITION_W].device))

    def measured(self) -> dict[str, Float[Tensor, " n"]]:
        """Of every flight: the energy of what was planned, and how far off it was (RMS)."""
        squares, steps = self.errors.T
        return {
            "planned_energy": torch.from_numpy(self.energy).float(),
            "tracking_error": torch.from_numpy(np.sqrt(squares / steps.clip(min=1))).float(),
        }

    def calls(self) -> list[PlanningCall]:
        """All programmes solved."""
        return self.planned

    def _take_off(self, world: TensorDictBase) -> list[MpcFlight]:
        start = world[keys.POSITION_W][:, None, :2]
        paths = torch.cat((start, world[keys.ROUTE_W][:, :, :2]), 1).double().cpu().numpy()
        lengths = array(world, keys.ROUTE_LENGTH)[:, 0].astype(int).tolist()
        entries = array(world, keys.SCENE_INDEX)[:, 0].astype(int).tolist()
        return [
            MpcFlight(
                self.programme,
                Obstacles(*standing(self.maps, entry)),
                path[: max(length, 1) + 1],
                margin_m=self.margin_m,
                lookahead_m=self.lookahead_m,
            )
            for path, length, entry in zip(paths, lengths, entries, strict=True)
        ]

    def _plan(self, row: int, state: MassPoint) -> None:
        flight = self.flights[row]
        expected, _ = flight.after(self.step_s)
        missed = float(np.linalg.norm(expected.position - state.position))
        lost = flight.first or missed > self.restart_m
        began = time.perf_counter()
        solved = flight.renew(state if lost else expected)
        failed = "" if solved else "programme: the solver found no solution; the last plan goes on."
        now = self.steps * self.dt_s
        self.planned.append(PlanningCall(row, now, time.perf_counter() - began, failed))

    def _asked(self, flight: MpcFlight, since: float) -> Float[np.ndarray, "4 2"]:
        (position, velocity, _), _ = flight.after(since)
        later, jerk = flight.after(since + self.tracker.ahead_s)
        return np.stack((position, velocity, later.acceleration, jerk))

    def _measure(
        self,
        world: TensorDictBase,
        position: Float[np.ndarray, "n 2"],
        asked: Float[np.ndarray, "n 4 2"],
        going: Bool[np.ndarray, " n"],
    ) -> None:
        goal = array(world, keys.ROUTE_W)[:, -3:-1]
        counts = going & (np.linalg.norm(position - goal, axis=1) > ARRIVED_M)
        self.energy += counts * np.square(asked[:, 3]).sum(1) * self.dt_s
        self.errors[:, 0] += counts * np.square(asked[:, 0] - position).sum(1)
        self.errors[:, 1] += counts

    def _follow(self, world: TensorDictBase, asked: Float[Tensor, "n 4 2"]) -> Float[Tensor, "n 4"]:
        position, velocity = world[keys.POSITION_W], world[keys.VELOCITY_W]
        height = world[keys.CONTROL_POINTS_W][:, 0, 2:]
        flat = torch.zeros_like(height)
        parts = zip(asked.unbind(1), (height, flat, flat, flat), strict=True)
        reference = Reference(*(torch.cat(part, -1) for part in parts))
        state = (position, velocity, world[keys.ATTITUDE_WB])
        return self.tracker.action(self.cascade, state, reference)
