"""What a recording holds: its columns, the protobuf schemas built from them, and the description stored in every file."""

import json
import math
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np
import torch
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)

from resc.errors import ConfigError, RecordingError

FORMAT = "1"
"""Version of the file layout; a reader refuses any other."""

ROLLOUT, EPISODES, WORLD = "/rollout", "/episodes", "/world"
SCHEMA_NAMES = {ROLLOUT: "resc.RolloutFragment", EPISODES: "resc.Episode", WORLD: "resc.World"}

_Field = FieldDescriptorProto
# Fixed-width types only: a packed repeated field is then a little-endian array that numpy copies as it is.
_TYPES: dict[torch.dtype, tuple[str, int]] = {
    torch.float32: ("<f4", _Field.TYPE_FLOAT),
    torch.bool: ("?", _Field.TYPE_BOOL),
    torch.int32: ("<i4", _Field.TYPE_SFIXED32),
    torch.uint32: ("<u4", _Field.TYPE_FIXED32),
}
_DTYPE_NAMES = {str(dtype).removeprefix("torch."): dtype for dtype in _TYPES}
# A lower-case first letter keeps a field's name apart from the name of the message nested under it.
_NAME = re.compile(r"[a-z][A-Za-z0-9_]*")


def require(fine: bool, name: str, value: object, expected: str) -> None:
    """Refuse a recorder argument unless `fine`."""
    if not fine:
        raise ConfigError(f"recorder.{name} is {value!r}; expected {expected}.")


@dataclass(frozen=True)
class Column:
    """One leaf `[T, N, *shape]` of the recorded TensorDict, and the names under which viewers plot its components.

    `components` are in the row-major order of `shape`; a scalar has none. Without `shape` a leaf has one trailing axis as
    long as its components, and a scalar is `[T, N, 1]`.
    """

    key: tuple[str, ...]
    components: tuple[str, ...]
    dtype: torch.dtype
    unit: str = ""
    frame: str = ""
    shape: tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        width = max(1, len(self.components))
        shape = (width,) if self.shape is None else tuple(self.shape)
        object.__setattr__(self, "shape", shape)
        if self.dtype not in _TYPES:
            raise ConfigError(
                f"Recorded column {self.key} has dtype {self.dtype}; expected one of {', '.join(_DTYPE_NAMES)}."
            )
        if math.prod(shape) != width:
            raise ConfigError(
                f"Recorded column {self.key} names {width} component(s) for shape {shape}; name one for each value."
            )
        for name in (*self.key, *self.components):
            if not _NAME.fullmatch(name):
                raise ConfigError(
                    f"Recorded column {self.key} holds the name '{name}'; "
                    "use a lower-case letter followed by letters, digits and underscores."
                )

    @property
    def width(self) -> int:
        """Values per step and environment."""
        return max(1, len(self.components))

    @property
    def numpy_dtype(self) -> np.dtype:
        """Type of one value on the wire."""
        return np.dtype(_TYPES[self.dtype][0])


class Leaf(NamedTuple):
    """Position of one protobuf field in the batch: which column, which component of it."""

    column: int
    component: int


Tree = dict[str, "Tree | Leaf"]


def column_tree(columns: Sequence[Column]) -> Tree:
    """Nested names of all columns, ending in leaves: the structure of one fragment message after its header."""
    root: Tree = {}
    for index, column in enumerate(columns):
        node = root
        for part in column.key[:-1]:
            node = node.setdefault(part, {})
            if isinstance(node, Leaf):
                raise ConfigError(f"Recorded column {column.key} lies inside another column; record one of the two.")
        last = column.key[-1]
        if last in node or (node is root and last in ("env_id", "batch", "start_step")):
            raise ConfigError(f"Recorded column {column.key} appears twice or hides a header field; rename or drop it.")
        leaves = {name: Leaf(index, j) for j, name in enumerate(column.components)}
        if len(leaves) != len(column.components):
            raise ConfigError(f"Recorded column {column.key} names a component twice; give each its own name.")
        node[last] = leaves or Leaf(index, 0)
    return root


def _add_field(message: DescriptorProto, name: str, kind: int, repeated: bool = False) -> FieldDescriptorProto:
    # json_name: without it tools print camelCase names that no key of ours has.
    label = _Field.LABEL_REPEATED if repeated else _Field.LABEL_OPTIONAL
    number = len(message.field) + 1
    return message.field.add(name=name, json_name=name, number=number, type=kind, label=label)


def _add_tree(message: DescriptorProto, tree: Tree, columns: Sequence[Column], scope: str) -> None:
    for name, child in tree.items():
        if isinstance(child, Leaf):
            _add_field(message, name, _TYPES[columns[child.column].dtype][1], repeated=True)
        else:
            nested = message.nested_type.add(name=name[0].upper() + name[1:])
            field = _add_field(message, name, _Field.TYPE_MESSAGE)
            field.type_name = f"{scope}.{nested.name}"
            _add_tree(nested, child, columns, field.type_name)


def _descriptor_set(file_name: str, message: DescriptorProto) -> bytes:
    file = FileDescriptorProto(name=file_name, package="resc", syntax="proto3", message_type=[message])
    return FileDescriptorSet(file=[file]).SerializeToString()


def schema_data(topic: str, columns: Sequence[Column]) -> bytes:
    """Serialised `FileDescriptorSet` of the messages on a topic; third-party readers decode with nothing else."""
    message = DescriptorProto(name=SCHEMA_NAMES[topic].removeprefix("resc."))
    if topic == ROLLOUT:
        _add_field(message, "env_id", _Field.TYPE_FIXED32)
        _add_field(message, "batch", _Field.TYPE_FIXED32)
        _add_field(message, "start_step", _Field.TYPE_FIXED64)
        _add_tree(message, column_tree(columns), columns, f".{SCHEMA_NAMES[ROLLOUT]}")
    elif topic == EPISODES:
        for name in ("env_id", "episode"):
            _add_field(message, name, _Field.TYPE_FIXED32)
        for name in ("start_step", "end_step"):
            _add_field(message, name, _Field.TYPE_FIXED64)
        for name in ("length", "scene"):
            _add_field(message, name, _Field.TYPE_FIXED32)
        _add_field(message, "return_", _Field.TYPE_FLOAT)
        _add_field(message, "success", _Field.TYPE_BOOL)
        _add_field(message, "outcome", _Field.TYPE_STRING)
    else:
        _add_field(message, "start_step", _Field.TYPE_FIXED64)
        array = message.nested_type.add(name="Array")
        _add_field(message, "arrays", _Field.TYPE_MESSAGE, repeated=True).type_name = ".resc.World.Array"
        _add_field(array, "name", _Field.TYPE_STRING)
        _add_field(array, "shape", _Field.TYPE_FIXED32, repeated=True)
        for name, kind in (("floats", _Field.TYPE_FLOAT), ("bools", _Field.TYPE_BOOL)):
            _add_field(array, name, kind, repeated=True)
        for name, kind in (("ints", _Field.TYPE_SFIXED32), ("uints", _Field.TYPE_FIXED32)):
            _add_field(array, name, kind, repeated=True)
    return _descriptor_set(f"resc/{topic[1:]}.proto", message)


@dataclass(frozen=True)
class Specification:
    """Everything a reader must know to decode a file; stored as the metadata record `resc.spec`."""

    columns: tuple[Column, ...]
    num_envs: int
    dt_s: float
    outcomes: tuple[str, ...]
    round_bits: int | None
    every_n_batches: int
    session: str
    """One recorder's files share it; steps of different sessions are never joined into one episode."""

    def __post_init__(self) -> None:
        column_tree(self.columns)
        require(len(self.columns) > 0, "columns", self.columns, "at least one")
        require(self.round_bits is None or 1 <= self.round_bits <= 22, "round_bits", self.round_bits, "1 to 22, or null")
        require(self.every_n_batches >= 1, "every_n_batches", self.every_n_batches, "1 or more")
        require(self.dt_s > 0, "dt_s", self.dt_s, "a positive time")
        # Times stay unique as long as the environment numbers fit into one control step.
        require(1 <= self.num_envs <= self.dt_ns, "num_envs", self.num_envs, f"1 to dt_s in nanoseconds ({self.dt_ns})")

    @property
    def dt_ns(self) -> int:
        """Control step in nanoseconds; log_time = start_step * dt_ns + env_id."""
        return round(self.dt_s * 1e9)

    def to_metadata(self) -> dict[str, str]:
        """The flat strings of an MCAP metadata record, each value JSON."""
        columns = [asdict(column) | {"dtype": str(column.dtype).removeprefix("torch.")} for column in self.columns]
        values = {name: getattr(self, name) for name in self.__dataclass_fields__} | {"columns": columns}
        return {"format": FORMAT} | {name: json.dumps(value) for name, value in values.items()}

    @classmethod
    def from_metadata(cls, metadata: dict[str, str], origin: str) -> "Specification":
        """The specification in a metadata record of the file `origin`."""
        if metadata.get("format") != FORMAT:
            raise RecordingError(
                f"{origin} has recording format {metadata.get('format')}, and this version of RESC reads format {FORMAT}. "
                "Read it with the version of RESC that wrote it (metadata resc.run)."
            )
        values = {name: json.loads(metadata[name]) for name in cls.__dataclass_fields__}
        values["columns"] = tuple(
            Column(**{
                **column,
                "key": tuple(column["key"]),
                "components": tuple(column["components"]),
                "dtype": _DTYPE_NAMES[column["dtype"]],
                "shape": tuple(column["shape"]),
            })
            for column in values["columns"]
        )  # fmt: skip
        values["outcomes"] = tuple(values["outcomes"])
        return cls(**values)
