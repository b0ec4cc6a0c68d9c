"""Sphere-traced rays and the guided sector sweep on distance fields: a whole batch at once.

Two renderings of one algorithm, in numba for the CPU (`resc.maps.cpu_kernels`) and in Triton for
GPUs (`resc.maps.gpu_kernels`), opaque to the compiler as the operators `resc::cast` and
`resc::guided`. Both are tested against the same scalar version.

A jump of a ray is the stored distance less the surface's margin, at least `SHORTEST_STEP_M`. A ray
ends in the first occupied cell, before the jump that leaves the map, or at its length (facts 4.3);
the last jump may overshoot the length, and the cell of the start is not tested.
"""

from types import ModuleType

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from resc.maps import cpu_kernels
from resc.maps.constants import INFLATED, Surface
from resc.maps.distance_field import DistanceField


def rays(
    field: DistanceField,
    here: Float[Tensor, "n 2"],
    direction: Float[Tensor, "n g b 2"],
    length: Float[Tensor, "n g"],
    surface: Surface = INFLATED,
) -> tuple[Float[Tensor, "n g b"], Bool[Tensor, "n g b"]]:
    """How far rays get [m], and whether they end in an occupied cell.

    Args:
        field: The map of each environment.
        here: Where the rays start.
        direction: Their unit vectors, in fans of `b` rays.
        length: The length of the rays of each fan.
        surface: What the rays meet.
    """
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


def free_distance(
    field: DistanceField, here: Float[Tensor, "n 2"], offset: Float[Tensor, "n 2"], range_m: float
) -> Float[Tensor, " n"]:
    """How far [m] a ray toward `offset` gets, at most `range_m`; along x without a direction."""
    direction = toward(offset)[:, None, None]
    length = torch.full_like(offset[:, :1], range_m)
    return rays(field, here, direction, length)[0][:, 0, 0]


def toward(offset: Float[Tensor, "*n 2"]) -> Float[Tensor, "*n 2"]:
    """The unit vector along `offset`; along x if that is zero."""
    length = torch.linalg.vector_norm(offset, dim=-1, keepdim=True)
    along_x = torch.cat((torch.ones_like(length), torch.zeros_like(length)), -1)
    return torch.where(length > 0, offset / torch.where(length > 0, length, 1.0), along_x)


def guided(
    field: DistanceField,
    here: Float[Tensor, "n 2"],
    offset: Float[Tensor, "n g 2"],
    radius: Float[Tensor, "n g"],
) -> Float[Tensor, "n g 4"]:
    """Edges from the vehicle [m]: x, y counter-clockwise, then clockwise of each guide (facts 4.4).

    The sweep covers 60 degrees to each side of a guide ray toward `offset`, up to `radius`. Guide
    ray free: the nearest blocked ray of each side bounds the corridor. Guide ray blocked: where the
    blocking obstacle ends. Each edge is a corner of the cell hit, the one with the least (free) or
    greatest (blocked) angle to the guide. Off the map all are zero.
    """
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


@_cast_on_cpu.register_kernel("cuda")
def _(esdf, index, origin, size, here, direction, length, resolution, limits):  # noqa: ANN001, ANN202
    given = (esdf, index, origin, size, here, direction, length)
    return _gpu_kernels().cast(*given, resolution, limits)


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


@_guided_on_cpu.register_kernel("cuda")
def _(esdf, index, origin, size, here, offset, radius, resolution, limits):  # noqa: ANN001, ANN202
    given = (esdf, index, origin, size, here, offset, toward(offset), radius)
    return _gpu_kernels().guided(*given, resolution, limits)


def _gpu_kernels() -> ModuleType:
    """The kernels for GPUs: imported late, since Triton takes a second that the CPU need not."""
    from resc.maps import gpu_kernels

    return gpu_kernels
