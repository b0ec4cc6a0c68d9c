"""A recorded episode as a scene file for Foxglove and Lichtblick (docs/scenes.md)."""

import mimetypes
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple, Protocol

import numpy as np
from foxglove.messages import (
    Color,
    FrameTransform,
    Grid,
    Log,
    LogLevel,
    PointCloud,
    PoseInFrame,
    PosesInFrame,
    Quaternion,
    SceneUpdate,
    Vector3,
)
from jaxtyping import Float
from mcap.writer import CompressionType, Writer

from resc import keys
from resc.errors import RecordingError
from resc.recording.reader import RolloutLog
from resc.run_folder import replacing
from resc.viewing import layouts
from resc.viewing.appearance import (
    TRAIL_STEPS,
    WALL_ALPHA,
    map_centres,
    obstacle_surface,
    pillar_surface,
    rgba,
    rotor_colours,
    rotor_outline,
    rotor_places,
    rotor_radius,
    route_colours,
    scene_numbers,
    shades,
    top_of_obstacles,
    vehicle_ring,
)
from resc.viewing.colours import FRONT, MEASURED, MOVER, OBSTACLE, ROTOR
from resc.viewing.episode_scene import CONFIG, EpisodeScene, load_scene
from resc.viewing.foxglove_messages import (
    LINE_KINDS,
    cube,
    cylinder,
    entity,
    grid,
    outline,
    paint,
    point_cloud,
    pose,
    sight_lines,
    sight_points,
    sphere,
    stamp,
)
from resc.viewing.known_picture import shaded
from resc.viewing.scalars import Numbers, encode_scalars, scalar_schema

WORLD, DRONE = "world", "drone"
SDK_TYPES = {
    "/tf": FrameTransform,
    "/drone/pose": PoseInFrame,
    "/drone/body": SceneUpdate,
    "/drone/points": PointCloud,
    "/drone/trail": PosesInFrame,
    "/world/obstacles": SceneUpdate,
    "/world/obstacle_points": PointCloud,
    "/map/esdf_slice": Grid,
    "/map/esdf_points": PointCloud,
    "/plan/path": PosesInFrame,
    "/plan/columns": SceneUpdate,
    "/plan/control_points": PointCloud,
    "/log": Log,
}
"""Message type of each topic; `/observation/*` and the numbers follow."""
ESTIMATES = {
    "/drone/measured": (keys.MOCAP_POSITION_W, PointCloud),
    "/drone/estimate": (keys.ESTIMATED_POSITION_W, PosesInFrame),
}
"""Topics of recordings that hold such a column, and their message type."""
MOVERS = {"/world/movers": SceneUpdate, "/world/mover_points": PointCloud}
"""Topics of flights among obstacles that move."""
KNOWN, ROUTE = "/map/known", "/plan/route"
"""Topics of flights whose map was seen, and whose routes were renewed."""
KNOWN_M = 0.02
"""Height at which the known map is drawn: above the true one."""


class _Encodes(Protocol):
    def encode(self) -> bytes: ...


class Message(NamedTuple):
    """One message: when [ns since the episode's beginning], where, what."""

    time_ns: int
    topic: str
    data: bytes


def write_scene(
    log: RolloutLog, episode: int, path: Path, *, allowed: Iterable[str] = ()
) -> Path:  # fmt: skip
    """Writes a finished episode as a scene file; returns its path.

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
    with replacing(path, RecordingError) as unfinished, unfinished.open("wb") as file:
        _write(scene, file)
    return path


def _write(scene: EpisodeScene, file: IO[bytes]) -> None:
    numbers = scene_numbers(scene)
    writer = Writer(file, chunk_size=1 << 20, compression=CompressionType.ZSTD)
    writer.start(profile="", library="resc")
    writer.add_metadata("resc.run", scene.run)
    writer.add_metadata("resc.episode", scene.facts)
    seen = [topic.removeprefix("/observation/") for topic in _observation_types(scene)]
    names = (scene.reward_names, seen, [*_tracks(scene)])
    documents = {
        CONFIG: scene.config,
        "foxglove_layout.json": layouts.foxglove(*names).encode(),
        "lichtblick_layout.json": layouts.lichtblick(*names).encode(),
    }
    for name, data in documents.items():
        kind = mimetypes.guess_type(name)[0] or "application/octet-stream"
        writer.add_attachment(create_time=0, log_time=0, name=name, media_type=kind, data=data)
    channels = _channels(writer, scene, numbers)
    for time_ns, topic, data in sorted(_messages(scene, numbers), key=lambda m: m.time_ns):
        writer.add_message(channels[topic], time_ns, data, time_ns)
    writer.finish()


def _channels(writer: Writer, scene: EpisodeScene, numbers: dict[str, Numbers]) -> dict[str, int]:
    """Channel number of each topic."""
    types: dict[str, Any] = {**SDK_TYPES, **_observation_types(scene)}
    types |= _tracks(scene)
    schemas: dict[str, tuple[str, bytes]] = {}
    for topic, kind in types.items():
        schema = kind.get_schema()
        schemas[topic] = (schema.name, schema.data)
    for topic, values in numbers.items():
        name = topic.removeprefix("/").capitalize()
        schemas[topic] = (f"resc.{name}", scalar_schema(name, values))
    known = {
        name: writer.register_schema(name, "protobuf", data)
        for name, data in dict(schemas.values()).items()
    }
    return {
        topic: writer.register_channel(topic, "protobuf", known[name])
        for topic, (name, _) in schemas.items()
    }


def _tracks(scene: EpisodeScene) -> dict[str, Any]:
    """Message type of each track beside the true one, of those that are recorded."""
    found = {topic: kind for topic, (key, kind) in ESTIMATES.items() if scene.path(key) is not None}
    found |= MOVERS if len(scene.place.movers) else {}
    found |= {KNOWN: Grid} if scene.known else {}
    return found | ({ROUTE: PosesInFrame} if scene.routes else {})


def _observation_types(scene: EpisodeScene) -> dict[str, Any]:
    """Message type of each topic that shows an observation; lines only where it has some."""
    types: dict[str, Any] = {}
    for name, seen in scene.sights.items():
        types[f"/observation/{name}_points"] = PointCloud
        if any(shape.kind in LINE_KINDS for shape in seen):
            types[f"/observation/{name}"] = SceneUpdate
    return types


def _messages(scene: EpisodeScene, numbers: dict[str, Numbers]) -> Iterator[Message]:
    for topic, message in (*_static(scene), *_estimated(scene)):
        yield Message(0, topic, message.encode())
    times = [round(step * scene.dt_s * 1e9) for step in range(len(scene) + 1)]
    for topic, values in numbers.items():
        for time_ns, data in zip(times[:-1], encode_scalars(values), strict=True):
            yield Message(time_ns, topic, data)
    moving = (*_learnt(scene, times), *_moving(scene, times), *_movers(scene, times))
    for time_ns, topic, message in moving:
        yield Message(time_ns, topic, message.encode())
    positions = scene.column(keys.POSITION_W).numpy()
    for name, seen in scene.sights.items():
        topic = f"/observation/{name}"
        for time_ns, message in sight_lines(name, seen, positions, times[:-1]):
            yield Message(time_ns, topic, message.encode())
        for time_ns, message in sight_points(seen, positions, times[:-1]):
            yield Message(time_ns, f"{topic}_points", message.encode())
    for step, text in scene.events:
        level = LogLevel.Info if step < len(scene) or scene.success else LogLevel.Warning
        message = Log(timestamp=stamp(times[step]), level=level, message=text, name="resc")
        yield Message(times[step], "/log", message.encode())


def _static(scene: EpisodeScene) -> Iterator[tuple[str, _Encodes]]:
    """What stands still, each once."""
    place = scene.place
    arms = rotor_places(scene)
    yield "/drone/body", _body(arms)
    top = top_of_obstacles(scene)
    boxes = place.boxes.tolist()
    wall = paint(OBSTACLE, WALL_ALPHA)
    cubes = [cube((x + dx / 2, y + dy / 2, top / 2), (dx, dy, top), wall) for x, y, dx, dy in boxes]
    pillars = place.pillars.tolist()
    rounds = [cylinder((x, y, top / 2), radius, top, wall) for x, y, radius in pillars]
    yield "/world/obstacles", entity("obstacles", cubes=cubes, cylinders=rounds)
    surfaces = [obstacle_surface(box, top) for box in boxes]
    surfaces += [pillar_surface(pillar, top) for pillar in pillars]
    surface = np.concatenate([np.empty((0, 3)), *surfaces])
    colour = np.array(rgba(OBSTACLE), np.uint8)
    yield "/world/obstacle_points", point_cloud(surface, colour, time_ns=0, frame=WORLD)
    distance = place.esdf.numpy()
    tint = shades(distance)
    corner = (*place.origin.tolist(), 0.0)
    cell = place.resolution
    yield "/map/esdf_slice", grid(distance, tint, corner=corner, cell_m=cell)
    yield (
        "/map/esdf_points",
        point_cloud(
            map_centres(scene), tint.reshape(-1, 4),
            time_ns=0, frame=WORLD, distances=distance.reshape(-1),
        ),
    )  # fmt: skip
    plan = [place.start.tolist(), *place.route.tolist()]
    yield (
        "/plan/path",
        PosesInFrame(timestamp=stamp(0), frame_id=WORLD, poses=[pose(point) for point in plan]),
    )


def _estimated(scene: EpisodeScene) -> Iterator[tuple[str, _Encodes]]:
    """The frames of motion capture and the estimated path, whole from the beginning."""
    frames, guess = scene.path(keys.MOCAP_POSITION_W), scene.path(keys.ESTIMATED_POSITION_W)
    if frames is not None:
        tint = np.array(rgba(MEASURED), np.uint8)
        yield "/drone/measured", point_cloud(frames.numpy(), tint, time_ns=0, frame=WORLD)
    if guess is not None:
        poses = [pose(point) for point in guess.tolist()]
        path = PosesInFrame(timestamp=stamp(0), frame_id=WORLD, poses=poses)
        yield "/drone/estimate", path


def _learnt(scene: EpisodeScene, times: list[int]) -> Iterator[tuple[int, str, _Encodes]]:
    """Each known map and each route, when it was there."""
    place, position = scene.place, scene.column(keys.POSITION_W).tolist()
    corner = (*place.origin.tolist(), KNOWN_M)
    for known in scene.known:
        now, tint = times[known.step], (255 * shaded(known.cells)).astype(np.uint8)
        numbers = known.cells.astype(np.float64)
        drawn = {"corner": corner, "cell_m": place.resolution, "name": "known", "time_ns": now}
        yield now, KNOWN, grid(numbers, tint, **drawn)
    for route in scene.routes:
        now = times[route.step]
        poses = [pose(point) for point in (position[route.step], *route.points.tolist())]
        yield now, ROUTE, PosesInFrame(timestamp=stamp(now), frame_id=WORLD, poses=poses)


def _moving(scene: EpisodeScene, times: list[int]) -> Iterator[tuple[int, str, _Encodes]]:
    """What moves, step by step."""
    position = scene.column(keys.POSITION_W).tolist()
    attitude = scene.column(keys.ATTITUDE_WB).tolist()
    passed = scene.passed.tolist()
    outline, tints = rotor_outline(rotor_places(scene))
    trail = [pose(point) for point in position]
    for step, (here, turned) in enumerate(zip(position, attitude, strict=True)):
        now, (qw, qx, qy, qz) = times[step], turned
        x, y, z = here
        yield (
            now,
            "/tf",
            FrameTransform(
                timestamp=stamp(now),
                parent_frame_id=WORLD,
                child_frame_id=DRONE,
                translation=Vector3(x=x, y=y, z=z),
                rotation=Quaternion(x=qx, y=qy, z=qz, w=qw),
            ),
        )
        there = PoseInFrame(timestamp=stamp(now), frame_id=WORLD, pose=pose(here, turned))
        yield now, "/drone/pose", there
        yield now, "/drone/points", point_cloud(outline, tints, time_ns=now, frame=DRONE)
        if step % TRAIL_STEPS == 0 or step == len(scene) - 1:
            flown = PosesInFrame(timestamp=stamp(now), frame_id=WORLD, poses=trail[: step + 1])
            yield now, "/drone/trail", flown
        if step == 0 or passed[step] > passed[step - 1]:
            yield now, "/plan/columns", _columns(scene, passed[step], now)
            yield now, "/plan/control_points", _control_points(scene, passed[step], now)


def _movers(scene: EpisodeScene, times: list[int]) -> Iterator[tuple[int, str, _Encodes]]:
    """The obstacles that move, step by step."""
    place, top = scene.place, top_of_obstacles(scene)
    if not len(place.movers):
        return
    halves, tint = place.movers[:, 4:6].tolist(), paint(MOVER, WALL_ALPHA)
    shapes = [
        obstacle_surface([-x, -y, 2 * x, 2 * y], top) if y else pillar_surface([0.0, 0.0, x], top)
        for x, y in halves
    ]
    colour = np.array(rgba(MOVER), np.uint8)
    for now, centres in zip(times[:-1], scene.mover_places.tolist(), strict=True):
        boxes, rounds = [], []
        for (x, y), (half_x, half_y) in zip(centres, halves, strict=True):
            middle = (x, y, top / 2)
            if half_y:
                boxes.append(cube(middle, (2 * half_x, 2 * half_y, top), tint))
            else:
                rounds.append(cylinder(middle, half_x, top, tint))
        yield now, "/world/movers", entity("movers", time_ns=now, cubes=boxes, cylinders=rounds)
        offsets = np.pad(np.array(centres), ((0, 0), (0, 1)))
        there = [shape + offset for shape, offset in zip(shapes, offsets, strict=True)]
        cloud = point_cloud(np.concatenate(there), colour, time_ns=now, frame=WORLD)
        yield now, "/world/mover_points", cloud


def _body(arms: Float[np.ndarray, "4 3"]) -> SceneUpdate:
    radius = rotor_radius(arms)
    discs = [
        cylinder(arm, radius, 0.015, paint(colour, 0.85))
        for arm, colour in zip(arms.tolist(), rotor_colours(), strict=True)
    ]
    hull = cube((0.0, 0.0, 0.0), (arms[0, 0] * 1.4, arms[0, 0] * 0.8, 0.05), paint(ROTOR))
    ring = outline(vehicle_ring().tolist(), paint(FRONT))
    return entity("drone", frame=DRONE, cylinders=discs, cubes=[hull], lines=[ring])


def _columns(scene: EpisodeScene, passed: int, now: int) -> SceneUpdate:
    place = scene.place
    paints: list[Color] = [paint(colour, 0.25) for colour in route_colours(scene, passed)]
    points = list(zip(place.route.tolist(), paints, strict=True))
    if place.half_height is None:
        spheres = [sphere(point, place.radius, tint) for point, tint in points]
        return entity("columns", time_ns=now, spheres=spheres)
    height = 2 * place.half_height
    cylinders = [cylinder(point, place.radius, height, tint) for point, tint in points]
    return entity("columns", time_ns=now, cylinders=cylinders)


def _control_points(scene: EpisodeScene, passed: int, now: int) -> PointCloud:
    tints = np.array([rgba(colour) for colour in route_colours(scene, passed)], np.uint8)
    return point_cloud(scene.place.route.numpy(), tints, time_ns=now, frame=WORLD)
