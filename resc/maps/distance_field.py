"""Look-ups in a pool of distance fields, by truncation to the cell."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from resc.maps.cells import last_cell

FLAT = 1e-4
"""A field that rises by less than this per metre has no direction."""


@dataclass(frozen=True)
class DistanceField:
    """Distance field of each environment: an entry of a pool [p, h, w], cell (0, 0) at `origin_w`.

    Args:
        esdf: The pool [m].
        index: Entry per environment.
        origin_w: Lower-left corner per environment [m].
        size: Extent in x and y per environment [m]; cells beyond it are padding.
        resolution_m: Edge of a cell.
        truncation_m: Greater distances read as this one.
    """

    esdf: Float[Tensor, "p h w"]
    index: Int[Tensor, " n"]
    origin_w: Float[Tensor, "n 2"]
    size: Float[Tensor, "n 2"]
    resolution_m: float
    truncation_m: float = math.inf

    def at(self, x: Float[Tensor, "*k n"], y: Float[Tensor, "*k n"]) -> Float[Tensor, "*k n"]:
        """Distance [m] stored in the cell of (x, y); outside, that of the nearest border cell.

        Environments last.
        """
        _, height, width = self.esdf.shape
        per_m = 1.0 / self.resolution_m
        last_column, last_row = last_cell(self.size, per_m, (height, width))
        column = (x - self.origin_w[:, 0]) * per_m
        column = column.clamp(min=0).minimum(last_column).to(torch.int32)
        row = (y - self.origin_w[:, 1]) * per_m
        row = row.clamp(min=0).minimum(last_row).to(torch.int32)
        offset = self.index.to(torch.int32) * (height * width)
        return self.esdf.view(-1)[offset + row * width + column].clamp(max=self.truncation_m)

    def slope(
        self, x: Float[Tensor, "*k n"], y: Float[Tensor, "*k n"]
    ) -> tuple[Float[Tensor, "*k n"], Float[Tensor, "*k n"]]:
        """Rise along x and y [m/m], by central differences one cell to each side."""
        cell = self.resolution_m
        slope_x = (self.at(x + cell, y) - self.at(x - cell, y)) / (2 * cell)
        slope_y = (self.at(x, y + cell) - self.at(x, y - cell)) / (2 * cell)
        return slope_x, slope_y

    def inside(self, x: Float[Tensor, "*k n"], y: Float[Tensor, "*k n"]) -> Bool[Tensor, "*k n"]:
        """Whether (x, y) lies on the map."""
        east, north = x - self.origin_w[:, 0], y - self.origin_w[:, 1]
        return (east >= 0) & (north >= 0) & (east < self.size[:, 0]) & (north < self.size[:, 1])


def select(
    esdf: Float[Tensor, "p h w"],
    index: Int[Tensor, "n 1"],
    origin_w: Float[Tensor, "p 2"],
    size: Float[Tensor, "p 2"],
    resolution_m: float,
    truncation_m: float = math.inf,
) -> DistanceField:
    """The distance fields of the environments whose pool entries are `index`."""
    entry = index[:, 0]
    return DistanceField(esdf, entry, origin_w[entry], size[entry], resolution_m, truncation_m)
