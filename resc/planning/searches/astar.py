"""A* on the grid: the shortest path of steps to the eight neighbours."""

from resc.planning.grid import Grid
from resc.planning.searches.method import Method, PreparedMap, Query
from resc.planning.searches.open_list import FOUND, Work
from resc.planning.searches.pulling import pull
from resc.planning.searches.steps import Rimmed, rimmed, walk


class AStar(Method):
    """Finds the shortest path of straight and diagonal steps that cut no corner.

    The path is bound to the grid, as the literature has A*: eight directions, up to 8.2 % longer
    than the exact path. With `pulled` its turns are left out where a free line passes by, the usual
    post-smoothing ("A* PS"); what is left may still be longer than the exact path.

    Args:
        pulled: Whether the path is string-pulled.
    """

    def __init__(self, *, pulled: bool = False) -> None:
        self.pulled = pulled

    def index(self, occupancy: Grid, blocked: Grid, radius_cells: float) -> Rimmed:
        """The map with a rim."""
        return rimmed(blocked)

    def cells(self, chart: PreparedMap, query: Query, work: Work) -> tuple[int, int]:
        """Status and expansions."""
        status, expansions = self._steps(chart, query, work)
        if self.pulled and status == FOUND:
            pull(chart.blocked, query.first, query.last, work)
        return status, expansions

    def _steps(self, chart: PreparedMap, query: Query, work: Work) -> tuple[int, int]:
        ends, rest = (query.first, query.last), (query.limit, query.number, work)
        return walk(chart.blocked, chart.index, *ends, False, *rest)
