"""Which maps of a scene to look at first: those on which something went wrong, the worst first."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from resc.evaluation.statistics import CLOSE_M


def worst_maps(
    number: Int[np.ndarray, " f"],
    *,
    failed: Bool[np.ndarray, " f"],
    clearance_m: Float[np.ndarray, " f"],
    slowness: Float[np.ndarray, " f"],
) -> list[Int[np.ndarray, " _"]]:
    """The flights of each map, the worst map first.

    First the maps on which flights fail, by how many; then those on which one comes closer than
    0.3 m to an obstacle, by the least clearance; then the others, the slowest first.

    Args:
        number: Of each flight, its map.
        failed: Whether it does not arrive.
        clearance_m: Its least clearance.
        slowness: Its time over one that does not depend on the flight.
    """
    ranked = []
    for which in np.unique(number):
        own = np.flatnonzero(number == which)
        tight = min(float(clearance_m[own].min()), CLOSE_M)
        ranked.append(((-int(failed[own].sum()), tight, -float(slowness[own].max())), own))
    return [own for _, own in sorted(ranked, key=lambda pair: pair[0])]


def slowness(
    seconds: Float[np.ndarray, " f"],
    bounds_s: Sequence[float | None],
    planned_m: Float[np.ndarray, " f"],
) -> Float[np.ndarray, " f"]:
    """Time of each flight over its bound, or over its planned length unless all have a bound."""
    known = [bound for bound in bounds_s if bound is not None]
    return seconds / (np.array(known) if len(known) == len(seconds) else planned_m)
