"""The reference set of maps and shortest lengths that the planning tests share."""

import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

DATA = Path(__file__).parents[1] / "data"


class Query(NamedTuple):
    """One row of quad100_refs.csv: cells are (x, y), the length is in cells."""

    map: int
    start: tuple[int, int]
    goal: tuple[int, int]
    shortest: float


class Quad100(NamedTuple):
    """120 maps of 10 m x 10 m and 600 queries; see tests/data/README.md."""

    occupancy: np.ndarray
    resolution_m: float
    clearance_m: float
    queries: list[Query]


@pytest.fixture(scope="session")
def quad100() -> Quad100:
    with np.load(DATA / "quad100.npz") as data:
        packed, shape = data["raw_packed"], data["shape"]
        resolution_m, clearance_m = float(data["resolution"]), float(data["inflation"])
    occupancy = np.unpackbits(packed, axis=-1)[:, :, : shape[2]].astype(bool)
    with (DATA / "quad100_refs.csv").open() as file:
        queries = [
            Query(
                int(row["map"]),
                (int(row["sx"]), int(row["sy"])),
                (int(row["gx"]), int(row["gy"])),
                float(row["opt_center"]),
            )
            for row in csv.DictReader(file)
        ]
    return Quad100(occupancy, resolution_m, clearance_m, queries)
