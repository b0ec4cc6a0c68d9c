"""What every topic and field of a recording means: tables for the documentation and for a file."""

from collections.abc import Iterable, Sequence

from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorSet

from resc import keys
from resc.recording.columns import REWARD_TERMS, usual_columns
from resc.recording.schema import (
    ACTION,
    ARRAY_FIELDS,
    EPISODES,
    FIELDS,
    KNOWN_MAPS,
    ROLLOUT,
    ROUTES,
    SAMPLED_ACTION,
    SCHEMA_NAMES,
    STARTS,
    WORLD,
    Column,
    schema_data,
    type_name,
)

USUAL_COLUMNS = usual_columns(("name",))
"""Columns of training and evaluation, with one reward term called `name`."""
TOPICS = {
    ROLLOUT: "one message for each environment and batch; log time: its first step + `env_id` ns",
    EPISODES: "one message for each finished episode; log time: its last step + `env_id` ns",
    WORLD: "one message for each set of scenes; log time: the step from which it is in use",
    STARTS: "one message for each batch in which episodes begin; log time: its first step",
    ROUTES: "one message for each batch in which routes arrive, of flights with replanning",
    KNOWN_MAPS: "one message for each batch with such maps, of evaluated flights with sensing",
}
"""When a message is written, and its time."""
_STEP = "control step of the run"
MEANINGS: dict[str, dict[str, tuple[str, str]]] = {
    ROLLOUT: {
        "env_id": ("-", "environment, from 0; also the sequence number"),
        "batch": ("-", "batch since the recorder was opened, from 0"),
        "start_step": ("steps", f"{_STEP} that the first values are of"),
    },
    EPISODES: {
        "env_id": ("-", "environment, from 0"),
        "episode": ("-", "episodes of this environment before it"),
        "start_step": ("steps", f"{_STEP} that it began in"),
        "end_step": ("steps", f"{_STEP} that it ended in, included"),
        "length": ("steps", "number of its steps"),
        "scene": ("-", "entry of the scene pool that it was flown in"),
        "return_": ("-", "undiscounted sum of its rewards"),
        "difficulty": ("-", "mean of the difficulties that it was flown at; 1 is full"),
        "success": ("-", "whether it reached its goal"),
        "outcome": ("-", "why it ended, such as `success`, `collision`, `time_limit`"),
    },
    WORLD: {"start_step": ("steps", f"{_STEP} from which the scenes are in use")},
    **{
        topic: {"start_step": ("steps", f"{_STEP} that the batch begins with")}
        for topic in (STARTS, ROUTES, KNOWN_MAPS)
    },
}
"""Unit and meaning of the fields that every file has."""
_AXES = "roll, pitch, yaw rate, collective thrust"
_OWN: dict[keys.NestedKey, keys.Declaration] = {
    ACTION.key: keys.Declaration((), "-", f"what was flown, in [-1, 1]: {_AXES}"),
    SAMPLED_ACTION.key: keys.Declaration(
        (), "-", "output of the policy, clipped to [-1, 1] before it is flown; for replays"
    ),
    REWARD_TERMS: keys.Declaration((), "-", "weighted reward term, by name; they sum to `reward`"),
}
"""Columns that only recordings have, or that mean something else there."""
_ARRAYS = {
    WORLD: {"entry": ("-", "entries of the scene pool that the rows of the other arrays are of")},
    STARTS: {
        "env_id": ("-", "environment of each episode that begins"),
        "step": ("steps", "first step of each, in control steps of the run"),
    },
    ROUTES: {
        "env_id": ("-", "environment of each route"),
        "step": ("steps", f"first {_STEP} that it is flown in"),
        "planned_step": ("steps", f"{_STEP} before which it was planned"),
        "cause": ("-", "0 first, 1 the one before was blocked, 2 closed off, 3 search gave up"),
        "length": ("-", "number of control points"),
    },
    KNOWN_MAPS: {
        "env_id": ("-", "environment of each map"),
        "step": ("steps", f"{_STEP} before which it was known"),
        "rows": ("-", "cells along y"),
        "columns": ("-", "cells along x"),
    },
}
_LAST = {
    ROUTES: ("array `route_w`", "floats", "m", "world", "control points, padded with the last"),
    KNOWN_MAPS: (
        *("array `cells`", "uints", "-", ""),
        "row by row, 16 cells in each number, the first in its lowest two bits: 0 never seen, "
        "1 free, 2 occupied",
    ),
}
WORLD_KEYS = (
    keys.MAP_ORIGIN_W,
    keys.MAP_SIZE,
    keys.BOXES_W,
    keys.PILLARS_W,
    keys.MOVERS_W,
    keys.START_W,
    keys.START_MOTION,
    keys.ROUTE_W,
    keys.ROUTE_LENGTH,
    keys.ROUTE_CLEARANCE,
    keys.SCENE_DIFFICULTY,
)
START_KEYS = (
    keys.CLOCK,
    keys.SCENE_INDEX,
    keys.POSITION_W,
    keys.VELOCITY_W,
    keys.ATTITUDE_WB,
    keys.BODY_RATE_B,
    keys.ROTOR_THRUST,
    keys.ACCELERATION_W,
    keys.ACTION_QUEUE,
    keys.MASS,
    keys.INERTIA_B,
    keys.TORQUE_COEFFICIENT,
    keys.ARM,
    keys.THRUST_SCALE,
    keys.ACTION_DELAY,
    keys.ROUTE_W,
    keys.ROUTE_LENGTH,
    keys.ROUTE_INDEX,
    keys.CONTROL_POINTS_W,
    keys.FINISHED,
)
_FRAMES = {"_w": "world", "_b": "body", "_wb": "body to world"}
_HEAD = "| field | type | unit | frame | meaning |\n|---|---|---|---|---|"
Row = tuple[str, str, str, str, str]


def describe(columns: Sequence[Column] = USUAL_COLUMNS) -> str:
    """Tables of all topics and fields in Markdown; `columns` are those of `/rollout`."""
    parts = []
    for topic, when in TOPICS.items():
        rows = [*_head_rows(topic), *_rows_after(topic, columns)]
        table = "\n".join(f"| {' | '.join(row)} |" for row in rows)
        title = f"### `{topic}`: `{SCHEMA_NAMES[topic]}`"
        parts.append(f"{title}\n\n{when[0].upper()}{when[1:]}.\n\n{_HEAD}\n{table}")
    return "\n\n".join(parts)


def _head_rows(topic: str) -> Iterable[Row]:
    """The scalar fields of a message."""
    for name, kind in FIELDS[topic].items():
        unit, meaning = MEANINGS[topic][name]
        yield f"`{name}`", _type_name(kind), unit, "", meaning


def _rows_after(topic: str, columns: Sequence[Column]) -> Iterable[Row]:
    """The arrays of a message: columns by step, or arrays by name."""
    if topic == ROLLOUT:
        for column in columns:
            yield _column_row(column)
    if topic in _ARRAYS:
        for name, (unit, meaning) in _ARRAYS[topic].items():
            yield f"array `{name}`", ARRAY_FIELDS["int64"], unit, "", meaning
        for key in {WORLD: WORLD_KEYS, STARTS: START_KEYS}.get(topic, ()):
            name = key[-1] if topic == WORLD else ".".join(key)
            declared = keys.DECLARED[key]
            kind = ARRAY_FIELDS[type_name(declared.dtype)]
            yield f"array `{name}`", kind, declared.unit, _frame(key), declared.meaning
    if topic in _LAST:
        yield _LAST[topic]


def _column_row(column: Column) -> Row:
    name = ".".join(column.key)
    paths = [f"{name}.{part}" for part in column.components] or [name]
    declared = {**keys.DECLARED, **_OWN}.get(column.key, keys.Declaration((), "", ""))
    fields = ", ".join(f"`{path}`" for path in paths)
    kind = f"repeated {_wire_type(column, paths[0])}"
    return fields, kind, column.unit or declared.unit, column.frame, declared.meaning


def _wire_type(column: Column, path: str) -> str:
    """Type of the protobuf field at a path, as the schema in the file has it."""
    file = FileDescriptorSet.FromString(schema_data(ROLLOUT, (column,))).file[0]
    message = file.message_type[0]
    *parents, last = path.split(".")
    for name in parents:
        message = next(m for m in message.nested_type if m.name == name[0].upper() + name[1:])
    return _type_name(next(field.type for field in message.field if field.name == last))


def _type_name(kind: int) -> str:
    return FieldDescriptorProto.Type.Name(kind).removeprefix("TYPE_").lower()  # pyright: ignore


def _frame(key: keys.NestedKey) -> str:
    ending = key[-1].rpartition("_")[2]
    return _FRAMES.get(f"_{ending}", "")
