"""Foxglove's message types from arrays: the pieces that a scene file is made of."""

from collections.abc import Iterator, Sequence

import numpy as np
from foxglove.messages import (
    Color,
    CubePrimitive,
    CylinderPrimitive,
    Duration,
    Grid,
    LinePrimitive,
    LinePrimitiveLineType,
    PackedElementField,
    PackedElementFieldNumericType,
    Point3,
    PointCloud,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    SpherePrimitive,
    Timestamp,
    TriangleListPrimitive,
    Vector2,
    Vector3,
)
from jaxtyping import Float, UInt8

from resc.sights import Shape
from resc.viewing.appearance import rgba
from resc.viewing.sight import colour_of

LEVEL = Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
HERE = Pose(position=Vector3(x=0.0, y=0.0, z=0.0), orientation=LEVEL)
FOREVER = Duration(0)
RAY_PX, EDGE_PX = 1.5, 3.0
"""Thickness of lines on the screen: they are seen from afar and stay thin near."""
SECTOR_ALPHA = 0.15
LINE_KINDS = ("edges", "free", "rays", "arrow", "outline")

_FLOAT, _BYTE = PackedElementFieldNumericType.Float32, PackedElementFieldNumericType.Uint8
_RGBA = ("red", "green", "blue", "alpha")
_COLOURED = np.dtype([("xyz", "<f4", 3), ("distance", "<f4"), ("rgba", "u1", 4)])
_CELL = np.dtype([("distance", "<f4"), ("rgba", "u1", 4)])


def _fields(names: Sequence[str]) -> list[PackedElementField]:
    """Float32 fields one after the other, then the bytes of the colour."""
    floats = [
        PackedElementField(name=name, offset=4 * number, type=_FLOAT)
        for number, name in enumerate(names)
    ]
    return floats + [
        PackedElementField(name=name, offset=4 * len(names) + number, type=_BYTE)
        for number, name in enumerate(_RGBA)
    ]


_POINT_FIELDS = _fields(("x", "y", "z", "distance"))


def stamp(time_ns: int) -> Timestamp:
    """A time since the episode's beginning."""
    return Timestamp(sec=time_ns // 10**9, nsec=time_ns % 10**9)


def paint(colour: str, alpha: float = 1.0) -> Color:
    """A colour as messages have it."""
    red, green, blue, opacity = (channel / 255 for channel in rgba(colour, alpha))
    return Color(r=red, g=green, b=blue, a=opacity)


def pose(position: Sequence[float], attitude_wxyz: Sequence[float] | None = None) -> Pose:
    """A pose; level without an attitude."""
    x, y, z = position
    if attitude_wxyz is None:
        return Pose(position=Vector3(x=x, y=y, z=z), orientation=LEVEL)
    qw, qx, qy, qz = attitude_wxyz
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def cube(centre: Sequence[float], size: Sequence[float], colour: Color) -> CubePrimitive:
    """A box along the axes."""
    x, y, z = size
    return CubePrimitive(pose=pose(centre), size=Vector3(x=x, y=y, z=z), color=colour)


def cylinder(
    centre: Sequence[float], radius: float, height: float, colour: Color
) -> CylinderPrimitive:
    """An upright cylinder."""
    size = Vector3(x=2 * radius, y=2 * radius, z=height)
    return CylinderPrimitive(
        pose=pose(centre), size=size, bottom_scale=1.0, top_scale=1.0, color=colour
    )


def sphere(centre: Sequence[float], radius: float, colour: Color) -> SpherePrimitive:
    """A sphere."""
    size = Vector3(x=2 * radius, y=2 * radius, z=2 * radius)
    return SpherePrimitive(pose=pose(centre), size=size, color=colour)


def point_cloud(
    places: Float[np.ndarray, "n 3"],
    colours: UInt8[np.ndarray, "*n 4"],
    *,
    time_ns: int,
    frame: str,
    distances: Float[np.ndarray, " n"] | None = None,
) -> PointCloud:
    """Points [m] with colours and, where measured, a distance [m]; others have none (NaN)."""
    packed = np.empty(len(places), _COLOURED)
    packed["xyz"], packed["rgba"] = places, colours
    packed["distance"] = np.nan if distances is None else distances
    return _cloud(packed.tobytes(), time_ns, frame)


def _cloud(data: bytes, time_ns: int, frame: str) -> PointCloud:
    return PointCloud(
        timestamp=stamp(time_ns),
        frame_id=frame,
        pose=HERE,
        point_stride=_COLOURED.itemsize,
        fields=_POINT_FIELDS,
        data=data,
    )


def grid(
    distances: Float[np.ndarray, "h w"],
    colours: UInt8[np.ndarray, "h w 4"],
    *,
    corner: Sequence[float],
    cell_m: float,
    name: str = "distance",
    time_ns: int = 0,
) -> Grid:
    """A map seen from above, its first row the lowest y; `name` is that of its numbers."""
    packed = np.empty(distances.shape, _CELL)
    packed["distance"], packed["rgba"] = distances, colours
    width = distances.shape[1]
    return Grid(
        timestamp=stamp(time_ns),
        frame_id="world",
        pose=pose(corner),
        column_count=width,
        cell_size=Vector2(x=cell_m, y=cell_m),
        row_stride=width * _CELL.itemsize,
        cell_stride=_CELL.itemsize,
        fields=_fields((name,)),
        data=packed.tobytes(),
    )


def outline(places: Sequence[Sequence[float]], colour: Color) -> LinePrimitive:
    """A thin line through places."""
    points = [Point3(x=x, y=y, z=z) for x, y, z in places]
    return _line(points, LinePrimitiveLineType.LineStrip, RAY_PX, colour)


def entity(name: str, *, time_ns: int = 0, frame: str = "world", **primitives: list) -> SceneUpdate:
    """One entity that replaces the last of its name, and stays until it is replaced."""
    return SceneUpdate(
        entities=[
            SceneEntity(
                timestamp=stamp(time_ns),
                frame_id=frame,
                id=name,
                lifetime=FOREVER,
                frame_locked=True,
                **primitives,
            )
        ]
    )


def sight_lines(
    name: str, seen: Sequence[Shape], positions: Float[np.ndarray, "t 3"], times: Sequence[int]
) -> Iterator[tuple[int, SceneUpdate]]:
    """The lines and sectors that an observation sees, at the height of the vehicle, by time."""
    prepared = [
        (
            shape.kind,
            shape.places.tolist(),
            paint(colour_of(shape)),
            paint(colour_of(shape), SECTOR_ALPHA),
        )
        for shape in seen
        if shape.kind in LINE_KINDS
    ]
    if not prepared:
        return
    for step, (time_ns, (x, y, z)) in enumerate(zip(times, positions.tolist(), strict=True)):
        origin = Point3(x=x, y=y, z=z)
        lines, sectors = [], []
        for kind, places, colour, tint in prepared:
            ends = [Point3(x=px, y=py, z=z) for px, py in places[step] if px == px]  # not NaN
            if not ends:
                continue
            if kind == "outline":
                lines.append(_line(ends, LinePrimitiveLineType.LineStrip, RAY_PX, colour))
                continue
            rays = [point for end in ends for point in (origin, end)]
            thickness = RAY_PX if kind in ("rays", "free") else EDGE_PX
            lines.append(_line(rays, LinePrimitiveLineType.LineList, thickness, colour))
            if kind == "edges":
                sector = [origin, *ends]
                sectors.append(TriangleListPrimitive(pose=HERE, points=sector, color=tint))
        yield time_ns, entity(name, time_ns=time_ns, lines=lines, triangles=sectors)


def sight_points(
    seen: Sequence[Shape], positions: Float[np.ndarray, "t 3"], times: Sequence[int]
) -> Iterator[tuple[int, PointCloud]]:
    """The ends of what an observation sees, at the height of the vehicle, by time."""
    shown = [shape for shape in seen if shape.kind != "outline"]
    flat = np.concatenate([shape.places.numpy() for shape in shown], 1)
    packed = np.empty(flat.shape[:2], _COLOURED)
    packed["xyz"][..., :2], packed["xyz"][..., 2] = flat, positions[:, 2:]
    packed["distance"] = np.nan
    first = 0
    for shape in shown:
        columns = slice(first, first := first + shape.places.shape[1])
        packed["rgba"][:, columns] = rgba(colour_of(shape))
        if shape.values is not None:
            packed["distance"][:, columns] = shape.values.numpy()
    there = np.asarray(np.isfinite(flat).all(-1))
    for time_ns, row, finite in zip(times, packed, there, strict=True):
        yield time_ns, _cloud(row[finite].tobytes(), time_ns, "world")


def _line(
    points: list[Point3], kind: LinePrimitiveLineType, thickness: float, colour: Color
) -> LinePrimitive:
    return LinePrimitive(
        type=kind, pose=HERE, thickness=thickness, scale_invariant=True, points=points, color=colour
    )
