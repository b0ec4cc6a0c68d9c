"""What an observation sees of a flight, and the colours it is drawn in."""

from collections.abc import Callable, Mapping

import torch
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.math.rotation import heading
from resc.sights import Pose, Shape
from resc.term import Context, Observation
from resc.viewing.colours import FIRST, FRAME, MOVING, PLAN, SECOND

COLOURS = {
    "first": FIRST,
    "second": SECOND,
    "velocity": MOVING,
    "ray": FRAME,
    "point": PLAN,
    "measured": FIRST,
    "lost": MOVING,
}


def colour_of(shape: Shape) -> str:
    """The colour of what a shape is about."""
    return COLOURS[shape.role]


def seen_by(
    term: Observation,
    context: Context,
    tensors: Mapping[keys.NestedKey, Tensor],
    unit: Callable[[int], Tensor],
) -> list[Shape]:
    """What a term sees, computed from the tensors of a flight [t]; nothing if it draws nothing.

    Args:
        term: The observation.
        context: Of the flight.
        tensors: What it may read; the vehicle's state and its control points are among them.
        unit: Gives as many uniform numbers per step, in place of those drawn in flight.

    Raises:
        ConfigError: It reads something else.
    """
    if type(term).sights is Observation.sights:
        return []
    missing = [".".join(key) for key in term.reads if key not in tensors]
    if missing:
        raise ConfigError(
            f"{term.path} reads {', '.join(missing)}, so its sights cannot be drawn later; let "
            f"it read only {', '.join('.'.join(key) for key in tensors)}, or drop sights()."
        )
    term.bind(context)
    drawn = [unit(term.step_draws)] if term.step_draws else []
    numbers = term.compute(*(tensors[key] for key in term.reads), *drawn)
    direction = heading(tensors[keys.ATTITUDE_WB])
    pose = Pose(
        position=tensors[keys.POSITION_W][:, :2],
        velocity=tensors[keys.VELOCITY_W][:, :2],
        yaw=torch.atan2(direction[:, 1], direction[:, 0]),
        control_points=tensors[keys.CONTROL_POINTS_W][..., :2],
    )
    return term.sights(numbers, pose)
