"""What a recording holds: its columns, and the protobuf schemas built from them."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)

from resc.errors import ConfigError

if TYPE_CHECKING:
    import torch

ROLLOUT, EPISODES, WORLD, STARTS = "/rollout", "/episodes", "/world", "/starts"
ROUTES, KNOWN_MAPS = "/routes", "/known_maps"
USUAL = (ROLLOUT, EPISODES, WORLD, STARTS)
"""Topics of every file; the others are only where there is something of them."""
SCHEMA_NAMES = {
    ROLLOUT: "resc.RolloutFragment",
    EPISODES: "resc.Episode",
    WORLD: "resc.World",
    STARTS: "resc.Starts",
    ROUTES: "resc.Routes",
    KNOWN_MAPS: "resc.KnownMaps",
}

_Field = FieldDescriptorProto
# Fixed-width types only: a packed repeated field is then a little-endian array, as numpy has it.
# By the name that NumPy and PyTorch share: importing torch takes longer than most commands do.
_TYPES: dict[str, tuple[str, int]] = {
    "float32": ("<f4", _Field.TYPE_FLOAT),
    "bool": ("?", _Field.TYPE_BOOL),
    "int32": ("<i4", _Field.TYPE_SFIXED32),
    "uint32": ("<u4", _Field.TYPE_FIXED32),
}

FIELDS: dict[str, dict[str, int]] = {
    ROLLOUT: {
        "env_id": _Field.TYPE_FIXED32,
        "batch": _Field.TYPE_FIXED32,
        "start_step": _Field.TYPE_FIXED64,
    },
    EPISODES: {
        "env_id": _Field.TYPE_FIXED32,
        "episode": _Field.TYPE_FIXED32,
        "start_step": _Field.TYPE_FIXED64,
        "end_step": _Field.TYPE_FIXED64,
        "length": _Field.TYPE_FIXED32,
        "scene": _Field.TYPE_FIXED32,
        "return_": _Field.TYPE_FLOAT,
        "difficulty": _Field.TYPE_FLOAT,
        "success": _Field.TYPE_BOOL,
        "outcome": _Field.TYPE_STRING,
    },
    WORLD: {"start_step": _Field.TYPE_FIXED64},
    **{topic: {"start_step": _Field.TYPE_FIXED64} for topic in (STARTS, ROUTES, KNOWN_MAPS)},
}
"""Scalar fields of each message, numbered from 1; the others but episodes go on with arrays."""
EPISODE_KEYS = tuple(FIELDS[EPISODES])
# Wide integers only here: browsers cannot plot them, but nothing plots scenes and starts.
_ARRAY_TYPES = _TYPES | {"int64": ("<i8", _Field.TYPE_SFIXED64)}
ARRAY_FIELDS = dict(zip(_ARRAY_TYPES, ("floats", "bools", "ints", "uints", "longs"), strict=True))
"""Field of a named array of `resc.World` and its like for each type, numbered from 3."""

# A lower-case first letter keeps a field apart from the message type nested under its name.
_NAME = re.compile(r"[a-z][A-Za-z0-9_]*")


def type_name(dtype: object) -> str:
    """Name of a type of NumPy or PyTorch without its library, such as `float32`."""
    return str(dtype).removeprefix("torch.")


@dataclass(frozen=True)
class Column:
    """One leaf `[T, N, *shape]` of the recorded TensorDict, and the plot names of its components.

    `components` are in the row-major order of `shape`; a scalar has none. Without `shape` a leaf
    has one trailing axis as long as its components, and a scalar is `[T, N, 1]`. A type is one of
    PyTorch's, or its name, which is what `dtype_name` keeps.
    """

    key: tuple[str, ...]
    components: tuple[str, ...]
    dtype_name: "torch.dtype | str"
    unit: str = ""
    frame: str = ""
    shape: tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        width = max(1, len(self.components))
        shape = (width,) if self.shape is None else tuple(self.shape)
        object.__setattr__(self, "shape", shape)
        object.__setattr__(self, "dtype_name", type_name(self.dtype_name))
        known, plain = ", ".join(_TYPES), "a lower-case letter, then letters, digits, underscores"
        kind = f"has dtype {self.dtype_name}; expected one of {known}"
        self._require(self.dtype_name in _TYPES, kind)
        names = f"names {width} component(s) for shape {shape}; name one for each value"
        self._require(math.prod(shape) == width, names)
        for name in (*self.key, *self.components):
            self._require(bool(_NAME.fullmatch(name)), f"holds the name '{name}'; use {plain}")

    def _require(self, fine: bool, complaint: str) -> None:
        if not fine:
            raise ConfigError(f"Recorded column {self.key} {complaint}.")

    @property
    def width(self) -> int:
        """Values per step and environment."""
        return max(1, len(self.components))

    @property
    def dtype(self) -> "torch.dtype":
        """Type of the leaf."""
        import torch

        return getattr(torch, str(self.dtype_name))

    @property
    def numpy_dtype(self) -> np.dtype:
        """Type of one value on the wire."""
        return numpy_type(str(self.dtype_name))


ACTION = Column(("action",), ("p", "q", "r", "thrust"), "float32", "-")
"""What is flown: the sample of the policy, clipped to [-1, 1]."""
SAMPLED_ACTION = Column(("sampled_action",), ACTION.components, "float32", "-")
"""The sample itself, from which a replay flies. Before format 4 it was recorded as `action`."""


class Leaf(NamedTuple):
    """Position of one protobuf field in the batch: which column, which component of it."""

    column: int
    component: int


Tree = dict[str, Any]
"""Names to trees or leaves."""


def column_tree(columns: Sequence[Column]) -> Tree:
    """Nested names of all columns, ending in leaves: what follows the header of a fragment."""
    root: Tree = {}
    for index, column in enumerate(columns):
        leaves: Tree = {name: Leaf(index, j) for j, name in enumerate(column.components)}
        node: Tree | Leaf = root
        for part in column.key[:-1]:
            node = node.setdefault(part, {}) if isinstance(node, dict) else node
        last = column.key[-1]
        hidden = len(column.key) == 1 and last in FIELDS[ROLLOUT]
        if isinstance(node, Leaf) or last in node or hidden or len(leaves) < len(column.components):
            raise ConfigError(
                f"Recorded column {column.key} clashes with a column before it, a header field "
                f"({', '.join(FIELDS[ROLLOUT])}) or itself; give each its own name."
            )
        node[last] = leaves or Leaf(index, 0)
    return root


def _add_field(
    message: DescriptorProto, name: str, kind: int, repeated: bool = False
) -> FieldDescriptorProto:
    # json_name: without it tools print camelCase names that no key of ours has.
    label = _Field.LABEL_REPEATED if repeated else _Field.LABEL_OPTIONAL
    number = len(message.field) + 1
    return message.field.add(name=name, json_name=name, number=number, type=kind, label=label)


def _add_tree(message: DescriptorProto, tree: Tree, columns: Sequence[Column], scope: str) -> None:
    for name, child in tree.items():
        if isinstance(child, Leaf):
            _add_field(
                message, name, _TYPES[str(columns[child.column].dtype_name)][1], repeated=True
            )
        else:
            nested = message.nested_type.add(name=name[0].upper() + name[1:])
            field = _add_field(message, name, _Field.TYPE_MESSAGE)
            field.type_name = f"{scope}.{nested.name}"
            _add_tree(nested, child, columns, field.type_name)


def schema_data(topic: str, columns: Sequence[Column]) -> bytes:
    """Serialised `FileDescriptorSet` of a topic's messages, all that other readers need."""
    message = DescriptorProto(name=SCHEMA_NAMES[topic].removeprefix("resc."))
    for name, kind in FIELDS[topic].items():
        _add_field(message, name, kind)
    if topic == ROLLOUT:
        _add_tree(message, column_tree(columns), columns, f".{SCHEMA_NAMES[ROLLOUT]}")
    elif topic != EPISODES:
        field = _add_field(message, "arrays", _Field.TYPE_MESSAGE, repeated=True)
        array = message.nested_type.add(name="Array")
        field.type_name = f".{SCHEMA_NAMES[topic]}.{array.name}"
        _add_field(array, "name", _Field.TYPE_STRING)
        _add_field(array, "shape", _Field.TYPE_FIXED32, repeated=True)
        for dtype, name in ARRAY_FIELDS.items():
            _add_field(array, name, _ARRAY_TYPES[dtype][1], repeated=True)
    name = f"resc/{topic.removeprefix('/')}.proto"
    file = FileDescriptorProto(name=name, package="resc", syntax="proto3", message_type=[message])
    return FileDescriptorSet(file=[file]).SerializeToString()


def dtype_of(kind: int) -> str:
    """Name of the type of a column whose protobuf fields are of this kind."""
    return next(name for name, (_, own) in _TYPES.items() if own == kind)


def numpy_type(name: str) -> np.dtype:
    """Type of one value on the wire."""
    return np.dtype(_ARRAY_TYPES[name][0])
