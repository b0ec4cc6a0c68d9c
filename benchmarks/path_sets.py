"""Maps and queries with exact reference lengths: quad100, and MovingAI where it is at hand.

Both are described in tests/data/README.md; a folder of MovingAI maps holds `movingai_refs.csv` and
`movingai/NAME.map.gz` (https://movingai.com/benchmarks/grids.html).
"""

import csv
import gzip
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

Cell = tuple[int, int]
DATA = Path(__file__).parents[1] / "tests" / "data"
FREE = b".GS"
RESOLUTION_M = 0.1
"""Of a cell of a MovingAI map: any number, since its maps have no size."""


class Query(NamedTuple):
    """Start and goal as (x, y), the exact length and, if published, that of 8-connected steps."""

    map: str
    start: Cell
    goal: Cell
    optimum: float
    octile: float | None


class PathSet(NamedTuple):
    """Occupied cells [row = y, column = x] by the map's name, and what is asked on them."""

    name: str
    maps: dict[str, np.ndarray]
    queries: list[Query]
    clearance_m: float
    resolution_m: float

    def point(self, cell: Cell) -> tuple[float, float]:
        """Centre of a cell [m]."""
        return (cell[0] + 0.5) * self.resolution_m, (cell[1] + 0.5) * self.resolution_m


def quad100() -> PathSet:
    """120 maps of 100 x 100 cells, 600 queries."""
    with np.load(DATA / "quad100.npz") as data:
        maps = np.unpackbits(data["raw_packed"], axis=-1)[..., : data["shape"][2]].astype(bool)
        resolution_m, clearance_m = float(data["resolution"]), float(data["inflation"])
    with (DATA / "quad100_refs.csv").open() as file:
        queries = list(_queries(csv.DictReader(file)))
    named = {str(number): grid for number, grid in enumerate(maps)}
    return PathSet("quad100", named, queries, clearance_m, resolution_m)


def movingai(folder: Path) -> PathSet:
    """26 maps of up to 512 x 530 cells, 650 queries, without clearance."""
    with (folder / "movingai_refs.csv").open() as file:
        queries = list(_queries(csv.DictReader(file)))
    names = dict.fromkeys(query.map for query in queries)
    maps = {name: _read_map(folder / "movingai" / f"{name}.map.gz") for name in names}
    return PathSet("MovingAI", maps, queries, 0.0, RESOLUTION_M)


def _queries(rows: Iterable[dict[str, str]]) -> Iterable[Query]:
    for row in rows:
        sx, sy, gx, gy = (int(row[name]) for name in ("sx", "sy", "gx", "gy"))
        octile = float(row["octile_nocut"]) if "octile_nocut" in row else None
        yield Query(row["map"], (sx, sy), (gx, gy), float(row["opt_center"]), octile)


def _read_map(file: Path) -> np.ndarray:
    lines = gzip.decompress(file.read_bytes()).split()
    rows = lines[lines.index(b"map") + 1 :]
    cells = np.array([np.frombuffer(row, np.uint8) for row in rows])
    return ~np.isin(cells, np.frombuffer(FREE, np.uint8))
