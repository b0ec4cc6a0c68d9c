"""One recorded episode as a GIF from above: what the vehicle knows, and where it goes."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Wedge
from omegaconf import OmegaConf
from PIL import Image  # comes with matplotlib
from torch import Tensor

from resc import keys
from resc.console import progress
from resc.errors import RecordingError
from resc.math.rotation import euler_from_quaternion
from resc.recording.columns import FLOWN, require_columns
from resc.recording.configuration import numbers_at
from resc.recording.insight import KnownMap, Route
from resc.recording.reader import RolloutLog
from resc.run_folder import replacing
from resc.viewing.colours import BACKGROUND, FRAME, PLAN, RENEWED, TEXT, TRUE, VIEW
from resc.viewing.known_picture import draw_known
from resc.viewing.map_picture import draw_obstacles
from resc.viewing.moving import draw_movers, movers_of, places_of
from resc.viewing.plot import obstacles_of

FRAMES_HZ = 12.5
"""Frames of a second of flight, shown in real time."""
EDGE_INCHES, DPI = 6.4, 100
SIDE_M, LEAST_M, EDGE_M = 1.0, 8.0, 0.3
"""Margin around a flight, the least width of what is shown, and the margin around a map."""
VEHICLE_M = 0.3
REACHED_M = 0.5
"""Distance at which a control point counts as passed, where the run does not say."""
LAST_MS = 1500
"""For how long the last frame stays."""
COLOURS = 128
"""Of all frames."""


class _Flight:
    """The episode, and what is seen of it in each step."""

    def __init__(self, log: RolloutLog, episode: int) -> None:
        steps = log.episode(episode)
        require_columns(steps, FLOWN, "a video")
        self.scene = log.scene(episode)
        self.dt_s = log.dt_s
        self.position = cast(Tensor, steps[keys.POSITION_W]).numpy()
        self.speed = cast(Tensor, steps[keys.VELOCITY_W]).norm(dim=-1).numpy()
        self.yaw = euler_from_quaternion(cast(Tensor, steps[keys.ATTITUDE_WB]))[:, 2].numpy()
        self.maps: list[KnownMap] = log.known_maps(episode)
        self.routes: list[Route] = log.routes(episode) or [self._planned()]
        (self.cell_m,) = numbers_at(log.config, "env.resolution_m", 1)
        config = cast(dict[str, Any], OmegaConf.to_container(log.config, resolve=True))
        task = (config.get("task") or {}).get("control_points") or {}
        self.radius_m = float(task.get("radius_m", REACHED_M))
        self.view = _view(config.get("sensing") or {})
        self.movers = movers_of(self.scene)
        self.places = places_of(self.movers, len(self.position), self.dt_s)
        self.outcome = str(log.episodes.row(episode, named=True)["outcome"])

    def _planned(self) -> Route:
        points = self.scene["route_w"][: int(self.scene["route_length"])].numpy()
        return Route(step=0, planned=0, cause="first", points=points)

    def route(self, step: int) -> tuple[int, Route]:
        """Number of the route that is flown in a step, and the route."""
        number = max(n for n, route in enumerate(self.routes) if route.step <= step or n == 0)
        return number, self.routes[number]

    def ahead(self, step: int) -> Float[np.ndarray, "k 2"]:
        """The control points of the route that are still to be passed."""
        _, route = self.route(step)
        passed = 0
        for here in self.position[route.step : step + 1, :2]:
            if passed < len(route.points) - 1:
                passed += math.dist(here, route.points[passed, :2]) < self.radius_m
        return route.points[passed:, :2]

    def known(self, step: int) -> KnownMap | None:
        """The last map that was recorded by then."""
        return next((known for known in reversed(self.maps) if known.step <= step), None)

    @property
    def window(self) -> tuple[float, float, float, float]:
        """West, east, south and north of what is shown [m]: what is on the map of a square."""
        shown = np.concatenate((self.position, *(route.points for route in self.routes)))[:, :2]
        low, high = shown.min(0) - SIDE_M, shown.max(0) + SIDE_M
        half = max(float((high - low).max()), LEAST_M) / 2
        east, north = ((low + high) / 2).tolist()
        (west, south), (width, height) = (
            self.scene[name].tolist() for name in ("origin_w", "size")
        )
        return (
            max(east - half, west - EDGE_M),
            min(east + half, west + width + EDGE_M),
            max(north - half, south - EDGE_M),
            min(north + half, south + height + EDGE_M),
        )


def write_video(log: RolloutLog, episode: int, path: Path) -> Path:
    """Writes a finished episode as a GIF in real time; returns its path.

    Raises:
        RecordingError: The recording lacks something that is drawn, or the file cannot be written.
    """
    flight = _Flight(log, episode)
    every = max(1, round(1 / (FRAMES_HZ * flight.dt_s)))
    last = len(flight.position) - 1
    shown = [*range(0, last, every), last]
    with mpl.rc_context({"font.size": 9, "font.family": "DejaVu Sans"}):
        west, east, south, north = flight.window
        high = (EDGE_INCHES - 0.6) * (north - south) / (east - west)
        size = (EDGE_INCHES, high + 0.8)
        figure = Figure(figsize=size, dpi=DPI, layout="constrained")
        axes = figure.add_subplot()
        _draw_ground(axes, flight)
        canvas = FigureCanvasAgg(figure)
        frames = []
        with progress(len(shown), desc="drawing", unit="frame") as bar:
            for step in shown:
                drawn = _draw_frame(axes, flight, step)
                canvas.draw()
                frames.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy()))
                for artist in drawn:
                    artist.remove()
                bar.update()
    frame_ms = round(1e3 * every * flight.dt_s)
    lasts_ms = [*[frame_ms] * (len(shown) - 1), LAST_MS]
    with replacing(path, RecordingError) as unfinished:
        first, *others = _in_few_colours(frames)
        first.save(
            unfinished, format="GIF", save_all=True, append_images=others, duration=lasts_ms, loop=0
        )
    return path


def _in_few_colours(frames: Sequence[Image.Image]) -> list[Image.Image]:
    """The frames in colours that they share: what stands still costs nothing in a GIF."""
    some = frames[:: max(1, len(frames) // 4)]
    width, height = frames[0].size
    sheet = Image.new("RGB", (width, height * len(some)))
    for number, frame in enumerate(some):
        sheet.paste(frame, (0, number * height))
    palette = sheet.quantize(COLOURS, Image.Quantize.MAXCOVERAGE)
    return [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]


def _draw_ground(axes: Axes, flight: _Flight) -> None:
    """What stays: obstacles, start and goal."""
    draw_obstacles(axes, *obstacles_of(flight.scene))
    west, east, south, north = flight.window
    axes.set(xlim=(west, east), ylim=(south, north), aspect="equal", autoscale_on=False)
    axes.set(xlabel="x [m]", ylabel="y [m]", facecolor=BACKGROUND(1.0))
    goal = flight.routes[0].points[-1, :2]
    white = {"c": "white", "edgecolors": PLAN, "zorder": 5}
    axes.scatter(*flight.position[0, :2], s=44, marker="o", **white)
    axes.scatter(*goal, s=130, marker="*", **white)
    axes.tick_params(length=2, color=FRAME, labelcolor=TEXT, labelsize="small")
    for spine in axes.spines.values():
        spine.set_color(FRAME)


def _draw_frame(axes: Axes, flight: _Flight, step: int) -> list[Artist]:
    """What changes from frame to frame."""
    drawn: list[Artist] = []
    known = flight.known(step)
    if known is not None:
        corner = flight.scene["origin_w"].tolist()
        drawn += draw_known(axes, known.cells, corner, flight.cell_m)
    drawn += draw_movers(axes, flight.movers, flight.places[step])
    x, y = flight.position[step, :2].tolist()
    here, yaw = (x, y), float(flight.yaw[step])
    number, _ = flight.route(step)
    ahead = flight.ahead(step)
    way = np.concatenate(([here], ahead))
    colour = RENEWED if number else PLAN
    drawn += axes.plot(*way.T, color=colour, linewidth=1.2, linestyle="--", zorder=2.5)
    drawn += axes.plot(*ahead.T, "o", color=colour, markersize=4, zorder=2.6)
    drawn += axes.plot(*ahead[:2].T, "o", mfc="none", mec=colour, markersize=9, zorder=2.6)
    drawn += axes.plot(*flight.position[: step + 1, :2].T, color=TRUE, linewidth=1.6, zorder=3)
    if flight.view:
        range_m, angle = flight.view
        half = math.degrees(angle) / 2
        turned = math.degrees(yaw)
        edge = {"facecolor": VIEW, "alpha": 0.22, "edgecolor": "none", "zorder": 1.7}
        drawn.append(axes.add_patch(Wedge(here, range_m, turned - half, turned + half, **edge)))
    drawn.append(axes.add_patch(_vehicle(here, yaw)))
    axes.set_title(_caption(flight, step, number), fontsize=9, color=TEXT, loc="left")
    return drawn


def _vehicle(here: Sequence[float], yaw: float) -> Polygon:
    """An arrowhead that points ahead."""
    outline = VEHICLE_M * np.array([[1.0, 0.0], [-0.7, 0.6], [-0.4, 0.0], [-0.7, -0.6]])
    turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
    return Polygon(
        outline @ turn + np.array(here), facecolor=PLAN, edgecolor="white", lw=0.6, zorder=6
    )


def _caption(flight: _Flight, step: int, number: int) -> str:
    last = step == len(flight.position) - 1
    parts = [f"{step * flight.dt_s:5.2f} s", f"{flight.speed[step]:.1f} m/s"]
    if len(flight.routes) > 1 or number:
        parts.append(f"routes renewed: {number}")
    if flight.routes[number].cause not in ("first", "blocked"):
        parts.append(f"waits: {flight.routes[number].cause}")
    return " · ".join([*parts, *([flight.outcome] if last else [])])


def _view(sensing: Mapping[str, Any]) -> tuple[float, float] | None:
    """Range [m] and angle [rad] of what the vehicle senses; None where all is known."""
    range_m = sensing.get("range_m", sensing.get("radius_m"))
    if range_m is None:
        return None
    return float(range_m), float(sensing.get("horizontal_rad", 2 * math.pi))
