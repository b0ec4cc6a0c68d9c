"""evaluation.csv: what came of every held-out episode of a run, for reports over many runs."""

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.flying.flights import Flights
from resc.run_folder import replacing
from resc.scenes.pool import ScenePool
from resc.sweep_folder import go_on

NEAR_M = 1.5
"""Density is measured this near to the route: as far as training puts obstacles from it."""
COLUMNS = ("scene", "obstacles", "density", "outcome", "success", "collided", "time_s")
"""The columns of every file; the metrics of the run follow."""

Episodes = dict[str, np.ndarray]


def tabulate_episodes(flights: Flights, pool: ScenePool) -> Episodes:
    """One entry per episode under every column; episode i flies in scene i of the pool.

    `obstacles` counts boxes, pillars and movers, `density` is the share of the ground near the
    route that is occupied by what stands still, `time_s` lasts from the start to the end of the
    episode, whatever ended it.
    """
    layout = pool.layout
    lengths = (layout.boxes_w[..., 2], layout.pillars_w[..., 2], layout.movers_w[..., 4])
    obstacles = torch.stack([(length > 0).sum(-1) for length in lengths]).sum(0)
    return {
        "scene": np.arange(len(flights)),
        "obstacles": obstacles.numpy(),
        "density": density_near_route(pool).double().numpy(),
        "outcome": np.array(flights.names),
        "success": flights.success.numpy().astype(np.int64),
        "collided": flights.collided.numpy().astype(np.int64),
        "time_s": flights.steps.double().numpy() * flights.dt_s,
        **{name: values.double().numpy() for name, values in flights.metrics.items()},
    }


def density_near_route(pool: ScenePool) -> Float[Tensor, " p"]:
    """Share of the map cells within `NEAR_M` of start and control points' lines that are occupied.

    Of the straight lines between the points, in the plane.
    """
    occupied = (pool.shared[keys.ESDF] <= 0).cpu()
    layout = pool.layout
    rows, columns = occupied.shape[1:]
    y, x = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
    centres = (torch.stack((x, y), -1).reshape(-1, 2) + 0.5) * pool.resolution_m
    shares = []
    for entry in range(len(layout)):
        route = layout.route_w[entry, : int(layout.route_length[entry, 0])]
        points = torch.cat((layout.start_w[entry, None], route))[:, :2] - layout.origin_w[entry]
        near = _distance_to_lines(centres, points) <= NEAR_M
        shares.append(occupied[entry].reshape(-1)[near].double().mean())
    return torch.stack(shares)


def write_episodes(path: Path, episodes: Mapping[str, np.ndarray]) -> None:
    """Writes the table, a line per episode, so that a crash leaves no half of one."""
    with replacing(path) as part, part.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(episodes)
        writer.writerows(
            [f"{value:.6g}" if isinstance(value, float) else value for value in row]
            for row in zip(*(column.tolist() for column in episodes.values()), strict=True)
        )


def read_episodes(path: Path, expected: int) -> Episodes:
    """The table that `write_episodes` wrote.

    Raises:
        ConfigError: The file is missing, cut, or not of `expected` episodes.
    """
    again = go_on(path.parent)
    repair = f"delete it; the sweep flies the episodes again when it goes on with: {again}"
    if not path.exists():
        raise ConfigError(f"{path} is missing; {repair}")
    try:
        text = path.read_text()
        header, *rows = csv.reader(text.splitlines())
        if not text.endswith("\n"):
            raise ValueError("the last row is cut")
        if any(len(row) != len(header) for row in rows) or len(rows) != expected:
            raise ValueError(f"{len(rows)} whole rows of {expected}")
        columns = dict(zip(header, map(np.array, zip(*rows, strict=True)), strict=True))
        table = {
            name: column if name == "outcome" else column.astype(np.float64)
            for name, column in columns.items()
        }
    except (OSError, ValueError, csv.Error) as error:
        raise ConfigError(f"{path} is cut or damaged ({error}); {repair}") from None
    if missing := [name for name in COLUMNS if name not in table]:
        raise ConfigError(f"{path} has no column {missing[0]}; {repair}")
    return table


def _distance_to_lines(
    cells: Float[Tensor, "c 2"], points: Float[Tensor, "r 2"]
) -> Float[Tensor, " c"]:
    """Distance [m] of each cell to the nearest of the lines that join the points."""
    start, along = points[:-1], points[1:] - points[:-1]
    offset = cells[:, None] - start
    length = along.square().sum(-1).clamp(min=1e-12)
    share = ((offset * along).sum(-1) / length).clamp(0, 1)
    return torch.linalg.vector_norm(offset - share[..., None] * along, dim=-1).amin(-1)
