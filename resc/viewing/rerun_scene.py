"""A recorded episode as a Rerun recording with its blueprint (docs/scenes.md)."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np
import rerun as rr  # pyright: ignore[reportMissingImports]
import rerun.blueprint as rrb  # pyright: ignore[reportMissingImports]
from jaxtyping import Float, UInt8

from resc import keys
from resc.errors import RecordingError
from resc.recording.reader import RolloutLog
from resc.run_folder import replacing
from resc.sights import Shape
from resc.viewing import layouts
from resc.viewing.appearance import (
    TRAIL_STEPS,
    WALL_ALPHA,
    rgba,
    rotor_colours,
    rotor_places,
    rotor_radius,
    route_colours,
    scene_numbers,
    shades,
    top_of_obstacles,
    vehicle_ring,
)
from resc.viewing.colours import (
    AXES,
    ESTIMATED,
    FRONT,
    MEASURED,
    MOVER,
    OBSTACLE,
    PLAN,
    RENEWED,
    ROTOR,
)
from resc.viewing.episode_scene import EpisodeScene, load_scene
from resc.viewing.foxglove import KNOWN_M
from resc.viewing.known_picture import shaded
from resc.viewing.scalars import Numbers
from resc.viewing.sight import colour_of

APPLICATION = "resc"
DOT_M, ARM_M = 0.035, 0.008
"""Radii [m]."""
PLANNED, EDGE, RAY, TRAIL, TRACK, FRAME = -1.0, -1.6, -0.8, -2.0, -1.2, -2.0
"""Radii on the screen, which Rerun takes negative: lines are seen from afar and stay thin near."""
EYE = np.array((0.0, -0.47, 1.15))
"""Where the camera is, from the middle of the route, in lengths of it."""
LEAST_M = 6.0
"""Length [m] that a shorter route counts as there."""
SCENE = ("/world/**", "/map/**", "/plan/**", "/drone/**", "/observation/**")
DIMMED = 0.45
"""Opacity of commanded rates beside true ones."""


def write_rerun(
    log: RolloutLog, episode: int, path: Path, *, allowed: Iterable[str] = ()
) -> Path:  # fmt: skip
    """Writes a finished episode as a Rerun recording; returns its path.

    Args:
        log: The recording.
        episode: Entry of `log.episodes`.
        path: The file to write.
        allowed: Prefixes of `_target_` outside resc that the stored configuration may name.

    Raises:
        RecordingError: The recording lacks something that a scene needs, or the file cannot be
            written.
    """
    scene = load_scene(log, episode, allowed)
    stream = rr.RecordingStream(APPLICATION, recording_id=f"{log.files[0].stem}#{episode}")
    # Through memory: on a full disk, Rerun's own writer waits forever or says nothing.
    memory = stream.memory_recording()
    stream.send_blueprint(_blueprint(scene), make_active=True)
    _send(stream, scene)
    with replacing(path, RecordingError) as unfinished:
        unfinished.write_bytes(memory.drain_as_bytes())
    return path


def _send(stream: rr.RecordingStream, scene: EpisodeScene) -> None:
    stream.send_recording_name(f"episode {scene.facts['index']}: {scene.facts['outcome']}")
    stream.send_property("episode", rr.AnyValues(False, **scene.facts))
    run = {name: text for name, text in scene.run.items() if text}  # Rerun takes no empty ones
    if run:
        stream.send_property("run", rr.AnyValues(False, **run))
    _send_place(stream, scene)
    times = _seconds(scene, range(len(scene)))
    _send_vehicle(stream, scene, times)
    _send_movers(stream, scene, times)
    _send_route(stream, scene)
    _send_learnt(stream, scene)
    _send_estimate(stream, scene)
    for name, seen in scene.sights.items():
        _send_sight(stream, f"/observation/{name}", seen, scene, times)
    for path, values in _curves(scene_numbers(scene)):
        stream.send_columns(path, [times], rr.Scalars.columns(scalars=values))
    for axis, colour in zip("xyz", AXES, strict=True):
        for topic, name, alpha in (("state", "true", 1.0), ("command", "commanded", DIMMED)):
            style = rr.SeriesLines(colors=[rgba(colour, alpha)], names=[f"{axis} {name}"])
            stream.log(f"/{topic}/body_rate/{axis}", style, static=True)
    for step, text in scene.events:
        level = "INFO" if step < len(scene) or scene.success else "WARN"
        lines = rr.TextLog.columns(text=[text], level=[level])
        stream.send_columns("/log", [_seconds(scene, [step])], lines)


def _seconds(scene: EpisodeScene, steps: Iterable[int]) -> rr.TimeColumn:
    """Times since the episode's beginning."""
    nanoseconds = [round(step * scene.dt_s * 1e9) for step in steps]
    return rr.TimeColumn("time", duration=np.array(nanoseconds, "timedelta64[ns]"))


def _send_place(stream: rr.RecordingStream, scene: EpisodeScene) -> None:
    """What stands still."""
    place, top = scene.place, top_of_obstacles(scene)
    boxes = place.boxes.numpy()
    size = np.pad(boxes[:, 2:], ((0, 0), (0, 1)), constant_values=top)
    corner = np.pad(boxes[:, :2], ((0, 0), (0, 1)))
    obstacles = rr.Boxes3D(
        mins=corner, sizes=size, colors=[rgba(OBSTACLE, WALL_ALPHA)], fill_mode="solid"
    )
    stream.log("/world/obstacles", obstacles, static=True)
    if len(place.pillars):
        pillars = place.pillars.numpy()
        centre = np.pad(pillars[:, :2], ((0, 0), (0, 1)), constant_values=top / 2)
        shape = rr.Cylinders3D(
            centers=centre,
            lengths=np.full(len(pillars), top),
            radii=pillars[:, 2],
            colors=[rgba(OBSTACLE, WALL_ALPHA)],
            fill_mode="solid",
        )
        stream.log("/world/pillars", shape, static=True)
    stream.log("/map/esdf", _ground(scene, shades(place.esdf.numpy())), static=True)
    plan = np.concatenate((place.start.numpy()[None], place.route.numpy()))
    path = rr.LineStrips3D([plan], colors=[rgba(PLAN)], radii=[PLANNED])
    stream.log("/plan/path", path, static=True)


def _send_movers(stream: rr.RecordingStream, scene: EpisodeScene, times: rr.TimeColumn) -> None:
    """The obstacles that move."""
    top, steps = top_of_obstacles(scene), len(scene)
    movers, places = scene.place.movers.numpy(), scene.mover_places.numpy()
    middle = np.pad(places, ((0, 0), (0, 0), (0, 1)), constant_values=top / 2)
    discs = movers[:, 5] == 0
    style = {"colors": [rgba(MOVER, WALL_ALPHA)], "fill_mode": "solid"}
    if discs.any():
        radii = movers[discs, 4]
        shape = rr.Cylinders3D.from_fields(lengths=np.full(len(radii), top), radii=radii, **style)
        stream.log("/world/moving_pillars", shape, static=True)
        centres = rr.Cylinders3D.columns(centers=middle[:, discs].reshape(-1, 3))
        counts = [len(radii)] * steps
        stream.send_columns("/world/moving_pillars", [times], centres.partition(counts))
    if not discs.all():
        halves = np.pad(movers[~discs, 4:6], ((0, 0), (0, 1)), constant_values=top / 2)
        stream.log(
            "/world/moving_boxes", rr.Boxes3D.from_fields(half_sizes=halves, **style), static=True
        )
        centres = rr.Boxes3D.columns(centers=middle[:, ~discs].reshape(-1, 3))
        counts = [len(halves)] * steps
        stream.send_columns("/world/moving_boxes", [times], centres.partition(counts))


def _send_estimate(stream: rr.RecordingStream, scene: EpisodeScene) -> None:
    """The frames of motion capture and the estimated path, whole from the beginning."""
    frames, guess = scene.path(keys.MOCAP_POSITION_W), scene.path(keys.ESTIMATED_POSITION_W)
    if frames is not None:
        points = rr.Points3D(frames.numpy(), colors=[rgba(MEASURED)], radii=[FRAME])
        stream.log("/drone/measured", points, static=True)
    if guess is not None:
        path = rr.LineStrips3D([guess.numpy()], colors=[rgba(ESTIMATED)], radii=[TRACK])
        stream.log("/drone/estimate", path, static=True)


def _ground(
    scene: EpisodeScene, tint: UInt8[np.ndarray, "h w 4"], height_m: float = 0.0
) -> rr.Mesh3D:
    """The colours of a map, level: a rectangle with a picture of one pixel a cell."""
    place = scene.place
    unit = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
    corners = place.origin.numpy() + unit * place.size.numpy()
    return rr.Mesh3D(
        vertex_positions=np.pad(corners, ((0, 0), (0, 1)), constant_values=height_m),
        vertex_texcoords=unit,  # both count from the first row of the map
        triangle_indices=[(0, 1, 2), (0, 2, 3)],
        albedo_texture=tint,
    )


def _send_learnt(stream: rr.RecordingStream, scene: EpisodeScene) -> None:
    """Each known map, above the true one, and each route, when it was there."""
    below = shades(scene.place.esdf.numpy())
    for known in scene.known:
        over = shaded(known.cells)
        share = over[..., 3:]
        tint = below.copy()
        tint[..., :3] = (1 - share) * below[..., :3] + 255 * share * over[..., :3]
        stream.set_time("time", duration=known.step * scene.dt_s)
        stream.log("/map/known", _ground(scene, tint, KNOWN_M))
    position = scene.column(keys.POSITION_W).numpy()
    for route in scene.routes:
        line = np.concatenate((position[route.step][None], route.points))
        stream.set_time("time", duration=route.step * scene.dt_s)
        stream.log("/plan/route", rr.LineStrips3D([line], colors=[rgba(RENEWED)], radii=[EDGE]))
    stream.reset_time()


def _send_route(stream: rr.RecordingStream, scene: EpisodeScene) -> None:
    """The columns or spheres that control points are passed in, coloured by what is next."""
    place, passed = scene.place, scene.passed.tolist()
    points = place.route.numpy()
    steps = [n for n in range(len(scene)) if n == 0 or passed[n] > passed[n - 1]]
    tints = [[rgba(colour, 0.4) for colour in route_colours(scene, passed[n])] for n in steps]
    if place.half_height is None:
        shape = rr.Ellipsoids3D(centers=points, radii=[place.radius], fill_mode="majorwireframe")
        kind = rr.Ellipsoids3D
    else:
        lengths = [2 * place.half_height]
        shape = rr.Cylinders3D(centers=points, lengths=lengths, radii=[place.radius])
        kind = rr.Cylinders3D
    stream.log("/plan/columns", shape, static=True)
    colours = kind.columns(colors=np.array(tints, np.uint8).reshape(-1, 4))
    counts = [len(points)] * len(steps)
    stream.send_columns("/plan/columns", [_seconds(scene, steps)], colours.partition(counts))


def _send_vehicle(stream: rr.RecordingStream, scene: EpisodeScene, times: rr.TimeColumn) -> None:
    position = scene.column(keys.POSITION_W).numpy()
    attitude = scene.column(keys.ATTITUDE_WB).numpy()[:, (1, 2, 3, 0)]
    where = rr.Transform3D.columns(translation=position, quaternion=attitude)
    stream.send_columns("/drone", [times], where)
    arms = rotor_places(scene)
    discs = rr.Cylinders3D(
        centers=arms,
        lengths=[0.015],
        radii=[rotor_radius(arms)],
        colors=[rgba(colour) for colour in rotor_colours()],
        fill_mode="solid",
    )
    stream.log("/drone/rotors", discs, static=True)
    spokes = rr.LineStrips3D(
        [(arms[0], arms[2]), (arms[1], arms[3])], radii=[ARM_M], colors=[rgba(ROTOR)]
    )
    stream.log("/drone/arms", spokes, static=True)
    ring = rr.LineStrips3D([vehicle_ring()], colors=[rgba(FRONT)], radii=[PLANNED])
    stream.log("/drone/inflation", ring, static=True)
    steps = [*range(1, len(scene), TRAIL_STEPS), len(scene) - 1]
    strips = [position[: step + 1] for step in steps]
    count = len(steps)
    alone = scene.path(keys.ESTIMATED_POSITION_W) is None
    radius = TRAIL if alone else TRACK
    trail = rr.LineStrips3D.columns(
        strips=strips, colors=[rgba(FRONT)] * count, radii=[radius] * count
    )
    stream.send_columns("/plan/flown", [_seconds(scene, steps)], trail)


def _send_sight(
    stream: rr.RecordingStream,
    path: str,
    seen: list[Shape],
    scene: EpisodeScene,
    times: rr.TimeColumn,
) -> None:
    """What an observation sees, at the height of the vehicle."""
    position = scene.column(keys.POSITION_W).numpy()
    for shape in seen:
        places = np.concatenate(
            (shape.places.numpy(), np.repeat(position[:, None, 2:], shape.places.shape[1], 1)), -1
        )
        there = np.asarray(np.isfinite(places).all(-1))
        rows = [row[finite] for row, finite in zip(places, there, strict=True)]
        counts = [len(row) for row in rows]
        name = f"{path}/{shape.label.replace(' ', '_')}"
        stream.log(name, _style(shape), static=True)
        if shape.kind in ("dots", "diamonds"):
            flat = np.concatenate(rows)
            ends = rr.Points3D.columns(positions=flat).partition(counts)
        elif shape.kind == "outline":
            ends = rr.LineStrips3D.columns(strips=rows)
        else:
            pairs = zip(np.repeat(position, counts, 0), np.concatenate(rows), strict=True)
            rays = [np.stack(pair) for pair in pairs]
            ends = rr.LineStrips3D.columns(strips=rays).partition(counts)
        stream.send_columns(name, [times], ends)


def _style(shape: Shape) -> rr.Points3D | rr.LineStrips3D:
    """Colour and radius of a shape, for all steps."""
    if shape.kind in ("dots", "diamonds"):
        return rr.Points3D.from_fields(colors=[rgba(colour_of(shape))], radii=[DOT_M])
    radius = RAY if shape.kind in ("rays", "free") else EDGE
    return rr.LineStrips3D.from_fields(colors=[rgba(colour_of(shape))], radii=[radius])


def _curves(numbers: Numbers) -> Iterator[tuple[str, Float[np.ndarray, " t"]]]:
    """Entity and values of every curve, such as `/state/body_rate/x`."""
    for name, child in numbers.items():
        if isinstance(child, Mapping):
            yield from ((f"{name}/{rest}", values) for rest, values in _curves(child))
        else:
            yield name, child


def _blueprint(scene: EpisodeScene) -> rrb.Blueprint:
    """3-D view on the left, curves and log on the right."""
    place = scene.place
    plan = np.concatenate((place.start.numpy()[None], place.route.numpy()))
    low, high = plan.min(0), plan.max(0)
    middle, length = (low + high) / 2, max(LEAST_M, float(np.linalg.norm(high - low)))
    eye = rrb.EyeControls3D(position=middle + length * EYE, look_target=middle)
    tracks = () if scene.path(keys.ESTIMATED_POSITION_W) is None else ("/drone/estimate",)
    plots = [
        rrb.TimeSeriesView(
            name=title,
            origin="/",
            contents=[curve.path.replace(".", "/") for curve in curves],
            plot_legend=rrb.PlotLegend(visible=len(curves) > 1),
        )
        for title, curves in layouts.curves(scene.reward_names, tracks).items()
    ]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Spatial3DView(name="Flight", origin="/", contents=[*SCENE], eye_controls=eye),
            rrb.Vertical(*plots, rrb.TextLogView(name="Log", origin="/log")),
            column_shares=list(layouts.SHARES),
        ),
        rrb.TimePanel(timeline="time", expanded=False),
        rrb.BlueprintPanel(expanded=False),
        rrb.SelectionPanel(expanded=False),
    )
