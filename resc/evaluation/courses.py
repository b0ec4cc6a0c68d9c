"""What is flown: the scenes of the list, laid out and planned, one entry per flight."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from resc.errors import ConfigError
from resc.evaluation.suites import Amount
from resc.maps.cells import require_room
from resc.math.sampling import generator_for, uniform
from resc.planning.route import RoutePlanner
from resc.scenes.layout import Layout, Scene, concatenate, rows, sampled
from resc.scenes.random_maps import RandomMaps
from resc.setup import scene_of

TYPICAL_CELL_M = 0.1
"""Edge of a map cell where no planner tells it."""
TRIES = 100
"""How often a map is drawn before its scene is given up."""


@dataclass(frozen=True)
class Course:
    """One scene of the list with a start and a route for every flight.

    `planned_m` is the polyline of each flight, `nominal_w` its start without the jitter.
    `own_routes`: the scene laid the routes out itself,
    so its flights obey the task and the terminations of the training; all others lead from rest to
    the goal of a planned path. `number` tells which map a flight is on; `redrawn` how many maps had
    no route and were drawn again, None of a scene that draws none. `led_out` says of how many
    flights the start or the goal is within the clearance of the search, if any.
    """

    name: str
    layout: Layout
    nominal_w: Float[Tensor, "p 3"]
    planned_m: Sequence[Float[np.ndarray, "_ 2"]]
    own_routes: bool
    number: Int[np.ndarray, " p"]
    redrawn: int | None = None
    led_out: str = ""

    def __len__(self) -> int:
        return len(self.layout)

    @property
    def planned_lengths_m(self) -> Float[np.ndarray, " f"]:
        """Length of the polyline of each flight [m]."""
        steps = [np.diff(line, axis=0) for line in self.planned_m]
        return np.array([np.hypot(*step.T).sum() for step in steps])

    def to_the_goal(self) -> "Course":
        """The same for a pilot that finds its own way: the goal is its only control point."""
        layout = self.layout
        route = layout.route_w[:, -1:]
        one = torch.ones_like(layout.route_length)
        return replace(self, layout=replace(layout, route_w=route, route_length=one))

    @property
    def one_map(self) -> bool:
        """Whether all flights share their obstacles."""
        return self.maps == 1

    @property
    def maps(self) -> int:
        """How many maps there are."""
        return len(np.unique(self.number))


def lay_out(
    scenes: Mapping[str, Mapping[str, Any]],
    amounts: Mapping[str, Amount] | int,
    *,
    seed: int,
    planner: RoutePlanner | None,
    allowed: Iterable[str] = (),
) -> list[Course]:
    """The courses of a list of scene configurations.

    Every scene draws from a generator of its own, so adding one to the list leaves the others as
    they were.

    Args:
        scenes: Configurations by name.
        amounts: How often each is flown; a number is so many flights of each.
        seed: Of maps and starts.
        planner: Fills in routes.
        allowed: Prefixes of `_target_` outside resc that may be built.

    Raises:
        ConfigError: No scene, less than one flight, no planner for a scene that needs one, or maps
            that never have a route.
        PlanningError: A flight has no path.
    """
    if not scenes:
        raise ConfigError("scenes is empty; name at least one file of conf/scene.")
    if isinstance(amounts, int):
        amounts = dict.fromkeys(scenes, Amount(amounts))
    courses = []
    for name, node in scenes.items():
        led_out = ""
        drawing = {"seed": seed, "planner": planner, "allowed": allowed}
        maps = drawn(name, node, amounts[name], **drawing)
        layout = maps.layout
        own_routes = bool((layout.route_length > 0).all())
        if own_routes:
            planned = _lines(layout)
        elif planner is None:
            raise _needs_search(name)
        else:
            layout = planner(layout, name)
            planned = [path.points_m for path in planner.paths]
            led_out = _led_out(name, planner)
        course = Course(
            name, layout, maps.nominal_w, planned, own_routes, maps.number, maps.redrawn, led_out
        )
        courses.append(course)
    return courses


def _led_out(name: str, planner: RoutePlanner) -> str:
    """What to say of routes whose ends keep less than the clearance; nothing if all keep it."""
    count = sum(path.snapped for path in planner.paths)
    if not count:
        return ""
    return (
        f"{name}: {count} of {len(planner.paths)} routes begin or end within the clearance of the "
        f"search, {planner.search.clearance_m:g} m, and lead out of it first, past obstacles "
        "nearer than that; lower search.clearance_m, or move start or goal."
    )


@dataclass(frozen=True)
class Drawn:
    """The flights of a scene before they are planned.

    `number` is each flight's map; `redrawn` how many maps without a route were thrown away, None
    of a scene that draws none.
    """

    layout: Layout
    nominal_w: Float[Tensor, "p 3"]
    number: Int[np.ndarray, " p"]
    redrawn: int | None


def drawn(
    name: str,
    node: Mapping[str, Any],
    amount: Amount,
    *,
    seed: int,
    planner: RoutePlanner | None,
    allowed: Iterable[str] = (),
) -> Drawn:
    """The flights of one scene configuration.

    Raises:
        ConfigError: See `lay_out`.
    """
    scene = scene_of(node, f"scene.{name}", allowed)
    maps = isinstance(scene, RandomMaps)
    flights = amount.drawn * amount.flights_a_map if maps else amount.flights
    if flights < 1:
        raise ConfigError(f"flights is {flights}; expected at least 1.")
    if amount.maps is not None and not maps:
        raise ConfigError(
            f"maps is {amount.maps}, but scene {name} draws no maps to be flown several times; "
            "leave maps out, or raise flights."
        )
    cell_m = planner.search.resolution_m if planner else TYPICAL_CELL_M
    one = _sample(scene, name, generator_for(seed, f"evaluation/{name}"))
    require_room(flights, one.size, cell_m, "cpu")
    if maps:
        if planner is None:
            raise _needs_search(name)
        return _on_maps(scene, name, amount, seed, planner)
    layout = sampled(scene, flights, generator_for(seed, f"evaluation/{name}"), planner)
    start = getattr(scene, "start_m", None)
    nominal = layout.start_w if start is None else start.expand(flights, 3)
    number = np.arange(flights) if start is None else np.zeros(flights, np.int64)
    return Drawn(layout, nominal, number, None)


def _on_maps(
    scene: RandomMaps, name: str, amount: Amount, seed: int, planner: RoutePlanner
) -> Drawn:
    """Random maps with a route from their nominal start, each with as many flights.

    Every map and every try of it has a generator of its own: the first maps are the same, however
    many there are.
    """
    layouts, redrawn, offsets = [], 0, []
    for number in range(amount.drawn):
        path = f"evaluation/{name}/map/{number}"
        for attempt in range(TRIES):
            layout = _sample(scene, name, generator_for(seed, f"{path}/{attempt}"))
            layout = replace(layout, start_w=scene.start_m[None])
            if planner.joins(layout):
                break
            redrawn += 1
        else:
            law = f" ({scene.law})" if scene.law else ""
            raise ConfigError(
                f"scene {name}{law} found no free route in {TRIES} tries of map {number}: from "
                f"{_shown(scene.start_m)} to {_shown(scene.goal_m)} m, "
                f"{planner.search.clearance_m:g} m from obstacles; give it fewer or smaller "
                "obstacles, or lower search.clearance_m."
            )
        layouts.append(layout)
        moved = torch.zeros(amount.flights_a_map, 3)
        jitter = (-scene.jitter_m, scene.jitter_m)
        shape = (amount.flights_a_map, 2)
        moved[:, :2] = uniform(shape, *jitter, generator_for(seed, f"{path}/starts"))
        offsets.append(moved)
    number = torch.arange(amount.drawn).repeat_interleave(amount.flights_a_map)
    layout = rows(concatenate(layouts), number)
    nominal = layout.start_w
    layout = replace(layout, start_w=nominal + torch.cat(offsets))
    return Drawn(layout, nominal, number.numpy(), redrawn)


def _sample(scene: Scene, name: str, generator: torch.Generator) -> Layout:
    """One scene of a configuration; what it complains of comes with its name."""
    try:
        return scene.sample(1, generator)
    except ConfigError as error:
        raise ConfigError(f"scene {name}: {error}") from None


def _needs_search(name: str) -> ConfigError:
    return ConfigError(f"scene {name} only knows its goal, and search is none; set search=exact.")


def _shown(point: Float[Tensor, "3"]) -> str:
    return f"({', '.join(f'{value:g}' for value in point.tolist())})"


def _lines(layout: Layout) -> list[Float[np.ndarray, "_ 2"]]:
    """From each start straight through the control points [m]."""
    lines = []
    for start, route, length in zip(
        layout.start_w, layout.route_w, layout.route_length[:, 0].tolist(), strict=True
    ):
        lines.append(torch.cat((start[None], route[:length]))[:, :2].numpy())
    return lines
