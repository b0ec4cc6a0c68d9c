"""The rays of `resc.maps.ray_casting` on a GPU, in Triton: a lane per ray.

Positions in single precision, from the map's lower-left corner, as on the CPU
(`resc.maps.cpu_kernels`). `cast` marches a block of rays of any environments in step; `guided` is
one warp per environment, guide and side, which sweeps its sector in fans of `LANES` rays. Triton's
interpreter runs both on the CPU, which is how they are tested where there is no GPU.
"""

# A launch takes more arguments than the kernel has, which Triton's annotations do not know:
# pyright: reportCallIssue=false

from typing import no_type_check

import torch
import triton
import triton.language as tl
from jaxtyping import Float, Int
from torch import Tensor

from resc.maps.cells import SLACK
from resc.maps.constants import GAP_M, HALF_SECTOR_RAD, REACHED_M, SHORTEST_STEP_M

LANES = 32
"""Rays of a sector marched in step: a warp."""
BLOCK = 128
"""Rays of `cast` marched in step."""
_STEP = tl.constexpr(SHORTEST_STEP_M)
_SLACK = tl.constexpr(SLACK)
_SECTOR = tl.constexpr(HALF_SECTOR_RAD)
_GAP = tl.constexpr(GAP_M)
_REACHED = tl.constexpr(REACHED_M)
_NONE = tl.constexpr(1 << 20)
"""Number of a ray that there is not."""


@triton.jit
@no_type_check
def _last(size, cells, per_m):
    """Middle of the last column or row (`resc.maps.cells.last_cell`)."""
    return tl.minimum(tl.ceil(size * per_m - _SLACK), cells * 1.0) - 0.5


@triton.jit
@no_type_check
def _at(field, x, y, last_x, last_y, width, per_m, truncation, mask):
    """Distance stored in the cell of (x, y), clamped to the map."""
    column = tl.minimum(tl.maximum(x * per_m, 0.0), last_x).to(tl.int32)
    row = tl.minimum(tl.maximum(y * per_m, 0.0), last_y).to(tl.int32)
    return tl.minimum(tl.load(field + row * width + column, mask=mask, other=0.0), truncation)


@triton.jit
@no_type_check
def _march(
    field, x, y, ux, uy, length, size_x, size_y, last_x, last_y, width, per_m,
    occupied, margin, truncation, exists,
):  # fmt: skip
    """How far each ray gets, and whether the cell that it ends in is occupied (facts 4.3)."""
    travelled = length * 0.0
    distance = _at(field, x, y, last_x, last_y, width, per_m, truncation, exists)
    active = exists & (length > 0)
    while tl.max(active.to(tl.int32), 0) > 0:
        ahead = travelled + tl.maximum(distance - margin, _STEP)
        qx, qy = x + ahead * ux, y + ahead * uy
        inside = active & (qx >= 0) & (qy >= 0) & (qx < size_x) & (qy < size_y)
        found = _at(field, qx, qy, last_x, last_y, width, per_m, truncation, inside)
        travelled = tl.where(inside, ahead, travelled)
        distance = tl.where(inside, found, distance)
        active = inside & (travelled < length) & (distance >= occupied)
    ends = exists & (travelled >= length) & (distance >= occupied)
    travelled = tl.where(ends, length, travelled)
    end_x, end_y = x + length * ux, y + length * uy
    at_end = _at(field, end_x, end_y, last_x, last_y, width, per_m, truncation, ends)
    return travelled, exists & (tl.where(ends, at_end, distance) < occupied)


@triton.jit
@no_type_check
def _cast(
    esdf, index, origin, size, here, direction, length, reach, blocked,
    rays, per_row, per_fan, cells, height, width, per_m, occupied, margin, truncation,
    block: tl.constexpr,
):  # fmt: skip
    ray = tl.program_id(0) * block + tl.arange(0, block)
    exists = ray < rays
    row = ray // per_row
    fan = ray // per_fan
    entry = tl.load(index + row, mask=exists, other=0)
    field = esdf + entry * cells
    x = tl.load(here + 2 * row, mask=exists, other=0.0)
    x -= tl.load(origin + 2 * row, mask=exists, other=0.0)
    y = tl.load(here + 2 * row + 1, mask=exists, other=0.0)
    y -= tl.load(origin + 2 * row + 1, mask=exists, other=0.0)
    size_x = tl.load(size + 2 * row, mask=exists, other=1.0)
    size_y = tl.load(size + 2 * row + 1, mask=exists, other=1.0)
    last_x, last_y = _last(size_x, width, per_m), _last(size_y, height, per_m)
    ux = tl.load(direction + 2 * ray, mask=exists, other=0.0)
    uy = tl.load(direction + 2 * ray + 1, mask=exists, other=0.0)
    limit = tl.load(length + fan, mask=exists, other=0.0)
    travelled, hit = _march(
        field, x, y, ux, uy, limit, size_x, size_y, last_x, last_y, width, per_m,
        occupied, margin, truncation, exists,
    )  # fmt: skip
    tl.store(reach + ray, travelled, mask=exists)
    tl.store(blocked + ray, hit, mask=exists)


@triton.jit
@no_type_check
def _corner(x, y, hit_x, hit_y, offset_x, offset_y, nearest, resolution):
    """Corner of the cell hit at the least (or greatest) angle to the guide, from the vehicle."""
    west = tl.floor(hit_x / resolution) * resolution - x
    south = tl.floor(hit_y / resolution) * resolution - y
    sign = tl.where(nearest, 1.0, -1.0)
    best_x, best_y = west, south
    best = sign * 0.0 - float("inf")
    for i in tl.static_range(4):
        corner_x, corner_y = west + (i // 2) * resolution, south + (i % 2) * resolution
        far = tl.maximum(tl.sqrt(corner_x * corner_x + corner_y * corner_y), 1e-9)
        score = sign * (corner_x * offset_x + corner_y * offset_y) / far
        better = score > best
        best_x = tl.where(better, corner_x, best_x)
        best_y = tl.where(better, corner_y, best_y)
        best = tl.where(better, score, best)
    return best_x, best_y


@triton.jit
@no_type_check
def _guided(
    esdf, index, origin, size, here, offset, toward, step, radius, result,
    guides, cells, height, width, resolution, per_m, occupied, margin, truncation,
    lanes: tl.constexpr,
):  # fmt: skip
    """One side of one guide: where its edge lies, from the vehicle (facts 4.4)."""
    side_of = tl.program_id(0)
    guide, row = side_of // 2, side_of // 2 // guides
    sign = 1.0 - 2.0 * (side_of % 2)
    field = esdf + tl.load(index + row) * cells
    x = tl.load(here + 2 * row) - tl.load(origin + 2 * row)
    y = tl.load(here + 2 * row + 1) - tl.load(origin + 2 * row + 1)
    size_x, size_y = tl.load(size + 2 * row), tl.load(size + 2 * row + 1)
    last_x, last_y = _last(size_x, width, per_m), _last(size_y, height, per_m)
    ux, uy = tl.load(toward + 2 * guide), tl.load(toward + 2 * guide + 1)
    turn, limit = tl.load(step + guide), tl.load(radius + guide)
    lane = tl.arange(0, lanes)
    along = tl.zeros([lanes], tl.float32)
    holds = (x + along >= 0) & (y + along >= 0) & (x + along < size_x) & (y + along < size_y)
    on_map = tl.max(holds.to(tl.int32), 0)
    guide_reach, guide_hit = _march(
        field, x + along, y + along, ux + along, uy + along, limit + along, size_x, size_y,
        last_x, last_y, width, per_m, occupied, margin, truncation, holds & (lane == 0),
    )  # fmt: skip
    guide_blocked = tl.max(guide_hit.to(tl.int32), 0)
    last_reach = tl.sum(tl.where(lane == 0, guide_reach, 0.0), 0)
    hit_x, hit_y = x + last_reach * ux, y + last_reach * uy
    first, goes_on = 0, on_map
    while goes_on > 0:
        number = first + lane
        exists = number * turn < _SECTOR
        angle = (number + 1) * turn
        turn_x, turn_y = tl.cos(angle), sign * tl.sin(angle)
        ray_x, ray_y = ux * turn_x - uy * turn_y, uy * turn_x + ux * turn_y
        reach, blocked = _march(
            field, x + along, y + along, ray_x, ray_y, limit + along, size_x, size_y,
            last_x, last_y, width, per_m, occupied, margin, truncation, exists,
        )  # fmt: skip
        # Guide blocked: the last blocked ray before the first gap or free ray. For a gap, the ray
        # before is the last blocked one.
        numbered = tl.where(blocked, lane, -1)
        before = tl.max(tl.where(lane[None, :] < lane[:, None], numbered[None, :], -1), 1)
        same = before[:, None] == lane[None, :]
        previous = tl.sum(tl.where(same, reach[None, :], 0.0), 1)
        previous = tl.where(before >= 0, previous, last_reach)
        gap = blocked & (reach - previous > _GAP)
        clear = exists & (blocked == 0) & (limit - reach < _REACHED)
        stops = tl.where(guide_blocked > 0, gap | clear, blocked)
        stop = tl.min(tl.where(stops, lane, _NONE), 0)
        # Guide free: the first blocked ray, else the last.
        counted = tl.where(guide_blocked > 0, blocked & (lane < stop), exists & (lane <= stop))
        chosen = tl.max(tl.where(counted, lane, -1), 0)
        picked = lane == chosen
        at_x, at_y = x + reach * ray_x, y + reach * ray_y
        hit_x = tl.where(chosen >= 0, tl.sum(tl.where(picked, at_x, 0.0), 0), hit_x)
        hit_y = tl.where(chosen >= 0, tl.sum(tl.where(picked, at_y, 0.0), 0), hit_y)
        last_reach = tl.where(chosen >= 0, tl.sum(tl.where(picked, reach, 0.0), 0), last_reach)
        first += lanes
        goes_on = ((stop == _NONE) & (first * turn < _SECTOR)).to(tl.int32)
    offset_x, offset_y = tl.load(offset + 2 * guide), tl.load(offset + 2 * guide + 1)
    edge_x, edge_y = _corner(x, y, hit_x, hit_y, offset_x, offset_y, guide_blocked == 0, resolution)
    tl.store(result + 2 * side_of, tl.where(on_map > 0, edge_x, 0.0))
    tl.store(result + 2 * side_of + 1, tl.where(on_map > 0, edge_y, 0.0))


def cast(
    esdf: Float[Tensor, "p h w"],
    index: Int[Tensor, " n"],
    origin: Float[Tensor, "n 2"],
    size: Float[Tensor, "n 2"],
    here: Float[Tensor, "n 2"],
    direction: Float[Tensor, "n g b 2"],
    length: Float[Tensor, "n g"],
    resolution: float,
    limits: list[float],
) -> tuple[Tensor, Tensor]:
    """How far rays get [m], and whether what they end in is occupied, both [n, g, b]."""
    _, height, width = esdf.shape
    reach = here.new_empty(direction.shape[:-1])
    blocked = torch.empty_like(reach, dtype=torch.bool)
    rays, fans = reach.numel(), max(length.numel(), 1)
    given = (esdf, index, origin, size, here, direction, length)
    _cast[(triton.cdiv(rays, BLOCK),)](
        *(tensor.contiguous() for tensor in given), reach, blocked,
        rays, rays // max(len(here), 1), rays // fans, height * width, height, width,
        1.0 / resolution, *limits, block=BLOCK, num_warps=BLOCK // 32,
    )  # fmt: skip
    return reach, blocked


def guided(
    esdf: Float[Tensor, "p h w"],
    index: Int[Tensor, " n"],
    origin: Float[Tensor, "n 2"],
    size: Float[Tensor, "n 2"],
    here: Float[Tensor, "n 2"],
    offset: Float[Tensor, "n g 2"],
    toward: Float[Tensor, "n g 2"],
    radius: Float[Tensor, "n g"],
    resolution: float,
    limits: list[float],
) -> Float[Tensor, "n g 4"]:
    """The two edges per guide [m]; `toward` is the unit vector along `offset`."""
    _, height, width = esdf.shape
    result = here.new_empty(*radius.shape, 4)
    step = torch.atan2(torch.full_like(radius, resolution / 2), radius)
    given = (esdf, index, origin, size, here, offset, toward, step, radius)
    _guided[(2 * radius.numel(),)](
        *(tensor.contiguous() for tensor in given), result,
        radius.shape[1], height * width, height, width, resolution, 1.0 / resolution,
        *limits,
        lanes=LANES, num_warps=1,
    )  # fmt: skip
    return result
