"""What is flown: the scenes of the list, laid out and planned, one entry per flight."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from resc.build import build
from resc.errors import ConfigError
from resc.maps.cells import require_room
from resc.math.sampling import generator_for
from resc.planning.route import RoutePlanner
from resc.scenes.layout import Layout, Scene, sampled

TYPICAL_CELL_M = 0.1
"""Edge of a map cell where no planner tells it."""


@dataclass(frozen=True)
class Course:
    """One scene of the list with a start and a route for every flight.

    `planned_m` is the polyline of each flight, `nominal_w` its start without the jitter.
    `own_routes`: the scene laid the routes out itself,
    so its flights obey the task and the terminations of the training; all others lead from rest to
    the goal of a planned path.
    """

    name: str
    layout: Layout
    nominal_w: Float[Tensor, "p 3"]
    planned_m: Sequence[Float[np.ndarray, "_ 2"]]
    own_routes: bool

    def __len__(self) -> int:
        return len(self.layout)

    @property
    def planned_lengths_m(self) -> Float[np.ndarray, " f"]:
        """Length of the polyline of each flight [m]."""
        steps = [np.diff(line, axis=0) for line in self.planned_m]
        return np.array([np.hypot(*step.T).sum() for step in steps])

    @property
    def one_map(self) -> bool:
        """Whether all flights share their obstacles."""
        obstacles = (self.layout.boxes_w, self.layout.pillars_w)
        return all(bool((kind == kind[:1]).all()) for kind in obstacles)


class LaidOut:
    """A scene that is laid out already: hands its layout to the pool."""

    def __init__(self, layout: Layout) -> None:
        self.layout = layout

    def sample(self, count: int, generator: torch.Generator) -> Layout:
        """The layout, all of it; nothing is drawn."""
        assert count == len(self.layout), f"{count} of {len(self.layout)} scenes wanted"
        return self.layout


def lay_out(
    scenes: Mapping[str, Mapping[str, Any]],
    flights: int,
    *,
    seed: int,
    planner: RoutePlanner | None,
    allowed: Iterable[str] = (),
) -> list[Course]:
    """The courses of a list of scene configurations, `flights` of each.

    Every scene draws from a generator of its own, so adding one to the list leaves the others as
    they were.

    Raises:
        ConfigError: No scene, less than one flight, or no planner for a scene that needs one.
        PlanningError: A flight has no path.
    """
    if not scenes:
        raise ConfigError("scenes is empty; name at least one file of conf/scene.")
    if flights < 1:
        raise ConfigError(f"flights is {flights}; expected at least 1.")
    courses = []
    for name, node in scenes.items():
        layout, nominal = drawn(name, node, flights, seed=seed, planner=planner, allowed=allowed)
        own_routes = bool((layout.route_length > 0).all())
        if own_routes:
            planned = _lines(layout)
        elif planner is None:
            raise ConfigError(
                f"scene {name} only knows its goal, and search is none; set search=visibility."
            )
        else:
            layout = planner(layout, name)
            planned = [path.points_m for path in planner.paths]
        courses.append(Course(name, layout, nominal, planned, own_routes))
    return courses


def drawn(
    name: str,
    node: Mapping[str, Any],
    flights: int,
    *,
    seed: int,
    planner: RoutePlanner | None,
    allowed: Iterable[str] = (),
) -> tuple[Layout, Float[Tensor, "p 3"]]:
    """The layout of one scene configuration, and the starts as they are without jitter."""
    scene = build(node, f"scene.{name}", allowed=allowed, kind=Scene)
    cell_m = planner.search.resolution_m if planner else TYPICAL_CELL_M
    one = scene.sample(1, generator_for(seed, f"evaluation/{name}"))
    require_room(flights, one.size, cell_m, "cpu")
    layout = sampled(scene, flights, generator_for(seed, f"evaluation/{name}"), planner)
    start = getattr(scene, "start_m", None)
    return layout, layout.start_w if start is None else start.expand(flights, 3)


def _lines(layout: Layout) -> list[Float[np.ndarray, "_ 2"]]:
    """From each start straight through the control points [m]."""
    lines = []
    for start, route, length in zip(
        layout.start_w, layout.route_w, layout.route_length[:, 0].tolist(), strict=True
    ):
        lines.append(torch.cat((start[None], route[:length]))[:, :2].numpy())
    return lines
