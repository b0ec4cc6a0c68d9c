"""One recorded episode with its surroundings, ready to be drawn: from the recording alone."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from jaxtyping import Float, Int
from omegaconf import OmegaConf
from tensordict import TensorDict
from torch import Tensor

from resc import keys
from resc.build import ALLOWED, build, build_terms
from resc.errors import RecordingError
from resc.groups import NEEDED as NEEDED_GROUPS
from resc.maps.cells import extent_of, shape_of
from resc.maps.constants import TRUNCATION_M
from resc.maps.distance_transform import distance_transform
from resc.recording.columns import FLOWN, REAL, REWARD_TERMS, require_columns
from resc.recording.configuration import nodes_in, numbers_at, require_groups
from resc.recording.insight import KnownMap, Route
from resc.recording.reader import RolloutLog
from resc.scenes.layout import PARKED_M, rasterize
from resc.scenes.pool import layout_from
from resc.sights import Shape
from resc.simulation.vehicle import Vehicle
from resc.term import Action, Context, Observation, Term
from resc.viewing.moving import movers_of, places_of
from resc.viewing.sight import seen_by

CONFIG = "config.yaml"
NEEDED = (*FLOWN, keys.REWARD, REWARD_TERMS)
"""Columns that a scene is drawn from."""

Tensors = dict[keys.NestedKey, Tensor]


@dataclass(frozen=True)
class Place:
    """The scene of an episode: columns, map and route, world frame [m].

    `boxes` are columns over the whole height: x and y of the corner, lengths; `pillars` are round
    ones: x and y of the axis, radius; `movers` are those that move (`resc.maps.movers`). `route` is
    all control points; one is passed within `radius`, and `half_height` unless that is None: then
    the radius is a sphere's.
    """

    boxes: Float[Tensor, "k 4"]
    pillars: Float[Tensor, "m 3"]
    movers: Float[Tensor, "o 10"]
    origin: Float[Tensor, " 2"]
    size: Float[Tensor, " 2"]
    resolution: float
    esdf: Float[Tensor, "h w"]
    start: Float[Tensor, " 3"]
    route: Float[Tensor, "r 3"]
    radius: float
    half_height: float | None


@dataclass(frozen=True)
class EpisodeScene:
    """What there is to see of an episode.

    Row t is the state before step t, the action taken in it and the reward it earned; the state
    after the last step is not recorded. `passed` counts the control points passed so far.
    `command` is what the action asks for, before any delay: body rate [rad/s], thrust [N].
    `routes` are those that arrived in flight, and `known` the maps that were known, if recorded.
    """

    facts: dict[str, str]
    run: dict[str, str]
    config: bytes
    dt_s: float
    steps: TensorDict
    reward_names: tuple[str, ...]
    command: tuple[Float[Tensor, "t 3"], Float[Tensor, "t 1"]]
    passed: Int[Tensor, " t"]
    place: Place
    vehicle: Vehicle
    sights: dict[str, list[Shape]]
    routes: Sequence[Route] = ()
    known: Sequence[KnownMap] = ()

    def __len__(self) -> int:
        return len(self.passed)

    def column(self, key: keys.NestedKey) -> Float[Tensor, "t ..."]:
        """A recorded column."""
        return cast(Tensor, self.steps[key])

    def path(self, key: keys.NestedKey) -> Float[Tensor, "t 3"] | None:
        """Positions read or estimated before each step; None where none are recorded."""
        return cast("Tensor | None", self.steps.get(key, None))

    @property
    def mover_places(self) -> Float[Tensor, "t o 2"]:
        """Where the centres of movers are before each step [m]."""
        return places_of(self.place.movers, len(self), self.dt_s)

    @property
    def success(self) -> bool:
        """Whether the episode reached its goal."""
        return self.facts["success"] == "true"

    @property
    def events(self) -> list[tuple[int, str]]:
        """What happened, as (step, sentence), in order."""
        facts, count = self.facts, len(self.place.route)
        first = f"episode {facts['index']} begins: environment {facts['env_id']}, scene"
        told = [(0, f"{first} {facts['scene']}, {count} control points")]
        for route in self.routes[1:]:
            told.append((route.step, f"new route of {len(route.points)} points: {route.cause}"))
        counts = self.passed.tolist()
        told += [
            (step, f"control point {after} of {count} passed")
            for step, (before, after) in enumerate(pairwise(counts), 1)
            if after > before
        ]
        seconds = len(self) * self.dt_s
        end = f"{facts['outcome']} after {seconds:.2f} s, return {float(facts['return']):.2f}"
        return [*sorted(told, key=lambda event: event[0]), (len(self), end)]


def load_scene(log: RolloutLog, episode: int, allowed: Iterable[str] = ()) -> EpisodeScene:
    """Entry `episode` of `log.episodes` with its surroundings.

    Args:
        log: The recording.
        episode: Which of its finished episodes.
        allowed: Prefixes of `_target_` outside resc that its configuration may name.

    Raises:
        RecordingError: The recording lacks something that a scene needs.
    """
    if log.metadata.get("source") == REAL:
        raise RecordingError(
            f"{log.files[0]} is of a real flight, which has no scene and no rewards; draw it with "
            "resc-log plot."
        )
    steps = log.episode(episode)
    require_columns(steps, NEEDED, "a scene")
    stored = log.config
    require_groups(stored, NEEDED_GROUPS)
    nodes_in(stored, "task", ("control_points",))
    (resolution,) = numbers_at(stored, "env.resolution_m", 1)
    facts = _facts(log, episode)
    config = cast(dict[str, Any], OmegaConf.to_container(stored))
    vehicle = build(config["vehicle"], "vehicle", allowed=allowed)
    context = Context(
        dt_s=log.dt_s, resolution_m=resolution, vehicle=vehicle,
        observation_frame=config["env"].get("observation_frame", "world"),
    )  # fmt: skip
    task = build(config["task"]["control_points"], "task.control_points", allowed=allowed)
    place = _place(log.scene(episode), resolution, task)
    passed = _passed(steps, place, task)
    observations = _observations(nodes_in(config, "observation"), allowed)
    return EpisodeScene(
        facts=facts,
        run=log.metadata,
        config=log.attachments[CONFIG],
        dt_s=log.dt_s,
        steps=steps,
        reward_names=next(c.components for c in log.columns if c.key == REWARD_TERMS),
        command=_command(steps, build(config["action"], "action", allowed=allowed), context),
        passed=passed,
        place=place,
        vehicle=vehicle,
        sights=_sights(steps, passed, place, observations, context),
        routes=log.routes(episode),
        known=log.known_maps(episode),
    )


def _facts(log: RolloutLog, episode: int) -> dict[str, str]:
    """The episode's entry as text, for metadata and log lines."""
    entry = log.episodes.row(episode, named=True)
    entry["return"] = entry.pop("return_")
    entry["file"] = Path(entry["file"]).name  # where it lay says nothing to the next reader
    texts = {name: str(value) for name, value in entry.items()}
    return {n: text.lower() if isinstance(entry[n], bool) else text for n, text in texts.items()}


def _place(arrays: Mapping[str, Tensor], resolution: float, task: Term) -> Place:
    layout = layout_from({name: array.unsqueeze(0) for name, array in arrays.items()})
    boxes, pillars, size = layout.boxes_w, layout.pillars_w, layout.size[0]
    shape = shape_of(size, resolution)
    occupied = rasterize(boxes, layout.origin_w, shape, resolution, pillars)
    return Place(
        boxes=boxes[boxes[..., 0] < PARKED_M],
        pillars=pillars[pillars[..., 0] < PARKED_M],
        movers=movers_of(arrays),
        origin=layout.origin_w[0],
        size=extent_of(size, resolution),
        resolution=resolution,
        esdf=distance_transform(occupied, resolution, TRUNCATION_M)[0],
        start=arrays["start_w"],
        route=arrays["route_w"][: int(arrays["route_length"])],
        radius=getattr(task, "radius_m", 0.5),
        half_height=getattr(task, "half_height_m", 0.2),
    )


def _command(steps: TensorDict, term: Action, context: Context) -> tuple[Tensor, Tensor]:
    """Body rate [rad/s] and thrust [N] that each action asks for."""
    term.named("action").bind(context)
    action = cast(Tensor, steps[keys.ACTION])
    depth = term.longest_delay_steps + 1
    tensors: Tensors = {
        keys.ACTION: action,
        keys.ACTION_QUEUE: action.new_zeros(len(action), depth, action.shape[-1]),
        keys.ACTION_DELAY: action.new_zeros(len(action), 1),
    }
    term.run(tensors)
    return tensors[keys.BODY_RATE_COMMAND_B], tensors[keys.COLLECTIVE_THRUST]


def _passed(steps: TensorDict, place: Place, task: Term) -> Int[Tensor, " t"]:
    """Control points passed before each step, by the rule of the run."""
    position = cast(Tensor, steps[keys.POSITION_W])
    count = len(position)
    route = place.route.expand(count, -1, -1)
    length = torch.full((count, 1), len(place.route))
    reached = torch.cat(
        [
            task.compute(position, route, length, torch.full((count, 1), number))[3]
            for number in range(len(place.route))
        ],
        -1,
    ).numpy()
    passed = np.zeros(count, np.int64)
    for step in range(1, count):  # where an episode begins, nothing is passed
        number = passed[step - 1]
        passed[step] = number + (number < len(place.route) and reached[step, number])
    return torch.from_numpy(passed)


def _observations(nodes: Mapping[str, Any], allowed: Iterable[str]) -> list[Observation]:
    """The observations, but those of packages that the reader does not allow."""
    known = (*ALLOWED, *allowed)
    nodes = {name: node for name, node in nodes.items() if node["_target_"].startswith(known)}
    return build_terms(nodes, "observation", Observation, allowed)


def _sights(
    steps: TensorDict,
    passed: Int[Tensor, " t"],
    place: Place,
    terms: Iterable[Observation],
    context: Context,
) -> dict[str, list[Shape]]:
    """What each observation that draws itself sees, from what is recorded.

    The draws of the flight are not; at one half noise is zero.
    """
    count, last = len(passed), len(place.route) - 1
    ahead = torch.stack((passed, passed + 1), -1).clamp(max=last)
    tensors = {key: cast(Tensor, steps[key]) for key in FLOWN}
    tensors |= {
        keys.CONTROL_POINTS_W: place.route[ahead],
        keys.ROUTE_W: place.route.expand(count, -1, -1),
        keys.SCENE_INDEX: torch.zeros(count, 1, dtype=torch.int64),
        keys.ESDF: place.esdf[None],
        keys.MAP_ORIGIN_W: place.origin[None],
        keys.MAP_SIZE: place.size[None],
        keys.MOVERS_W: place.movers[None],
        keys.CLOCK: torch.arange(count, dtype=torch.float32).unsqueeze(-1),
    }
    found = {
        term.name: seen_by(term, context, tensors, lambda width: torch.full((count, width), 0.5))
        for term in terms
    }
    return {name: seen for name, seen in found.items() if seen}
