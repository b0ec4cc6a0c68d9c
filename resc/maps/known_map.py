"""What a vehicle knows of its map: evidence of what it has seen, and the distance field of that.

Evidence is the logarithm of the odds that a cell is occupied, in tenths, `UNKNOWN` where nothing
was ever seen. Two renderings, as of rays (`resc.maps.ray_casting`): on the CPU numba kernels change
the map in place, each row alone, and renew the field where the occupied cells changed; elsewhere
torch operations do it for all rows. The distance field is always that of the occupied cells, to the
bit.
"""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int, Int8
from torch import Tensor

from resc.maps import known_map_kernels
from resc.maps.constants import TRUNCATION_M
from resc.maps.cpu_kernels import share_out
from resc.maps.distance_transform import distance_transform
from resc.maps.movers import covered

UNKNOWN = -128
"""Evidence of a cell that was never seen."""
LEAST = 16
"""So many maps are worth a second thread."""


class Evidence(NamedTuple):
    """What a scan adds to the evidence of a cell, tenths of log odds.

    Args:
        hit: Where a beam ends.
        miss: Where beams pass and none ends; below zero.
        least: Greatest certainty that a cell is free.
        most: Greatest certainty that it is occupied.
        occupied: From here on a cell counts as occupied.
        fade: Taken from what is above zero of a cell that the scan does not see.
    """

    hit: int
    miss: int
    least: int
    most: int
    occupied: int
    fade: int = 0


class Beams(NamedTuple):
    """A scan of each vehicle, its beams level.

    Args:
        here: Where they start [m].
        direction: Unit vectors.
        length: How far they see [m]; 0 for one that sees nothing.
        offset: What is added to a distance r [m].
        growth: What is added to it, over r^2 [1/m].
    """

    here: Float[Tensor, "n 2"]
    direction: Float[Tensor, "n b 2"]
    length: Float[Tensor, "n b"]
    offset: Float[Tensor, "n b"]
    growth: Float[Tensor, "n b"]


def scan(
    field: tuple[Tensor, Tensor, Tensor, Tensor],
    beams: Beams,
    due: Bool[Tensor, "n 1"],
    evidence: Int8[Tensor, "n h w"],
    esdf: Float[Tensor, "n h w"],
    model: Evidence,
    resolution_m: float,
    movers: Float[Tensor, "n m 4"] | None = None,
) -> tuple[Int8[Tensor, "n h w"], Float[Tensor, "n h w"]]:
    """The map after a scan by the vehicles that are `due`; `evidence` and `esdf` change in place.

    Beams are followed in steps of half a cell to the first occupied one. What is hit is the cell
    half a cell behind the measured end: of a surface on the border of two cells, errors would else
    make the free one occupied, and passages narrower. Cells before the measured end count as
    passed, at most once per scan, and not where another beam ends.

    Args:
        field: The true map of each row: entry [n, 1], distance fields [p, h, w], their lower-left
            corners [p, 2] and sizes [p, 2].
        beams: What is scanned.
        due: Whether a row scans.
        evidence: Of each row; the cells of its true map.
        esdf: Distance [m] to the nearest cell that counts as occupied.
        model: What a scan adds.
        resolution_m: Edge of a cell.
        movers: Where obstacles are that move (`resc.maps.movers.outlines`): the cells that they
            overlap are occupied, too.
    """
    moving = _given(movers, beams.here)
    torch.ops.resc.scan(*field, *beams, moving, due, evidence, esdf, list(model), resolution_m)
    return evidence, esdf


def reveal(
    field: tuple[Tensor, Tensor, Tensor, Tensor],
    here: Float[Tensor, "n 2"],
    radius_m: float,
    due: Bool[Tensor, "n 1"],
    evidence: Int8[Tensor, "n h w"],
    esdf: Float[Tensor, "n h w"],
    model: Evidence,
    resolution_m: float,
    movers: Float[Tensor, "n m 4"] | None = None,
) -> tuple[Int8[Tensor, "n h w"], Float[Tensor, "n h w"]]:
    """The map once all within a radius is known as it is, behind obstacles, too; as `scan`."""
    moving, numbers = _given(movers, here), list(model)
    torch.ops.resc.reveal(
        *field, here, radius_m, moving, due, evidence, esdf, numbers, resolution_m
    )
    return evidence, esdf


def _given(movers: Float[Tensor, "n m 4"] | None, here: Float[Tensor, "n 2"]) -> Tensor:
    """The movers; none of them where none are given."""
    return here.new_empty(len(here), 0, 4) if movers is None else movers


@torch.library.custom_op("resc::scan", mutates_args=("evidence", "esdf"))
def _scan(
    index: Tensor,
    truth: Tensor,
    origin: Tensor,
    size: Tensor,
    here: Tensor,
    direction: Tensor,
    length: Tensor,
    offset: Tensor,
    growth: Tensor,
    movers: Tensor,
    due: Tensor,
    evidence: Tensor,
    esdf: Tensor,
    model: list[int],
    resolution: float,
) -> None:
    if not evidence.is_cpu:
        beams = Beams(here, direction, length, offset, growth)
        field = (index, truth, origin, size)
        scan_in_torch(field, beams, due, evidence, esdf, model, resolution, movers)
        return
    seen = (here, direction, length, offset, growth, movers)
    given = (index[:, 0], truth, origin, size, *seen, due[:, 0])
    arrays = [tensor.contiguous().numpy() for tensor in given]
    changing = (evidence.numpy(), esdf.numpy())
    settings = (resolution, tuple(model), TRUNCATION_M)
    share_out(
        known_map_kernels.scan,
        len(here),
        torch.get_num_threads(),
        *arrays,
        *changing,
        settings,
        least=LEAST,
    )


@torch.library.custom_op("resc::reveal", mutates_args=("evidence", "esdf"))
def _reveal(
    index: Tensor,
    truth: Tensor,
    origin: Tensor,
    size: Tensor,
    here: Tensor,
    radius: float,
    movers: Tensor,
    due: Tensor,
    evidence: Tensor,
    esdf: Tensor,
    model: list[int],
    resolution: float,
) -> None:
    if not evidence.is_cpu:
        reveal_in_torch(
            (index, truth, origin, size),
            here,
            radius,
            due,
            evidence,
            esdf,
            model,
            resolution,
            movers,
        )
        return
    given = (index[:, 0], truth, origin, size, here, movers, due[:, 0])
    arrays = [tensor.contiguous().numpy() for tensor in given]
    changing = (evidence.numpy(), esdf.numpy())
    settings = (resolution, tuple(model), TRUNCATION_M)
    share_out(
        known_map_kernels.reveal,
        len(here),
        torch.get_num_threads(),
        *arrays,
        *changing,
        radius,
        settings,
        least=LEAST,
    )


def scan_in_torch(
    field: tuple[Tensor, Tensor, Tensor, Tensor],
    beams: Beams,
    due: Bool[Tensor, "n 1"],
    evidence: Int8[Tensor, "n h w"],
    esdf: Float[Tensor, "n h w"],
    model: list[int],
    resolution_m: float,
    movers: Float[Tensor, "n m 4"] | None = None,
) -> None:
    """`scan` by torch operations alone."""
    index, _, origin, size = field
    n, height, width = evidence.shape
    start = beams.here - origin[index[:, 0]]
    step_m = resolution_m / 2
    steps = int(float(beams.length.max()) / step_m) + 1 if len(beams.length) else 0
    along = torch.arange(steps, device=start.device) * step_m
    point = start[:, None, None] + beams.direction[:, :, None] * along[:, None]  # [n, b, s, 2]
    cell = (point * (1.0 / resolution_m)).floor().to(torch.int64)
    extent = size[index[:, 0]][:, None, None]
    inside = ((point >= 0) & (point < extent)).all(-1)
    inside = inside.to(torch.int8).cummin(-1).values > 0  # a beam ends where it leaves the map
    seen = inside & (along < beams.length.unsqueeze(-1)) & due[:, :, None]
    place = (cell[..., 1].clamp(0, height - 1) * width + cell[..., 0].clamp(0, width - 1)).flatten(
        1
    )
    solid = _solid(field, _given(movers, beams.here), resolution_m).flatten(1)
    occupied = solid.gather(1, place).view(seen.shape) & seen
    meets = occupied.any(-1)
    first = occupied.to(torch.int32).argmax(-1) * step_m
    measured = (first + beams.offset + beams.growth * first.square()).clamp(min=0)
    ends = start[:, None] + beams.direction * (measured + step_m).unsqueeze(-1)
    end_cell = (ends * (1.0 / resolution_m)).floor().to(torch.int64)
    hits = meets & ((ends >= 0) & (ends < size[index[:, 0]][:, None])).all(-1)
    end_place = end_cell[..., 1].clamp(0, height - 1) * width + end_cell[..., 0].clamp(0, width - 1)
    hit = torch.zeros(n, height * width, dtype=torch.int32, device=start.device)
    hit = hit.scatter_reduce(1, end_place, hits.to(torch.int32), "amax") > 0
    reach = torch.where(meets, measured - resolution_m, beams.length)
    passed = (seen & (along < reach.unsqueeze(-1))).flatten(1).to(torch.int32)
    free = torch.zeros_like(hit, dtype=torch.int32).scatter_reduce(1, place, passed, "amax") > 0
    passed = free.view(n, height, width)
    _add(hit.view(n, height, width), passed, due, evidence, esdf, model, resolution_m)


def reveal_in_torch(
    field: tuple[Tensor, Tensor, Tensor, Tensor],
    here: Float[Tensor, "n 2"],
    radius_m: float,
    due: Bool[Tensor, "n 1"],
    evidence: Int8[Tensor, "n h w"],
    esdf: Float[Tensor, "n h w"],
    model: list[int],
    resolution_m: float,
    movers: Float[Tensor, "n m 4"] | None = None,
) -> None:
    """`reveal` by torch operations alone."""
    index, _, origin, size = field
    _, height, width = evidence.shape
    start = (here - origin[index[:, 0]]) * (1.0 / resolution_m)
    rows = torch.arange(height, device=here.device) + 0.5
    columns = torch.arange(width, device=here.device) + 0.5
    far = (rows[:, None] - start[:, 1, None, None]).square()
    far = far + (columns - start[:, 0, None, None]).square()
    extent = size[index[:, 0]] * (1.0 / resolution_m)
    on_map = (rows[:, None] < extent[:, 1, None, None]) & (columns < extent[:, 0, None, None])
    near = (far <= (radius_m / resolution_m) ** 2) & on_map & due[:, :, None]
    occupied = _solid(field, _given(movers, here), resolution_m)
    _, _, least, most, enough, fade = model
    before = evidence >= enough
    elsewhere = _faded(evidence, due, fade)
    evidence.copy_(torch.where(near, torch.where(occupied, most, least).to(torch.int8), elsewhere))
    _renew(before, evidence, esdf, model, resolution_m)


def _solid(
    field: tuple[Tensor, Tensor, Tensor, Tensor],
    movers: Float[Tensor, "n m 4"],
    resolution_m: float,
) -> Bool[Tensor, "n h w"]:
    """Cells that an obstacle is in, be it one that moves."""
    index, truth, origin, _ = field
    still = truth[index[:, 0]] <= 0
    if not movers.shape[1]:
        return still
    height, width = truth.shape[1:]
    return still | covered(movers, origin[index[:, 0]], (height, width), resolution_m)


def _faded(
    evidence: Int8[Tensor, "n h w"], due: Bool[Tensor, "n 1"], fade: int
) -> Int8[Tensor, "n h w"]:
    """The evidence of cells that a scan does not see."""
    less = (evidence.to(torch.int32) - fade).clamp(min=0).to(torch.int8)
    return torch.where((evidence > 0) & due[:, :, None], less, evidence)


def _add(
    hit: Bool[Tensor, "n h w"],
    free: Bool[Tensor, "n h w"],
    due: Bool[Tensor, "n 1"],
    evidence: Int8[Tensor, "n h w"],
    esdf: Float[Tensor, "n h w"],
    model: list[int],
    resolution_m: float,
) -> None:
    """Adds what was hit and what was passed."""
    added, missed, least, most, occupied, fade = model
    before = evidence >= occupied
    known: Int[Tensor, "n h w"] = torch.where(evidence == UNKNOWN, 0, evidence.to(torch.int32))
    after = (known + torch.where(hit, added, missed)).clamp(least, most).to(torch.int8)
    evidence.copy_(torch.where(hit | free, after, _faded(evidence, due, fade)))
    _renew(before, evidence, esdf, model, resolution_m)


def _renew(
    before: Bool[Tensor, "n h w"],
    evidence: Int8[Tensor, "n h w"],
    esdf: Float[Tensor, "n h w"],
    model: list[int],
    resolution_m: float,
) -> None:
    """Computes the distance fields of the rows again whose occupied cells changed."""
    now = evidence >= model[4]
    rows = (now != before).flatten(1).any(1).nonzero()[:, 0]
    if len(rows):
        esdf[rows] = distance_transform(now[rows], resolution_m, TRUNCATION_M)
