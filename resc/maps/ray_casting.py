"""Sphere-traced rays and the guided sector sweep on distance fields: a whole batch at once.

Two renderings of one algorithm. On an accelerator, torch operations march every ray of the batch
together. On the CPU a ray that is done costs nothing only if it is marched alone, so a numba kernel
does that (`resc.maps.cpu_kernels`), opaque to the compiler as the operators `resc::cast` and
`resc::guided`. Both are tested against the same scalar version.
"""

import math

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from resc.maps import cpu_kernels
from resc.maps.constants import (
    GAP_M,
    HALF_SECTOR_RAD,
    INFLATED,
    REACHED_M,
    SHORTEST_STEP_M,
    Surface,
)
from resc.maps.distance_field import DistanceField


def rays(
    field: DistanceField,
    here: Float[Tensor, "n 2"],
    direction: Float[Tensor, "n g b 2"],
    length: Float[Tensor, "n g"],
    longest_m: float,
    surface: Surface = INFLATED,
) -> tuple[Float[Tensor, "n g b"], Bool[Tensor, "n g b"]]:
    """How far rays get [m], and whether they end in an occupied cell; see `cast`.

    Args:
        field: The map of each environment.
        here: Where the rays start.
        direction: Their unit vectors, in fans of `b` rays.
        length: The length of the rays of each fan.
        longest_m: An upper bound of `length`.
        surface: What the rays meet.
    """
    if here.is_cpu:
        return torch.ops.resc.cast(
            field.esdf,
            field.index,
            field.origin_w,
            field.size,
            here,
            direction,
            length,
            field.resolution_m,
            [*surface, field.truncation_m],
        )
    return rays_in_torch(field, here, direction, length, longest_m, surface)


def free_distance(
    field: DistanceField, here: Float[Tensor, "n 2"], offset: Float[Tensor, "n 2"], range_m: float
) -> Float[Tensor, " n"]:
    """How far [m] a ray toward `offset` gets, at most `range_m`; along x without a direction."""
    direction = toward(offset)[:, None, None]
    length = torch.full_like(offset[:, :1], range_m)
    return rays(field, here, direction, length, range_m)[0][:, 0, 0]


def toward(offset: Float[Tensor, "*n 2"]) -> Float[Tensor, "*n 2"]:
    """The unit vector along `offset`; along x if that is zero."""
    length = torch.linalg.vector_norm(offset, dim=-1, keepdim=True)
    along_x = torch.tensor([1.0, 0.0], dtype=offset.dtype, device=offset.device)
    return torch.where(length > 0, offset / torch.where(length > 0, length, 1.0), along_x)


def guided(
    field: DistanceField,
    here: Float[Tensor, "n 2"],
    offset: Float[Tensor, "n g 2"],
    radius: Float[Tensor, "n g"],
    longest_m: float,
) -> Float[Tensor, "n g 4"]:
    """Edges from the vehicle [m]: x, y counter-clockwise, then clockwise of each guide (facts 4.4).

    The sweep covers 60 degrees to each side of a guide ray toward `offset`, up to `radius`. Guide
    ray free: the nearest blocked ray of each side bounds the corridor. Guide ray blocked: where the
    blocking obstacle ends. Each edge is a corner of the cell hit, the one with the least (free) or
    greatest (blocked) angle to the guide. Off the map all are zero.
    """
    if here.is_cpu:
        return torch.ops.resc.guided(
            field.esdf,
            field.index,
            field.origin_w,
            field.size,
            here,
            offset,
            radius,
            field.resolution_m,
            [*INFLATED, field.truncation_m],
        )
    edges = [
        guided_in_torch(field, here, offset[:, g], radius[:, g], longest_m)
        for g in range(offset.shape[1])
    ]
    return torch.stack(edges, 1)


def fan(middle: Float[Tensor, "n g 2"], turn: Float[Tensor, "b 2"]) -> Float[Tensor, "n g b 2"]:
    """Unit vectors turned counter-clockwise by angles whose cosine and sine are `turn`."""
    x, y = middle.unsqueeze(2).unbind(-1)
    cosine, sine = turn.unbind(-1)
    return torch.stack((x * cosine - y * sine, y * cosine + x * sine), -1)


@torch.library.custom_op("resc::cast", mutates_args=(), device_types="cpu")
def _cast_on_cpu(
    esdf: Tensor,
    index: Tensor,
    origin: Tensor,
    size: Tensor,
    here: Tensor,
    direction: Tensor,
    length: Tensor,
    resolution: float,
    limits: list[float],
) -> tuple[Tensor, Tensor]:
    reach = here.new_empty(direction.shape[:-1])
    blocked = torch.empty_like(reach, dtype=torch.bool)
    given = (esdf, index, origin, size, here, direction, length, reach, blocked)
    arrays = [tensor.contiguous().numpy() for tensor in given]
    cpu_kernels.cast_batch(
        *arrays, resolution=resolution, limits=limits, threads=torch.get_num_threads()
    )
    return reach, blocked


@_cast_on_cpu.register_fake
def _(esdf, index, origin, size, here, direction, length, resolution, limits):  # noqa: ANN001, ANN202
    reach = here.new_empty(direction.shape[:-1])
    return reach, torch.empty_like(reach, dtype=torch.bool)


@torch.library.custom_op("resc::guided", mutates_args=(), device_types="cpu")
def _guided_on_cpu(
    esdf: Tensor,
    index: Tensor,
    origin: Tensor,
    size: Tensor,
    here: Tensor,
    offset: Tensor,
    radius: Tensor,
    resolution: float,
    limits: list[float],
) -> Tensor:
    result = here.new_empty(*radius.shape, 4)
    given = (esdf, index, origin, size, here, offset, radius, result)
    arrays = [tensor.contiguous().numpy() for tensor in given]
    cpu_kernels.guided_batch(
        *arrays, resolution=resolution, limits=limits, threads=torch.get_num_threads()
    )
    return result


@_guided_on_cpu.register_fake
def _(esdf, index, origin, size, here, offset, radius, resolution, limits):  # noqa: ANN001, ANN202
    return here.new_empty(*radius.shape, 4)


def cast(
    field: DistanceField,
    here: Float[Tensor, "n 2"],
    direction_x: Float[Tensor, "*k n"],
    direction_y: Float[Tensor, "*k n"],
    length: Float[Tensor, "*k n"],
    longest_m: float,
    surface: Surface = INFLATED,
) -> tuple[Float[Tensor, "*k n"], Bool[Tensor, "*k n"]]:
    """How far rays get [m], and whether the cell they end in is occupied (facts 4.3).

    Environments last.

    Each jump is the stored distance less the surface's margin, at least `SHORTEST_STEP_M`. A ray
    ends in the first occupied cell, before the jump that leaves the map, or at its length; the last
    jump may overshoot the length, and the start cell is not tested. Without length it does not
    exist.

    Args:
        field: The map of each environment.
        here: Where the rays start.
        direction_x: x of their unit directions.
        direction_y: y of their unit directions.
        length: Their lengths.
        longest_m: An upper bound of `length`; sets the number of jumps.
        surface: What the rays meet.
    """
    x, y = here.unbind(-1)
    travelled = torch.zeros_like(length)
    reached = length
    active = length > 0
    distance = field.at(x, y).expand_as(length)
    for _ in range(math.ceil(longest_m / SHORTEST_STEP_M) + 1):
        next_travelled = travelled + (distance - surface.margin_m).clamp(min=SHORTEST_STEP_M)
        next_x, next_y = x + next_travelled * direction_x, y + next_travelled * direction_y
        distance = field.at(next_x, next_y)
        inside = field.inside(next_x, next_y)
        stops = active & ((distance < surface.occupied_m) | ~inside)
        reached = torch.where(stops, torch.where(inside, next_travelled, travelled), reached)
        active = active & ~stops & (next_travelled < length)
        travelled = next_travelled
    end = field.at(x + reached * direction_x, y + reached * direction_y)
    return reached, end < surface.occupied_m


def rays_in_torch(
    field: DistanceField,
    here: Float[Tensor, "n 2"],
    direction: Float[Tensor, "n g b 2"],
    length: Float[Tensor, "n g"],
    longest_m: float,
    surface: Surface = INFLATED,
) -> tuple[Float[Tensor, "n g b"], Bool[Tensor, "n g b"]]:
    """`rays` by torch operations alone, every ray of the batch marched together."""
    x, y = direction.permute(3, 1, 2, 0)  # [g, b, n]
    lengths = length.T.unsqueeze(1).expand_as(x)
    reach, blocked = cast(field, here, x, y, lengths, longest_m, surface)
    return reach.permute(2, 0, 1), blocked.permute(2, 0, 1)


def guided_in_torch(
    field: DistanceField,
    here: Float[Tensor, "n 2"],
    offset: Float[Tensor, "n 2"],
    radius: Float[Tensor, " n"],
    longest_m: float,
) -> Float[Tensor, "n 4"]:
    """`guided` for one guide by torch operations alone, every ray of the batch marched together."""
    step = torch.atan2(torch.full_like(radius, field.resolution_m / 2), radius)
    rays = math.ceil(HALF_SECTOR_RAD / math.atan2(field.resolution_m / 2, longest_m))
    ahead = toward(offset)
    guide = torch.atan2(ahead[:, 1], ahead[:, 0])
    number = torch.arange(rays + 1, device=step.device, dtype=step.dtype)[:, None, None]
    side = torch.tensor([1.0, -1.0], device=step.device, dtype=step.dtype)[:, None]
    angle = guide + side * (number * step)  # [rays + 1, 2, n]
    cos, sin = angle.cos(), angle.sin()
    reached, blocked = cast(field, here, cos, sin, radius.expand_as(angle), longest_m)
    exists = ((number - 1) * step < HALF_SECTOR_RAD).expand_as(blocked)
    ray = _ending_ray(reached, blocked, radius, exists).unsqueeze(0)
    hit_x = here[:, 0] + (reached * cos).gather(0, ray)[0]
    hit_y = here[:, 1] + (reached * sin).gather(0, ray)[0]
    edge_x, edge_y = _corner(field, here, offset, hit_x, hit_y, ~blocked[0, 0])
    edges = torch.stack((edge_x[0], edge_y[0], edge_x[1], edge_y[1]), -1)
    return torch.where(field.inside(here[:, 0], here[:, 1]).unsqueeze(-1), edges, 0.0)


def _ending_ray(
    reached: Float[Tensor, "k 2 n"],
    blocked: Bool[Tensor, "k 2 n"],
    radius: Float[Tensor, " n"],
    exists: Bool[Tensor, "k 2 n"],
) -> Int[Tensor, "2 n"]:
    """Which ray of each side the edge lies on; ray 0 is the guide itself.

    Guide free: the first blocked ray, else the last. Guide blocked: the last blocked ray before the
    first gap (a jump of more than `GAP_M`) or free ray.
    """
    guide_blocked = blocked[0]
    last = torch.zeros_like(reached[0], dtype=torch.int64)
    last_distance = reached[0]
    stopped = torch.zeros_like(guide_blocked)
    for k in range(1, reached.shape[0]):
        far, hit = reached[k], blocked[k]
        gap = hit & (far - last_distance > GAP_M)
        clear = ~hit & (radius - far < REACHED_M)
        running = exists[k] & ~stopped
        moves = running & torch.where(guide_blocked, hit & ~gap, True)
        last = torch.where(moves, k, last)
        last_distance = torch.where(moves, far, last_distance)
        stopped = stopped | (running & torch.where(guide_blocked, gap | clear, hit))
    return last


def _corner(
    field: DistanceField,
    here: Float[Tensor, "n 2"],
    offset: Float[Tensor, "n 2"],
    x: Float[Tensor, "2 n"],
    y: Float[Tensor, "2 n"],
    nearest: Bool[Tensor, " n"],
) -> tuple[Float[Tensor, "2 n"], Float[Tensor, "2 n"]]:
    """Corner of (x, y)'s cell at the least (or greatest) angle to the guide, from here [m]."""
    resolution, origin = field.resolution_m, field.origin_w
    west = ((x - origin[:, 0]) / resolution).floor() * resolution + origin[:, 0] - here[:, 0]
    south = ((y - origin[:, 1]) / resolution).floor() * resolution + origin[:, 1] - here[:, 1]
    ux, uy = offset.unbind(-1)
    best_x, best_y, best = west, south, torch.full_like(west, -torch.inf)
    sign = torch.where(nearest, 1.0, -1.0)
    for east in (0.0, resolution):
        for north in (0.0, resolution):
            corner_x, corner_y = west + east, south + north
            reach = (corner_x.square() + corner_y.square()).sqrt().clamp(min=1e-9)
            score = (
                sign * (corner_x * ux + corner_y * uy) / reach
            )  # the cosine falls as the angle grows
            better = score > best
            best_x, best_y = (
                torch.where(better, corner_x, best_x),
                torch.where(better, corner_y, best_y),
            )
            best = torch.where(better, score, best)
    return best_x, best_y
