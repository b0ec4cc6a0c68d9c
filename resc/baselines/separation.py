"""Half-planes that part points from obstacles: where a point may move and keep its distance."""

import numpy as np
from jaxtyping import Float

from resc.baselines.mpc_programme import Sides

FAR_M = 1e3
SMALL_M = 1e-6


def separating(
    points: Float[np.ndarray, "t 2"],
    boxes: Float[np.ndarray, "k 4"],
    pillars: Float[np.ndarray, "m 3"],
    margin_m: float,
    count: int,
) -> Sides:
    """For each point, half-planes that keep it `margin_m` from its `count` nearest obstacles.

    Obstacles are convex, so whatever lies in the half-plane beyond the point of a surface that is
    nearest, at right angles to the way there, keeps its distance from the whole obstacle. Where
    there are fewer obstacles, the rest are half-planes far away.

    Args:
        points: [m].
        boxes: `[x, y, len_x, len_y]` from the lower-left corner [m].
        pillars: `[x, y, radius]` [m].
        margin_m: Distance to keep.
        count: Half-planes for each point.
    """
    normals, distances = (
        np.concatenate(parts, 1)
        for parts in zip(_from_boxes(points, boxes), _from_pillars(points, pillars), strict=True)
    )
    missing = max(0, count - distances.shape[1])
    normals = np.pad(normals, ((0, 0), (0, missing), (0, 0)))
    distances = np.pad(distances, ((0, 0), (0, missing)), constant_values=FAR_M)
    near = np.argsort(distances, 1)[:, :count]
    distances = np.take_along_axis(distances, near, 1)
    normals = np.take_along_axis(normals, near[..., None], 1)
    at = (normals * points[:, None]).sum(-1)
    return Sides(normals, at - distances + margin_m)


def _from_boxes(
    points: Float[np.ndarray, "t 2"], boxes: Float[np.ndarray, "k 4"]
) -> tuple[Float[np.ndarray, "t k 2"], Float[np.ndarray, "t k"]]:
    """Outward normals, and signed distances [m]: negative inside."""
    half = boxes[:, 2:] / 2
    offset = points[:, None] - boxes[:, :2] - half
    side = np.where(offset < 0, -1.0, 1.0)
    beyond = np.abs(offset) - half
    out = beyond.clip(min=0)
    outside = np.linalg.norm(out, axis=-1)
    deepest = beyond.max(-1)
    inward = np.eye(2)[beyond.argmax(-1)]  # [t, k, 2]
    corner = out / outside[..., None].clip(min=SMALL_M)
    normals = side * np.where(outside[..., None] > SMALL_M, corner, inward)
    return normals, np.where(outside > SMALL_M, outside, deepest)


def _from_pillars(
    points: Float[np.ndarray, "t 2"], pillars: Float[np.ndarray, "m 3"]
) -> tuple[Float[np.ndarray, "t m 2"], Float[np.ndarray, "t m"]]:
    """The same from round pillars."""
    offset = points[:, None] - pillars[:, :2]
    away = np.linalg.norm(offset, axis=-1)
    return offset / away[..., None].clip(min=SMALL_M), away - pillars[:, 2]
