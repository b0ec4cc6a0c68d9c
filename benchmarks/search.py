"""Search methods side by side: `python -m benchmarks.search [--movingai FOLDER] [--large]`.

Every method of conf/search, A* and jump points string-pulled too, and two packages of the extra
`benchmark` where they are installed. One thread; calls from Python included. Lengths are over the
exact optimum of the free-space rule of `resc.planning.grid`; a path that cuts corners may be
shorter than that.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.path_sets import PathSet, Query, movingai, quad100
from resc.build import build, load_config
from resc.planning.grid import inflate, line_is_free
from resc.planning.searches.astar import AStar
from resc.planning.searches.jps import JumpPoints
from resc.planning.searches.search import Search

CONF = Path(__file__).parents[1] / "conf" / "search"
BUDGET = 20_000_000
"""Expansions: more than any of these maps has cells; `released` keeps its own limit."""
TOLERANCE = 1e-9
OCTILE = 6e-3
"""Of the exact lengths; and of the published octile ones, some of which have two decimals."""
LARGE = 4000


class Contender(NamedTuple):
    """`prepare(occupied)` once a map; `plan(chart, query)` gives points (x, y), or says why not."""

    name: str
    prepare: Callable[[np.ndarray], Any]
    plan: Callable[[Any, Query], np.ndarray | str]


def ours(paths: PathSet) -> Iterator[Contender]:
    """The methods of conf/search, and those that can be string-pulled."""
    for file in sorted(CONF.glob("*.yaml"), key=lambda path: (path.stem != "exact", path.stem)):
        settings = load_config(file)
        limit = settings.get("max_expansions", BUDGET) if file.stem == "released" else BUDGET
        yield contender(file.stem, paths, build(settings["method"], "search.method"), limit)
    yield contender("astar, pulled", paths, AStar(pulled=True), BUDGET)
    yield contender("jps, pulled", paths, JumpPoints(pulled=True), BUDGET)


def contender(name: str, paths: PathSet, method: Any, limit: int) -> Contender:  # noqa: ANN401
    """A method of ours."""
    search = Search(paths.clearance_m, paths.resolution_m, limit, method)

    def plan(chart: Any, query: Query) -> np.ndarray | str:  # noqa: ANN401
        path = search.plan(chart, paths.point(query.start), paths.point(query.goal))
        if path.status != "found":
            return path.status
        return path.points_m / paths.resolution_m - 0.5

    return Contender(name, search.prepare, plan)


def packages(paths: PathSet) -> Iterator[Contender]:
    """Path searches of other packages; one line for each that is not installed."""
    radius = paths.clearance_m / paths.resolution_m
    try:
        import pyastar2d

        def weigh(occupied: np.ndarray) -> np.ndarray:
            return np.where(inflate(occupied, radius), np.inf, 1.0).astype(np.float32)

        def walk(chart: np.ndarray, query: Query) -> np.ndarray | str:
            ends = query.start[::-1], query.goal[::-1]
            cells = pyastar2d.astar_path(chart, *ends, allow_diagonal=True)
            return "unreachable" if cells is None else cells[:, ::-1]

        yield Contender("pyastar2d", weigh, walk)
    except ImportError:
        print("pyastar2d is not installed; pip install -e '.[benchmark]' adds it.")
    try:
        import tcod.path

        def cost(occupied: np.ndarray) -> Any:  # noqa: ANN401
            free = ~inflate(occupied, radius)
            return tcod.path.AStar(free.astype(np.int8), diagonal=1.41)

        def follow(chart: Any, query: Query) -> np.ndarray | str:  # noqa: ANN401
            steps = chart.get_path(*query.start[::-1], *query.goal[::-1])
            return np.array([query.start[::-1], *steps])[:, ::-1] if steps else "unreachable"

        yield Contender("tcod", cost, follow)
    except ImportError:
        print("tcod is not installed; pip install -e '.[benchmark]' adds it.")


def timed(call: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    """Shortest duration [us] and what was returned."""
    times, found = [], None
    for _ in range(repeats):
        begin = time.perf_counter()
        found = call()
        times.append(time.perf_counter() - begin)
    return 1e6 * min(times), found


def cuts_a_corner(blocked: np.ndarray, points: np.ndarray) -> bool:
    """Whether a line of the path is not free by the rule of `resc.planning.grid`."""
    cells = [(x, y) for x, y in np.rint(points).astype(int).tolist()]
    return not all(line_is_free(blocked, a, b) for a, b in pairwise(cells))


def row(paths: PathSet, one: Contender, repeats: int) -> str:
    """Run every query of a set; one line of the table."""
    radius = paths.clearance_m / paths.resolution_m
    blocked = {name: inflate(grid, radius) for name, grid in paths.maps.items()}
    first = paths.queries[0]
    one.plan(one.prepare(paths.maps[first.map]), first)  # compiles
    charts = {name: timed(lambda g=g: one.prepare(g), 2) for name, g in paths.maps.items()}
    times, ratios, failed, cut, octile = [], [], [], 0, 0
    for query in paths.queries:
        chart = charts[query.map][1]
        elapsed, points = timed(lambda c=chart, q=query: one.plan(c, q), repeats)
        times.append(elapsed)
        if isinstance(points, str):
            failed.append(points)
            continue
        length = float(np.hypot(*np.diff(points, axis=0).T).sum())
        ratios.append(length / query.optimum)
        cut += cuts_a_corner(blocked[query.map], points)
        octile += query.octile is not None and abs(length - query.octile) < OCTILE
    exact = sum(ratio <= 1 + TOLERANCE for ratio in ratios)
    reasons = ", ".join(f"{failed.count(why)} {why}" for why in sorted(set(failed))) or "0"
    setup = np.mean([elapsed for elapsed, _ in charts.values()])
    lengths = f"{np.mean(ratios):.4f} / {max(ratios):.4f}" if ratios else "-"
    share = f"{100 * cut / len(ratios):.0f} %" if ratios else "-"
    return (
        f"| {one.name} | {np.mean(times):.4g} / {np.median(times):.4g} / "
        f"{np.percentile(times, 99):.4g} | {setup:.3g} | {reasons} | {lengths} | {exact} | "
        f"{share} | {octile if paths.queries[0].octile else '-'} |"
    )


def table(paths: PathSet, repeats: int) -> None:
    """Print a set's table, line by line as it is measured."""
    print(f"\n{paths.name}: {len(paths.queries)} queries on {len(paths.maps)} maps\n")
    print(
        "| search | query [us]: mean / median / p99 | prepare [us] | failed | length / optimum: "
        "mean / max | not longer than optimum | paths that cut corners | as long as octile |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for one in (*ours(paths), *packages(paths)):
        print(row(paths, one, repeats), flush=True)


def large() -> PathSet:
    """One map of 4,000 x 4,000 cells, a twentieth of it blocks of 20 x 20 cells."""
    random = np.random.default_rng(0)
    grid = np.kron(random.random((LARGE // 20,) * 2) < 0.05, np.ones((20, 20))).astype(bool)
    grid[:40, :40] = grid[-40:, -40:] = False
    query = Query("large", (10, 10), (LARGE - 11, LARGE - 11), np.nan, None)
    return PathSet(f"{LARGE} x {LARGE}", {"large": grid}, [query], 0.0, 0.1)


def main() -> None:
    """Print a table for each set of maps."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--movingai", type=Path, help="folder of movingai_refs.csv and movingai/")
    parser.add_argument("--large", action="store_true", help=f"one map of {LARGE} x {LARGE} cells")
    asked = parser.parse_args()
    table(quad100(), repeats=5)
    if asked.movingai:
        table(movingai(asked.movingai), repeats=4)
    if asked.large:
        paths = large()
        exact = contender("exact", paths, None, BUDGET)
        points = exact.plan(exact.prepare(paths.maps["large"]), paths.queries[0])
        optimum = float(np.hypot(*np.diff(points, axis=0).T).sum())
        queries = [paths.queries[0]._replace(optimum=optimum)]
        table(paths._replace(queries=queries), repeats=1)


if __name__ == "__main__":
    main()
