"""One recorded episode as a picture: where it flew, and how it moved over time."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from tensordict import TensorDict
from torch import Tensor

from resc import keys
from resc.errors import RecordingError
from resc.maps.constants import INFLATION_M
from resc.math.rotation import euler_from_quaternion
from resc.recording.columns import FLOWN, REAL, REWARD_TERMS, require_columns
from resc.recording.commands import rate_command
from resc.recording.configuration import nodes_in, numbers_at
from resc.recording.insight import Route
from resc.recording.reader import RolloutLog
from resc.run_folder import replacing
from resc.viewing.colours import (
    AXES,
    BACKGROUND,
    COLLISION,
    DASHES,
    FRAME,
    PLAN,
    SPEED,
    TEXT,
    look,
)
from resc.viewing.estimate_picture import (
    draw_estimate,
    draw_position_errors,
    draw_tracks,
    is_estimated,
)
from resc.viewing.known_picture import draw_known, draw_routes, legend_entries
from resc.viewing.map_picture import draw_obstacles, ring_entry
from resc.viewing.moving import draw_movers, draw_trails, movers_of, places_of

_MARGIN_M, _LEAST_M = 1.5, 6.0
"""What is shown around a flight and its route, and the least width of it."""
_COLLISIONS = (
    "resc.terms.terminations.collision.Collision",
    "resc.terms.terminations.contact.Contact",
)
_OUTLIER = 5.0
"""A last step that changes a sum of rewards by so many times what any before it did is an end."""
_BESIDE = {"loc": "center left", "bbox_to_anchor": (1.0, 0.5), "frameon": False}
"""Where legends go that would hide curves."""


def draw(log: RolloutLog, episode: int, path: Path) -> None:
    """Draws an episode, simulated or real.

    Raises:
        RecordingError: The recording lacks a column, the scene or the configuration.
    """
    real = log.metadata.get("source") == REAL
    (draw_flight if real else draw_episode)(log, episode, path)


def draw_flight(log: RolloutLog, episode: int, path: Path) -> None:
    """Draws a real flight: its path from above, velocity, attitude, body rates, thrust, motors.

    What the log lacks is left out.
    """
    facts, steps = log.episodes.row(episode, named=True), log.episode(episode)
    require_columns(steps, (keys.ATTITUDE_WB, keys.BODY_RATE_B), "a picture of a flight")
    time = np.arange(len(steps)) * log.dt_s
    there = {column.key for column in log.columns}
    with mpl.rc_context({"font.size": 9, "font.family": "DejaVu Sans"}):
        figure = Figure(figsize=(13, 8.5), layout="constrained")
        grid = figure.add_gridspec(10, 2, width_ratios=(1, 1))
        _draw_path(figure.add_subplot(grid[:6, 0]), steps, there)
        left = [figure.add_subplot(grid[6 + 2 * i : 8 + 2 * i, 0]) for i in range(2)]
        _draw_curves(left[0], time, steps, keys.THROTTLE_COMMAND, "thrust set-point", there)
        _draw_curves(left[1], time, steps, keys.MOTOR_OUTPUT, "motor outputs", there)
        right = [figure.add_subplot(grid[2 * i : 2 * i + 2, 1]) for i in range(5)]
        if keys.VELOCITY_W in there:
            _draw_velocity(right[0], time, steps)
        else:
            _say(right[0], "velocity is not in the log")
        _draw_attitude(right[1], time, steps)
        rates = _tensor(steps, keys.BODY_RATE_B).numpy()
        asked = keys.BODY_RATE_COMMAND_B in there
        commanded = _tensor(steps, keys.BODY_RATE_COMMAND_B).numpy() if asked else None
        _draw_rates(right[2:], time, rates, commanded, "measured")
        for axes in (left[0], *right[:-1]):
            axes.tick_params(labelbottom=False)
        left[-1].set_xlabel("time [s]")
        right[-1].set_xlabel("time [s]")
        figure.suptitle(
            f"{log.metadata['log']}, episode {episode}: {facts['outcome']} after "
            f"{len(steps) * log.dt_s:.2f} s, from {facts['start_step'] * log.dt_s:.2f} s on"
        )
        with replacing(path, RecordingError) as unfinished:
            figure.savefig(unfinished, dpi=130, format=path.suffix.removeprefix(".") or "png")


def draw_episode(log: RolloutLog, episode: int, path: Path) -> None:
    """Draws an episode: map from above, velocity, attitude, body rates, rewards.

    The command is what the action asks of the rate loop, after the delay of the episode.

    Raises:
        RecordingError: The recording lacks a column, the scene or the configuration.
    """
    facts, steps = log.episodes.row(episode, named=True), log.episode(episode)
    require_columns(steps, (*FLOWN, keys.REWARD), "a picture")
    time = np.arange(len(steps)) * log.dt_s
    commanded = rate_command(log, episode, steps)
    with mpl.rc_context({"font.size": 9, "font.family": "DejaVu Sans"}):
        figure = Figure(figsize=(13, 8.5), layout="constrained")
        grid = figure.add_gridspec(10, 2, width_ratios=(1, 1))
        scene, inflation = log.scene(episode), inflation_m(log, episode)
        estimated = is_estimated(steps)
        above, below = (6, 8) if estimated else (7, 7)
        axes = figure.add_subplot(grid[:above, 0])
        routes, maps = log.routes(episode), log.known_maps(episode)
        movers = movers_of(scene)
        places = places_of(movers, len(steps), log.dt_s)
        draw_movers(axes, movers, places[-1], inflation or INFLATION_M)
        moving = draw_trails(axes, places)
        _draw_map(figure, axes, scene, steps, inflation, routes, bool(maps), moving)
        if maps:
            (cell_m,) = numbers_at(log.config, "env.resolution_m", 1)
            draw_known(axes, maps[-1].cells, scene["origin_w"].tolist(), cell_m)
        _draw_rewards(figure.add_subplot(grid[below:, 0]), time, log, steps)
        if estimated:
            axes = figure.add_subplot(grid[above:below, 0])
            draw_position_errors(axes, time, steps)
            axes.legend(fontsize="small", **_BESIDE)
            axes.tick_params(labelbottom=False)
            _quiet(axes)
        right = [figure.add_subplot(grid[2 * i : 2 * i + 2, 1]) for i in range(5)]
        _draw_velocity(right[0], time, steps)
        _draw_attitude(right[1], time, steps)
        rates = _tensor(steps, keys.BODY_RATE_B).numpy()
        _draw_rates(right[2:], time, rates, commanded, "true")
        for axes in right[:-1]:
            axes.tick_params(labelbottom=False)
        right[-1].set_xlabel("time [s]")
        figure.suptitle(
            f"episode {episode}: {facts['outcome']} after {len(steps) * log.dt_s:.2f} s, "
            f"return {facts['return_']:.2f} · environment {facts['env_id']}, "
            f"steps {facts['start_step']:,} to {facts['end_step']:,}, scene {facts['scene']}"
            + (f", {len(routes) - 1} replans" if routes else "")
        )
        with replacing(path, RecordingError) as unfinished:
            figure.savefig(unfinished, dpi=130, format=path.suffix.removeprefix(".") or "png")


def inflation_m(log: RolloutLog, episode: int) -> float:
    """Distance to obstacles [m] at which an episode collides: its own margin, if it has one."""
    terms = nodes_in(log.config, "termination") if "termination" in log.config else {}
    ending = [name for name, term in terms.items() if term["_target_"] in _COLLISIONS]
    own = [name for name in ending if terms[name].get("radius_m", 0.0) is None]
    radii = [
        numbers_at(log.config, f"termination.{name}.radius_m", 1)[0]
        for name in ending
        if name not in own
    ]
    if own:
        radii.append(float(_tensor(log.start(episode), keys.MARGIN)))
    return max(radii, default=0.0)


def _tensor(values: TensorDict, key: keys.NestedKey) -> Tensor:
    return cast(Tensor, values[key])


def _draw_map(
    figure: Figure,
    axes: Axes,
    scene: Mapping[str, Tensor],
    steps: TensorDict,
    inflation: float,
    routes: Sequence[Route],
    known: bool,
    moving: Sequence[Patch],
) -> None:
    position = _tensor(steps, keys.POSITION_W)[:, :2].numpy()
    speed = _tensor(steps, keys.VELOCITY_W).norm(dim=-1).numpy()
    ring_m = inflation or INFLATION_M
    draw_obstacles(axes, *obstacles_of(scene), ring_m)
    route = scene["route_w"][: int(scene["route_length"]), :2].numpy()
    planned = np.concatenate((scene["start_w"][None, :2].numpy(), route))
    if routes:
        draw_routes(axes, routes, steps)
    else:
        axes.plot(*planned.T, color=PLAN, linewidth=1.0, linestyle=DASHES, zorder=2)
        axes.scatter(*route[:-1].T, s=14, color=PLAN, linewidths=0, zorder=2)
    white = {"c": "white", "edgecolors": PLAN, "zorder": 5}
    axes.scatter(*planned[0], s=44, marker="o", **white)
    axes.scatter(*route[-1], s=130, marker="*", **white)
    norm = Normalize(0, max(float(speed.max()), 1.0))
    width = 6.0 if is_estimated(steps) else 2.0  # seen on both sides of the estimated track
    lines = LineCollection(
        list(np.stack((position[:-1], position[1:]), 1)), cmap=SPEED, norm=norm, linewidths=width
    )
    lines.set(array=speed[1:], zorder=3, capstyle="round")
    axes.add_collection(lines)
    draw_tracks(axes, steps)
    told = legend_entries(routes, known)
    ring = ring_entry(ring_m, ends=inflation > 0)
    named = [ring, *moving, *axes.get_legend_handles_labels()[0], *told]
    axes.legend(handles=named, loc="upper left", fontsize="small", framealpha=0.8)
    mark = {"edgecolors": "white", "linewidths": 0.8, "zorder": 6}
    axes.scatter(*position[-1], s=50, marker="D", c=COLLISION, **mark)
    shown = np.concatenate((position, planned))
    low, high = shown.min(0) - _MARGIN_M, shown.max(0) + _MARGIN_M
    half, middle = max((high - low).max(), _LEAST_M) / 2, (low + high) / 2
    (west, south), (east, north) = middle - half, middle + half
    axes.set(xlim=(west, east), ylim=(south, north), facecolor=BACKGROUND(1.0))
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    bar = figure.colorbar(lines, ax=axes, fraction=0.04, pad=0.02, aspect=40)
    bar.set_label("speed [m/s]")
    _quiet(axes)


def obstacles_of(scene: Mapping[str, Tensor]) -> tuple[list[list[float]], list[list[float]]]:
    """Boxes and pillars of a recorded scene; older recordings have no pillars."""
    pillars = scene["pillars_w"].tolist() if "pillars_w" in scene else []
    return scene["boxes_w"].tolist(), pillars


def _draw_rates(
    places: Sequence[Axes],
    time: Float[np.ndarray, " t"],
    rates: Float[np.ndarray, "t 3"],
    commanded: Float[np.ndarray, "t 3"] | None,
    label: str,
) -> None:
    for i, (axes, name) in enumerate(zip(places, ("roll", "pitch", "yaw"), strict=True)):
        axes.plot(time, rates[:, i], color=AXES[i], linewidth=2.0, label=label)
        if commanded is not None:
            axes.plot(time, commanded[:, i], color=TEXT, linewidth=0.8, label="commanded")
        _dress(axes, f"{name} rate [rad/s]", _end(time))


def _draw_path(axes: Axes, steps: TensorDict, there: Collection[keys.NestedKey]) -> None:
    """The flight from above, from the ring to the diamond."""
    if keys.POSITION_W not in there:
        _say(axes, "position is not in the log")
        return
    position = _tensor(steps, keys.POSITION_W)[:, :2].numpy()
    axes.plot(*position.T, color=PLAN, linewidth=1.6)
    axes.scatter(*position[0], s=44, c="white", edgecolors=PLAN, zorder=5)
    axes.scatter(*position[-1], s=50, marker="D", c=COLLISION, edgecolors="white", zorder=6)
    middle = (position.min(0) + position.max(0)) / 2
    half = max(float(np.ptp(position, 0).max()), _LEAST_M) / 2 + _MARGIN_M
    (west, south), (east, north) = middle - half, middle + half
    axes.set(xlim=(west, east), ylim=(south, north), aspect="equal")
    axes.set(xlabel="east [m]", ylabel="north [m]")
    axes.grid(color=FRAME, linewidth=0.4, alpha=0.5)
    _quiet(axes)


def _draw_curves(
    axes: Axes,
    time: Float[np.ndarray, " t"],
    steps: TensorDict,
    key: keys.NestedKey,
    label: str,
    there: Collection[keys.NestedKey],
) -> None:
    """Every component of a column, if the log tells it."""
    if key not in there:
        _say(axes, f"the log tells no {label}")
        return
    values = _tensor(steps, key).numpy()
    for i, column in enumerate(values.T):
        name = f"motor {i + 1}" if values.shape[1] > 1 else "set-point"
        axes.plot(time, column, linewidth=1.0, label=name)
    _dress(axes, label, _end(time))


def _say(axes: Axes, sentence: str) -> None:
    axes.text(0.5, 0.5, sentence, transform=axes.transAxes, ha="center", va="center", color=TEXT)
    axes.set(xticks=[], yticks=[])
    _quiet(axes)


def _draw_velocity(axes: Axes, time: Float[np.ndarray, " t"], steps: TensorDict) -> None:
    velocity = _tensor(steps, keys.VELOCITY_W)
    axes.plot(time, velocity.norm(dim=-1), color=TEXT, linewidth=0.9, label="speed")
    _draw_triple(axes, time, velocity.numpy(), "xyz")
    if is_estimated(steps):
        draw_estimate(axes, time, _tensor(steps, keys.ESTIMATED_VELOCITY_W))
    _dress(axes, "velocity [m/s]", _end(time))


def _draw_attitude(axes: Axes, time: Float[np.ndarray, " t"], steps: TensorDict) -> None:
    euler = euler_from_quaternion(_tensor(steps, keys.ATTITUDE_WB)).numpy()
    degrees = np.rad2deg(np.unwrap(euler, axis=0))  # a yaw beyond 180 deg goes on, not back
    _draw_triple(axes, time, degrees, ("roll", "pitch", "yaw"))
    _dress(axes, "attitude [deg]", _end(time))


def _draw_triple(
    axes: Axes,
    time: Float[np.ndarray, " t"],
    values: Float[np.ndarray, "t 3"],
    names: Sequence[str],
) -> None:
    for i, name in enumerate(names):
        axes.plot(time, values[:, i], color=AXES[i], label=name)


def _draw_rewards(
    axes: Axes, time: Float[np.ndarray, " t"], log: RolloutLog, steps: TensorDict
) -> None:
    """Sums of the reward terms up to each step; terms that stay zero are left out."""
    names = next((c.components for c in log.columns if c.key == REWARD_TERMS), ())
    sums = _tensor(steps, REWARD_TERMS).cumsum(0).numpy() if names else np.zeros((len(time), 0))
    shown = [i for i in range(len(names)) if np.abs(sums[:, i]).max() > 0]
    for place, i in enumerate(shown):
        axes.plot(time, sums[:, i], label=f"{names[i]} {sums[-1, i]:.2f}", **look(place))
    total = _tensor(steps, keys.REWARD)[:, 0].cumsum(0).numpy()
    axes.plot(time, total, color=TEXT, linewidth=1.6, label=f"return {total[-1]:.2f}")
    _dress(axes, "reward, summed", _end(time), legend={**_BESIDE, "title": "at the end"})
    axes.set_xlabel("time [s]")
    _set_range(axes, float(time[-1]))


def _set_range(axes: Axes, end_s: float) -> None:
    """Fits the axis to all steps but the last, if that alone would flatten the curves.

    A crash or an arrival is worth more than a whole flight. Curves that leave the axis end in an
    arrow; where they end is in the legend.
    """
    curves = [line for line in axes.get_lines() if not str(line.get_label()).startswith("_")]
    values = np.array([line.get_ydata() for line in curves])
    changes = np.abs(np.diff(values))
    if changes.shape[1] < 2 or changes[:, -1].max() <= _OUTLIER * changes[:, :-1].max():
        return
    low, high = min(0.0, values[:, :-1].min()), max(0.0, values[:, :-1].max())
    margin = 0.1 * (high - low) or 1.0
    low, high = low - margin, high + margin
    axes.set_ylim(low, high)
    for line, last in zip(curves, values[:, -1], strict=True):
        if not low <= last <= high:
            edge, marker = (low, "v") if last < low else (high, "^")
            axes.plot(end_s, edge, marker, color=line.get_color(), markersize=8, clip_on=False)


def _dress(axes: Axes, label: str, end_s: float, legend: Mapping[str, Any] = _BESIDE) -> None:
    axes.set(ylabel=label, xlim=(0, end_s))
    axes.grid(color=FRAME, linewidth=0.4, alpha=0.5)
    axes.axhline(0, color=FRAME, linewidth=0.6, zorder=1)
    axes.legend(fontsize="small", **legend)
    _quiet(axes)


def _end(time: Float[np.ndarray, " t"]) -> float:
    """Right end of the time axis [s]; not its left one if there is but one step."""
    return float(time[-1]) or 1.0


def _quiet(axes: Axes) -> None:
    axes.tick_params(length=2, color=FRAME, labelcolor=TEXT, labelsize="small")
    for spine in axes.spines.values():
        spine.set_color(FRAME)
