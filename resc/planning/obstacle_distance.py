"""Distance of points to obstacles from above: as numbers, and as expressions for the solver casadi.

Boxes are `[x, y, len_x, len_y]` from the lower-left corner [m], pillars `[x, y, radius]`.
"""

import os
from collections.abc import Sequence
from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Float

from resc.errors import ConfigError


def solver() -> ModuleType:
    """The module casadi.

    Raises:
        ConfigError: It is not installed.
    """
    # Its algebra would start a thread for every core, which only wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        import casadi
    except ImportError:
        raise ConfigError(
            "The bound is computed with casadi, which is not installed; install it with: "
            "pip install -e '.[bound]'."
        ) from None
    return casadi


def distances(
    points_m: Float[np.ndarray, "p 2"], boxes: Sequence[tuple[float, ...]]
) -> Float[np.ndarray, "k p"]:
    """Distance of points to the surfaces of obstacles [m], below 0 inside."""
    found = np.empty((len(boxes), len(points_m)))
    for row, (x, y, *lengths) in zip(found, boxes, strict=True):
        if len(lengths) == 1:
            row[:] = np.hypot(*(points_m - (x, y)).T) - lengths[0]
        else:
            low = np.array((x, y))
            beside = np.maximum(low - points_m, points_m - low - lengths)
            row[:] = np.hypot(*beside.clip(min=0).T) + beside.max(1).clip(max=0)
    return found


def outside_box(
    ca: ModuleType,
    points: Any,  # noqa: ANN401 - an expression of casadi, 2 x points
    box: tuple[float, ...],
    reach_m: float,
) -> Any:  # noqa: ANN401
    """Squared distance of points to a box less the squared reach [m^2]; another shape is another.

    Of a pillar, `[x, y, radius]`, from its axis, which the radius is reached from, too. Exact and,
    outside the obstacle, with a continuous derivative.
    """
    if len(box) == 3:
        x, y, radius = box
        return (points[0, :] - x) ** 2 + (points[1, :] - y) ** 2 - (radius + reach_m) ** 2
    x, y, length_x, length_y = box
    beside_x = ca.fmax(ca.fabs(points[0, :] - x - length_x / 2) - length_x / 2, 0)
    beside_y = ca.fmax(ca.fabs(points[1, :] - y - length_y / 2) - length_y / 2, 0)
    return beside_x**2 + beside_y**2 - reach_m**2
