"""Which columns a recording of RESC has, and what its tools need of them."""

from collections.abc import Collection, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

from resc import keys
from resc.errors import RecordingError
from resc.recording.schema import ACTION, SAMPLED_ACTION, Column

if TYPE_CHECKING:
    import tensordict

STATE_COLUMNS = (
    Column(keys.POSITION_W, ("x", "y", "z"), "float32", "m", "world"),
    Column(keys.VELOCITY_W, ("x", "y", "z"), "float32", "m/s", "world"),
    Column(keys.ATTITUDE_WB, ("w", "x", "y", "z"), "float32", "-", "body to world"),
    Column(keys.BODY_RATE_B, ("x", "y", "z"), "float32", "rad/s", "body"),
)
"""The state before a step."""
MEASURED_COLUMNS = (
    Column(keys.MOCAP_POSITION_W, ("x", "y", "z"), "float32", "m", "world"),
    Column(keys.MOCAP_ATTITUDE_WB, ("w", "x", "y", "z"), "float32", "-", "body to world"),
    Column(keys.MOCAP_FRESH, (), "bool"),
    Column(keys.IMU_SPECIFIC_FORCE_B, ("x", "y", "z"), "float32", "m/s^2", "body"),
    Column(keys.IMU_BODY_RATE_B, ("x", "y", "z"), "float32", "rad/s", "body"),
)
"""What devices had read by then, where there are any."""
ESTIMATE_COLUMNS = tuple(
    replace(column, key=keys.ESTIMATES[column.key]) for column in STATE_COLUMNS
)
"""What was estimated of the state, where anything was."""
REPLAN_COLUMNS = (
    Column(keys.REPLAN_STATUS, (), "int32", "-"),
    Column(keys.REPLANS, (), "int32", "-"),
    Column(keys.REPLAN_MOVED, (), "bool"),
)
"""How routes were renewed by then, where they are."""
FURTHER = (*MEASURED_COLUMNS, *ESTIMATE_COLUMNS, *REPLAN_COLUMNS)
FLAGS = tuple(Column(key, (), "bool") for key in (keys.TERMINATED, keys.TRUNCATED))
REWARD_TERMS = ("reward_terms",)
FLOWN = (*(column.key for column in STATE_COLUMNS), keys.ACTION)
"""What pictures and scenes are drawn from: the state before a step, and what was flown in it."""

REAL = "px4"
"""What the metadata `source` of the recording of a real flight says."""
FLIGHT_COLUMNS = (
    *STATE_COLUMNS,
    Column(keys.BODY_RATE_COMMAND_B, ("x", "y", "z"), "float32", "rad/s", "body"),
    Column(keys.THROTTLE_COMMAND, (), "float32", "-"),
    Column(keys.MOTOR_OUTPUT, ("m1", "m2", "m3", "m4"), "float32", "-"),
    Column(keys.SPECIFIC_FORCE_B, ("x", "y", "z"), "float32", "m/s^2", "body"),
)
"""What a recording of a real flight may hold: set-points in place of actions, and no rewards."""


def before_step(kept: Collection[keys.NestedKey]) -> tuple[Column, ...]:
    """Columns of what is known before a step, of a world that keeps these keys."""
    return (*STATE_COLUMNS, *(column for column in FURTHER if column.key in kept))


def usual_columns(
    rewards: tuple[str, ...], kept: Collection[keys.NestedKey] = ()
) -> tuple[Column, ...]:
    """Columns of training and evaluation, with the names of the reward terms."""
    reward = Column(keys.REWARD, (), "float32")
    terms = Column(REWARD_TERMS, rewards, "float32")
    return (*before_step(kept), ACTION, SAMPLED_ACTION, reward, terms, *FLAGS)


def require_columns(
    steps: "tensordict.TensorDictBase", wanted: Iterable[keys.NestedKey], reader: str
) -> None:
    """Refuses recorded steps that lack a column.

    Raises:
        RecordingError: It names the column, and the `reader` that needs it.
    """
    missing = [key for key in wanted if steps.get(key, None) is None]
    if missing:
        raise RecordingError(
            f"The recording holds no column {'.'.join(missing[0])}, which {reader} needs; record "
            "with recorder.fields=null."
        )
