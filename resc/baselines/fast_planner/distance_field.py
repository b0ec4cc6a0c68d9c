"""Signed distances to the inflated cells that a planner knows, and their slope."""

import numpy as np
import torch
from jaxtyping import Float

from resc.baselines.fast_planner.field_kernels import FREE_M
from resc.baselines.voxel_map import VoxelMap
from resc.maps.distance_transform import distance_transform


class DistanceField:
    """Distance [m] of each cell's centre to the nearest inflated one; less than none inside.

    It is computed in a box; elsewhere it stays as it was. Inside obstacles it is minus the distance
    to the nearest free centre, plus one cell.

    Args:
        voxels: The map that it follows.
    """

    def __init__(self, voxels: VoxelMap) -> None:
        self._voxels = voxels
        self.cells: Float[np.ndarray, "x y"] = np.full(voxels.cells.shape, FREE_M)

    def update(self, low_w: Float[np.ndarray, " 2"], high_w: Float[np.ndarray, " 2"]) -> None:
        """Computes the distances between two corners [m], from the cells between them alone."""
        corner, per_m = self._voxels.corner, self._voxels.per_m
        last = np.array(self.cells.shape) - 1
        first = np.clip(np.floor(low_w * per_m - corner).astype(int), 0, last)
        end = np.clip(np.floor(high_w * per_m - corner).astype(int), 0, last) + 1
        box = slice(first[0], end[0]), slice(first[1], end[1])
        occupied = torch.from_numpy(self._voxels.cells[box] != 0)
        apart = distance_transform(torch.stack((occupied, ~occupied)), 1.0)
        outside, inside = apart.numpy().astype(np.float64)
        cells = np.where(inside > 0.0, 1.0 - inside, outside)
        # Three times 0.1 m is more than 0.3 m, and a goal so far from obstacles stays where it is.
        self.cells[box] = np.clip(cells * (1 / per_m), -FREE_M, FREE_M)

    @property
    def field(self) -> tuple[Float[np.ndarray, "x y"], Float[np.ndarray, " 2"], float]:
        """What the kernels look distances up in: cells, corner and cells a metre."""
        return self.cells, self._voxels.corner, self._voxels.per_m

    def of_cells(self, points_w: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Distance [m] of the centres of the cells that points lie in.

        The descent looks between the centres, in `field`; the safety of a trajectory and a goal
        are judged by the cells.
        """
        cells = np.floor(points_w[:, :2] * self._voxels.per_m - self._voxels.corner).astype(int)
        on_map = ((cells >= 0) & (cells < self.cells.shape)).all(1)
        found = np.full(len(cells), FREE_M)
        found[on_map] = self.cells[tuple(cells[on_map].T)]
        return found
