"""The protocol of a planner: one flight of one vehicle, from the obstacles to what it commands."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

TICK_S = 0.01
"""Between two ticks of a planner's state machine: 100 Hz."""
SENSING_TICKS = 5
"""From one look at the obstacles and at the way ahead to the next: 20 Hz."""
ENDED_S = 0.01
"""Before its end a trajectory is over."""
NOTHING = np.zeros(3)


class State(NamedTuple):
    """Where a vehicle is or is to be, in the world.

    Args:
        position: [m].
        velocity: [m/s].
        acceleration: [m/s^2], without gravity.
        jerk: [m/s^3]; zero where it is not known, as of a vehicle's own state.
    """

    position: Float[np.ndarray, "3"]
    velocity: Float[np.ndarray, "3"]
    acceleration: Float[np.ndarray, "3"]
    jerk: Float[np.ndarray, "3"] = NOTHING


def at_rest(position: Float[np.ndarray, "3"]) -> State:
    """Standing still there [m]."""
    return State(position, NOTHING, NOTHING)


class Plan(NamedTuple):
    """One call of a planner, successful or not.

    Args:
        time_s: When, on the clock of the flight.
        took_s: What it took on the clock of the computer; the clock of the flight stands still.
        failed: The stage that failed and why, one sentence; empty if none did.
    """

    time_s: float
    took_s: float
    failed: str = ""


class Planner(ABC):
    """Plans one flight again and again while it is flown.

    `begin` starts a flight at time 0. Then come, in ascending order and every `TICK_S`, `tick` with
    what the vehicle does and `commanded` with what it is to do, which may also be asked for times
    between two ticks. Threads may fly several planners, each its own.
    """

    plans: list[Plan]
    """All calls of this flight in their order."""
    finished: bool
    """Whether the last trajectory has been flown to its end, and no other will follow."""

    def facts(self) -> dict[str, str]:
        """Its numbers, words and switches, and those of its parts, for a report of what flew."""
        return dict(_told(self))

    @abstractmethod
    def begin(
        self,
        obstacles: Float[np.ndarray, "k 3"],
        start_w: Float[np.ndarray, "3"],
        goal_w: Float[np.ndarray, "3"],
    ) -> None:
        """Takes up a flight and forgets the last.

        Args:
            obstacles: Centres [m] of the occupied cells, columns over the whole flight height. The
                planner sees of them what its own sensor shows.
            start_w: Where the vehicle hovers [m].
            goal_w: Where it is to go [m].
        """

    @abstractmethod
    def tick(self, time_s: float, odometry: State) -> None:
        """Does whatever is due: senses, looks whether the trajectory is safe, plans.

        Args:
            time_s: Since `begin`, a multiple of `TICK_S`.
            odometry: What the vehicle does; its jerk is not read.
        """

    @abstractmethod
    def commanded(self, time_s: float) -> State:
        """What the vehicle is to do at this time, by the trajectory known since the last tick.

        It hovers at the start before the first plan, at the end of a trajectory, and where the
        planner told it to stop.
        """


def _told(part: object, before: str = "") -> Iterator[tuple[str, str]]:
    """The attributes of an object by their names, those of its parts by dotted ones."""
    fields = part._asdict() if isinstance(part, tuple) else vars(part)  # pyright: ignore
    for name, value in fields.items():
        if name in ("plans", "finished"):
            continue
        if isinstance(value, bool | int | float | str | None):
            yield f"{before}{name}", f"{value:g}" if isinstance(value, float) else str(value)
        elif type(value) is tuple:
            yield f"{before}{name}", str(value)
        elif hasattr(value, "_asdict") or type(value).__module__.startswith("resc."):
            yield from _told(value, f"{before}{name}.")
