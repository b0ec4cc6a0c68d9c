"""Theta*: A* on the grid whose cells take the parent of their parent where they see it."""

from resc.planning.grid import Grid
from resc.planning.searches.method import Method, PreparedMap, Query
from resc.planning.searches.open_list import Work
from resc.planning.searches.steps import Rimmed, rimmed, walk


class ThetaStar(Method):
    """Finds a short any-angle path, in general not the shortest.

    Nash et al. 2007 (basic Theta*) on cell centres: a cell that is reached from a neighbour is
    joined to that neighbour's parent instead if the line is free by the exact rule, so every line
    of the path is. Steps to neighbours cut no corner. Not string-pulled: the method does that as it
    goes.
    """

    def index(self, occupancy: Grid, blocked: Grid, radius_cells: float) -> Rimmed:
        """The map with a rim."""
        return rimmed(blocked)

    def cells(self, chart: PreparedMap, query: Query, work: Work) -> tuple[int, int]:
        """Status and expansions."""
        ends, rest = (query.first, query.last), (query.limit, query.number, work)
        return walk(chart.blocked, chart.index, *ends, True, *rest)
