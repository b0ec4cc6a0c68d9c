"""The specification of a file that lost it: from the protobuf schemas and the messages."""

import uuid
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO

from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    FieldDescriptorProto,
    FileDescriptorSet,
)
from google.protobuf.message import DecodeError

from resc import keys
from resc.errors import ConfigError, RecordingError
from resc.recording import events, wire
from resc.recording.columns import FURTHER, usual_columns
from resc.recording.schema import (
    EPISODES,
    FIELDS,
    ROLLOUT,
    SCHEMA_NAMES,
    Column,
    dtype_of,
    schema_data,
)
from resc.recording.specification import Specification
from resc.recording.walk import Found, Walk

_KNOWN = {column.key: column for column in usual_columns((), {column.key for column in FURTHER})}


def rebuilt(file: IO[bytes], size: int, path: Path) -> Specification | None:
    """The specification, as far as a file still tells it; None if it holds nothing of RESC's.

    The number of environments is the largest one found. Unknown stay the rounding of values, the
    share of batches that was recorded, and shapes of several axes; units are today's.

    Raises:
        RecordingError: The control step cannot be told, or the schema is none of RESC's.
    """
    walk, num_envs, dt_ns = Walk(file, size), 0, 0
    outcomes: dict[str, None] = {}
    try:
        for found in walk.messages():
            step, env_id, outcome = _said(found)
            num_envs = max(num_envs, env_id + 1)
            dt_ns = dt_ns or ((found.log_time - env_id) // step if step else 0)
            outcomes |= dict.fromkeys(outcome)
    except (ValueError, LookupError) as error:
        raise _lost(path, "its messages are not what RESC wrote") from error
    if not walk.schemas:
        return None
    if not dt_ns:
        raise _lost(path, "it holds nothing after step 0, so its time step is unknown")
    return Specification(
        columns=columns_of(walk.schemas, path),
        num_envs=max(num_envs, 1),
        dt_s=dt_ns / 1e9,
        outcomes=tuple(outcomes),
        round_bits=None,
        every_n_batches=1,
        session=_session_of(path.resolve().parent),
    )


def _session_of(folder: Path) -> str:
    """One session for the files of a folder; it does not tell where the folder is."""
    return uuid.uuid5(uuid.NAMESPACE_URL, folder.as_uri()).hex


def _said(found: Found) -> tuple[int, int, list[str]]:
    """What a message says of its time and place: step, environment, outcome."""
    if found.topic == ROLLOUT:
        return *wire.place_of(found.data), []
    if found.topic == EPISODES:
        values, outcomes = events.decode_episodes([found.data])
        return int(values["end_step"][0]), int(values["env_id"][0]), outcomes
    step, _ = events.decode_arrays(found.topic, found.data)
    return step, 0, []  # log times of scenes and starts name no environment


def columns_of(schemas: Mapping[str, bytes], path: Path) -> tuple[Column, ...]:
    """The columns that a schema of `/rollout` describes; the usual ones where there is none."""
    if ROLLOUT not in schemas:
        return tuple(_KNOWN.values())
    name = SCHEMA_NAMES[ROLLOUT].removeprefix("resc.")
    try:
        files = FileDescriptorSet.FromString(schemas[ROLLOUT]).file
        message = next(m for f in files for m in f.message_type if m.name == name)
        columns = tuple(_columns_in(message))
        if schema_data(ROLLOUT, columns) == schemas[ROLLOUT]:
            return columns
    except (DecodeError, StopIteration, LookupError, ConfigError):
        pass
    raise _lost(path, f"the schema of {ROLLOUT} is not one of RESC's")


def _columns_in(message: DescriptorProto, key: tuple[str, ...] = ()) -> Iterator[Column]:
    nested = {inner.name: inner for inner in message.nested_type}
    for field in message.field:
        if not key and field.name in FIELDS[ROLLOUT]:
            continue
        name = (*key, field.name)
        if field.type != FieldDescriptorProto.TYPE_MESSAGE:
            yield _column(name, (), field.type)
            continue
        inner = nested[field.type_name.rpartition(".")[2]]
        kinds = {part.type for part in inner.field}
        parts = tuple(part.name for part in inner.field)
        alone = any((*name, part) in keys.DECLARED for part in parts)
        if len(kinds) == 1 and FieldDescriptorProto.TYPE_MESSAGE not in kinds and not alone:
            yield _column(name, parts, kinds.pop())
        else:
            yield from _columns_in(inner, name)


def _column(key: tuple[str, ...], components: tuple[str, ...], kind: int) -> Column:
    column = Column(key, components, dtype_of(kind))
    usual = _KNOWN.get(key)
    if usual and (usual.components, usual.dtype_name) == (components, column.dtype_name):
        return usual
    declared = keys.DECLARED.get(key)
    return Column(key, components, column.dtype_name, declared.unit if declared else "")


def _lost(path: Path, why: str) -> RecordingError:
    return RecordingError(
        f"{path} lost its metadata 'resc.spec' to another program and cannot be read: {why}; take "
        "the file that RESC wrote."
    )
