"""Which maps of a scene to look at first: those on which something went wrong, the worst first."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from resc.evaluation.courses import Course
from resc.evaluation.flights import Flights
from resc.evaluation.references import Reference
from resc.evaluation.statistics import CLOSE_M


def worst_maps(
    course: Course, flights: Flights, references: Sequence[Reference | None]
) -> list[Int[np.ndarray, " f"]]:
    """The flights of each map, the worst map first.

    First the maps on which flights fail, by how many; then those on which one comes closer than
    0.3 m to an obstacle, by the least clearance; then the others, the slowest first: by the longest
    time over the bound, or over the planned length where a map has no bound.
    """
    failed = ~flights.success.numpy()
    clearance = flights.metrics.get("least_clearance")
    near = np.full(len(flights), np.inf) if clearance is None else clearance.double().numpy()
    slowness = _slowness(course, flights, references)
    ranked = []
    for number in np.unique(course.number):
        own = np.flatnonzero(course.number == number)
        closest = float(near[own].min())
        tight = min(closest, CLOSE_M)
        lost = int(failed[own].sum())
        ranked.append(((-lost, tight, -float(slowness[own].max())), own))
    return [own for _, own in sorted(ranked, key=lambda pair: pair[0])]


def _slowness(
    course: Course, flights: Flights, references: Sequence[Reference | None]
) -> Float[np.ndarray, " f"]:
    """Time up to the finish over the bound, or over the planned length if any map has no bound."""
    seconds = flights.counted.double().numpy() * flights.dt_s
    bounds = [reference.fastest.duration_s for reference in references if reference is not None]
    return seconds / (bounds if len(bounds) == len(flights) else course.planned_lengths_m)
