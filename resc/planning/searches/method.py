"""What a search method is: from two free cells of a prepared map to a path between them."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import inf
from typing import Any, ClassVar, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Int32

from resc.planning.grid import Grid
from resc.planning.searches.components import components
from resc.planning.searches.open_list import FOUND, UNREACHABLE, Cell, Work
from resc.planning.searches.polyline import End, Frame, write_path

Answer: TypeAlias = tuple[int, int, float, int]  # status, points, length [m], expansions


@dataclass(frozen=True, eq=False)
class PreparedMap:
    """One map, inflated and indexed; arrays are [row = y, column = x], row 0 at the smallest y."""

    occupancy: Grid
    blocked: Grid  # occupied, or within the clearance of an occupied cell
    label: Int32[np.ndarray, "h columns"]  # equal where steps along rows and columns join two cells
    index: Any  # what the method reads beside


class Query(NamedTuple):
    """One question: both ends, where cells are in space, and the work that is allowed."""

    start: End
    goal: End
    frame: Frame
    limit: int
    number: int  # of the workspace, from 1

    @property
    def first(self) -> Cell:
        """Cell of the start."""
        return self.start[2:]

    @property
    def last(self) -> Cell:
        """Cell of the goal."""
        return self.goal[2:]


class Method(ABC):
    """A way of finding a path between the centres of two free cells.

    It holds settings only: the memory of a query is the `Work` that it is given, so threads may
    share a method.
    """

    complete: ClassVar[bool] = True
    """Whether it finds a path wherever steps along rows and columns join the two cells."""

    def prepare(self, occupancy: Grid, blocked: Grid, radius_cells: float) -> PreparedMap:
        """All that is computed once for each map; `blocked` is inflated by `radius_cells`."""
        index = self.index(occupancy, blocked, radius_cells)
        return PreparedMap(occupancy, blocked, components(blocked), index)

    def index(self, occupancy: Grid, blocked: Grid, radius_cells: float) -> Any:  # noqa: ANN401
        """What the method reads beside the blocked cells."""
        return None

    @abstractmethod
    def cells(self, chart: PreparedMap, query: Query, work: Work) -> tuple[int, int]:
        """Status and expansions.

        Leaves the path in `work[1]`: there each cell, as y * width + x, has the number of the cell
        before it, from the goal back to the start.
        """

    def find(self, chart: PreparedMap, query: Query, work: Work) -> Answer:
        """Status, number of points, length [m] and expansions; leaves the points in `work`."""
        (sx, sy), (gx, gy) = query.first, query.last
        if self.complete and chart.label[sy, sx] != chart.label[gy, gx]:
            return UNREACHABLE, 0, inf, 0
        status, expansions = self.cells(chart, query, work)
        if status != FOUND:
            return status, 0, inf, expansions
        ends = query.start, query.goal
        count, length_m = write_path(chart.blocked, work[1], *ends, query.frame, work[-1])
        return FOUND, count, length_m, expansions
