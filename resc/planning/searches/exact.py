"""The shortest any-angle path: A* over the convex corners of inflated obstacles."""

from resc.planning.grid import Grid
from resc.planning.searches.cone_scan import LABEL, build_table
from resc.planning.searches.corner_astar import find_path, search_corners
from resc.planning.searches.method import Answer, Method, PreparedMap, Query
from resc.planning.searches.open_list import Work


class Exact(Method):
    """Finds the shortest of all free paths, not only of those through corners.

    Four things make it exact: corners are the only cells at which a shortest path can turn; sight
    is exact, symmetric and without range; a corner that sees the goal is closed with its true cost;
    the search ends only when nothing open can be shorter. Speed comes from scanning, at each
    corner, only the cone in which a shortest path can go on.
    """

    def prepare(self, occupancy: Grid, blocked: Grid, radius_cells: float) -> PreparedMap:
        """As every method; the tables for the scans hold the labels, too."""
        table = build_table(blocked)
        return PreparedMap(occupancy, blocked, table[LABEL], table)

    def cells(self, chart: PreparedMap, query: Query, work: Work) -> tuple[int, int]:
        """Status and expansions."""
        ends = query.first, query.last
        return search_corners(chart.blocked, chart.index, *ends, query.limit, query.number, work)

    def find(self, chart: PreparedMap, query: Query, work: Work) -> Answer:
        """As every method, in one compiled call."""
        start, goal, frame, limit, number = query
        return find_path(chart.blocked, chart.index, start, goal, frame, limit, number, work)
