"""Time the path search on quad100: `python -m benchmarks.planning [picture.png]`.

One thread, Python calls included; each time is the best of five.  The lengths are checked against
the exact references, so a fast wrong answer shows.
"""

import csv
import sys
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from resc.planning.control_points import control_points
from resc.planning.grid import segment_is_free
from resc.planning.searches.method import PreparedMap
from resc.planning.searches.search import PlannedPath, Search
from resc.viewing.colours import BLUE, VERMILION

DATA = Path(__file__).parents[1] / "tests" / "data"
ORIGIN_M = (0.0, 0.0)


class Flight(NamedTuple):
    """One query with its map, its reference length [m] and the path found."""

    chart: PreparedMap
    reference_m: float
    path: PlannedPath


def best_us(call: Callable[[], object]) -> float:
    """Shortest of five durations [us]."""
    times = []
    for _ in range(5):
        begin = time.perf_counter()
        call()
        times.append(time.perf_counter() - begin)
    return 1e6 * min(times)


def resample(flight: Flight, resolution_m: float, rule: str) -> np.ndarray:
    """Start and control points of one path, (x, y) in cells."""
    found = control_points(
        flight.path.points_m,
        blocked=flight.chart.blocked,
        origin_xy_m=ORIGIN_M,
        resolution_m=resolution_m,
        rule=rule,
    )
    return np.vstack([flight.path.points_m[0], found[:, :2]]) / resolution_m - 0.5


def report(name: str, times: list[float]) -> None:
    """Print one line of times."""
    print(f"{name:16} mean {np.mean(times):7.1f} us   p99 {np.percentile(times, 99):7.1f} us")


def draw(flight: Flight, resolution_m: float, file: str) -> None:
    """Picture of one map with its path and control points."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4, 4), layout="constrained")
    axes = figure.add_subplot()
    height, width = flight.chart.blocked.shape
    shade = 2 - flight.chart.blocked.astype(int) - flight.chart.occupancy
    extent = (0.0, width * resolution_m, 0.0, height * resolution_m)
    axes.imshow(shade, origin="lower", extent=extent, cmap="gray", vmin=-1)
    axes.plot(*flight.path.points_m.T, color=BLUE, label="path")
    points_m = (resample(flight, resolution_m, "visible") + 0.5) * resolution_m
    axes.plot(*points_m[1:].T, "o", color=VERMILION, label="control points")
    axes.set(xlabel="x [m]", ylabel="y [m]")
    figure.legend(loc="outside upper center", ncols=2)
    figure.savefig(file, dpi=120)


def main() -> None:
    """Run every query, print the table, draw the picture if asked to."""
    with np.load(DATA / "quad100.npz") as data:
        maps = np.unpackbits(data["raw_packed"], axis=-1)[..., : data["shape"][2]].astype(bool)
        size_m, clearance_m = float(data["resolution"]), float(data["inflation"])
    search = Search(clearance_m, size_m)
    charts = [search.prepare(occupancy) for occupancy in maps]
    flights, times = [], []
    for row in csv.DictReader((DATA / "quad100_refs.csv").open()):
        chart = charts[int(row["map"])]
        start = ((int(row["sx"]) + 0.5) * size_m, (int(row["sy"]) + 0.5) * size_m)
        goal = ((int(row["gx"]) + 0.5) * size_m, (int(row["gy"]) + 0.5) * size_m)
        path = search.plan(chart, start, goal)
        flights.append(Flight(chart, float(row["opt_center"]) * size_m, path))
        times.append(best_us(lambda c=chart, a=start, b=goal: search.plan(c, a, b)))
    exact = sum(f.path.length_m <= f.reference_m * (1 + 1e-9) for f in flights)
    print(f"optimal          {exact} of {len(flights)}")
    report("query", times)
    report("prepare", [best_us(lambda o=occupancy: search.prepare(o)) for occupancy in maps])
    for rule in ("visible", "released"):
        lines = [resample(f, size_m, rule) for f in flights]
        free = [
            all(segment_is_free(f.chart.blocked, a, b) for a, b in pairwise(p))
            for f, p in zip(flights, lines, strict=True)
        ]
        gaps = size_m * np.concatenate([np.hypot(*np.diff(p[1:], axis=0).T) for p in lines])
        left, short = free.count(False), np.mean(gaps < 0.5 - 1e-9)
        summary = f"leaves free space {left} of {len(free)}, mean gap {gaps.mean():.2f} m"
        report(rule, [best_us(lambda f=f, r=rule: resample(f, size_m, r)) for f in flights])
        print(f"    {summary}, {short:.0%} of the gaps below 0.5 m")
    if len(sys.argv) > 1:
        draw(max(flights, key=lambda f: len(f.path.points_m)), size_m, sys.argv[1])


if __name__ == "__main__":
    main()
