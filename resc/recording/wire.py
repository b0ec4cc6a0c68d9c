"""Fragments, the protobuf messages of `/rollout`, to and from numpy: whole batches at a time.

A packed repeated field of fixed width is a tag, a length and a little-endian array. With
fixed-width headers the messages of one batch differ only in the bytes of these arrays and of the
environment number, so N messages are one `[N, size]` byte matrix: a template row, overwritten by
strided copies.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from google.protobuf.descriptor_pb2 import FieldDescriptorProto
from jaxtyping import Float, Shaped, UInt8

from resc.recording.schema import FIELDS, ROLLOUT, Column, Leaf, Tree, column_tree

_Field = FieldDescriptorProto
_LENGTH_DELIMITED = 2
_FIXED_WIDTH: dict[int, tuple[int, str]] = {
    _Field.TYPE_FIXED32: (5, "<u4"),
    _Field.TYPE_FIXED64: (1, "<u8"),
    _Field.TYPE_FLOAT: (5, "<f4"),
    _Field.TYPE_BOOL: (0, "?"),
}


def fixed_fields(topic: str, count: int) -> Shaped[np.ndarray, " count"]:
    """The fixed-width fields that a topic's messages begin with, tags in place and values zero."""
    fields = [(name, *_FIXED_WIDTH[k]) for name, k in FIELDS[topic].items() if k in _FIXED_WIDTH]
    dtype = [item for name, _, kind in fields for item in ((f"{name}.tag", "u1"), (name, kind))]
    records = np.zeros(count, dtype)
    for number, (name, wire_type, _) in enumerate(fields, 1):
        records[f"{name}.tag"] = number << 3 | wire_type
    return records


_HEADER = fixed_fields(ROLLOUT, 0).dtype


def varint(value: int) -> bytes:
    """Base-128 encoding of a non-negative integer."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def read_varint(data: bytes, position: int) -> tuple[int, int]:
    """The integer at a position, and the position after it."""
    value = shift = 0
    while True:
        byte = data[position]
        position += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, position
        shift += 7


def delimited(number: int, payload: bytes) -> bytes:
    """A length-delimited field: a string, a message or a packed array."""
    return varint(number << 3 | _LENGTH_DELIMITED) + varint(len(payload)) + payload


@dataclass(frozen=True)
class Layout:
    """The bytes all fragments of a batch share, and where in them each component's array begins."""

    template: UInt8[np.ndarray, " size"]
    offsets: tuple[tuple[Leaf, int], ...]
    steps: int


@lru_cache(maxsize=64)
def fragment_layout(columns: tuple[Column, ...], steps: int) -> Layout:
    """Layout of the fragments of a batch that is `steps` long."""
    header = fixed_fields(ROLLOUT, 1).tobytes()
    first = len(FIELDS[ROLLOUT]) + 1
    body, offsets = _tree_layout(column_tree(columns), columns, steps, first)
    template = np.frombuffer(header + body, np.uint8)
    return Layout(template, tuple((leaf, len(header) + at) for leaf, at in offsets), steps)


def _tree_layout(
    tree: Tree, columns: Sequence[Column], steps: int, first: int = 1
) -> tuple[bytes, list[tuple[Leaf, int]]]:
    out, offsets = b"", []
    for number, child in enumerate(tree.values(), first):
        if isinstance(child, Leaf):
            payload, inner = bytes(steps * columns[child.column].numpy_dtype.itemsize), [(child, 0)]
        else:
            payload, inner = _tree_layout(child, columns, steps)
        out += delimited(number, payload)
        offsets += [(leaf, len(out) - len(payload) + at) for leaf, at in inner]
    return out, offsets


@dataclass(frozen=True)
class Rows:
    """Equally long messages at equal distances in a buffer."""

    buffer: bytes | np.ndarray
    first: int
    stride: int
    size: int
    count: int

    def view(
        self, dtype: np.dtype, offset: int = 0, values: int = 1
    ) -> Shaped[np.ndarray, "n values"]:
        """The array at `offset` of each message; no copy."""
        return np.ndarray(
            (self.count, values),
            dtype,
            self.buffer,
            self.first + offset,
            (self.stride, dtype.itemsize),
        )

    def message(self, index: int) -> bytes:
        """The bytes of one message."""
        start = self.first + index * self.stride
        return bytes(self.buffer[start : start + self.size])

    def part(self, start: int, stop: int) -> "Rows":
        """Messages `start` up to `stop`."""
        return replace(self, first=self.first + start * self.stride, count=stop - start)


def encode_fragments(
    columns: tuple[Column, ...],
    arrays: Sequence[Shaped[np.ndarray, "t n _"]],
    batch: int,
    start_step: int,
) -> list[memoryview]:
    """One `resc.RolloutFragment` for each environment, from one array for each column."""
    steps, num_envs, _ = arrays[0].shape
    layout = fragment_layout(columns, steps)
    size = len(layout.template)
    matrix = np.empty((num_envs, size), np.uint8)
    matrix[:] = layout.template
    rows = Rows(matrix, 0, size, size, num_envs)
    header = rows.view(_HEADER)[:, 0]
    header["env_id"], header["batch"], header["start_step"] = np.arange(num_envs), batch, start_step
    for (column, component), offset in layout.offsets:
        rows.view(columns[column].numpy_dtype, offset, steps)[:] = arrays[column][:, :, component].T
    data = matrix.data.cast("B")
    return [data[i : i + size] for i in range(0, len(data), size)]


def headers(rows: Rows) -> Shaped[np.ndarray, " n"]:
    """Structured array with `env_id`, `batch` and `start_step` of each fragment."""
    return rows.view(_HEADER)[:, 0]


def place_of(message: bytes) -> tuple[int, int]:
    """Start step and environment of a fragment.

    Raises:
        ValueError: It does not begin as a fragment does.
    """
    header = _header(message)
    return int(header["start_step"]), int(header["env_id"])


def batch_of(message: bytes) -> int:
    """The number of a fragment's batch, from 0 in each recorder.

    Raises:
        ValueError: It does not begin as a fragment does.
    """
    return int(_header(message)["batch"])


def _header(message: bytes) -> np.void:
    header = np.frombuffer(message, _HEADER, 1)[0]
    expected = fixed_fields(ROLLOUT, 1)[0]
    if any(header[name] != expected[name] for name in _HEADER.names or () if name.endswith(".tag")):
        raise ValueError("not a fragment")
    return header


def with_copies(
    layout: Layout, stored: Sequence[Column], read: Sequence[tuple[Column, Column]]
) -> Layout:
    """A layout of `stored` columns for arrays of others: pairs of a column and where it is from."""
    numbers = {column: number for number, column in enumerate(stored)}
    offsets = dict(layout.offsets)
    found = [
        (Leaf(number, j), offsets[Leaf(numbers[origin], j)])
        for number, (_, origin) in enumerate(read)
        for j in range(origin.width)
    ]
    return replace(layout, offsets=tuple(found))


def decode_fragments(
    columns: tuple[Column, ...],
    layout: Layout,
    rows: Rows,
    out: Sequence[Shaped[np.ndarray, "t n _"]],
) -> None:
    """Copy the first steps of some fragments, as many as `out` has, into arrays, one a column."""
    for (column, component), offset in layout.offsets:
        dtype = columns[column].numpy_dtype
        raw = rows.view(np.dtype(np.uint8), offset, len(out[column]) * dtype.itemsize)
        # Fields lie at odd addresses; moved to even ones, they transpose in half the time.
        out[column][:, :, component] = np.ascontiguousarray(raw).view(dtype).T


def round_mantissa(values: Float[np.ndarray, "..."], bits: int) -> None:
    """Round float32 values in place to `bits` stored mantissa bits, ties to even.

    Relative error <= 2^-(bits + 1). Infinities, NaN and values of 1.7e38 and above, which could
    overflow, stay as they are; subnormal values keep an absolute error of 2^-(bits + 127).
    """
    raw = values.view(np.uint32)
    drop = 23 - bits
    half, kept = np.uint32((1 << drop - 1) - 1), np.uint32((1 << 32) - (1 << drop))
    rounded = (raw + (raw >> drop & 1) + half) & kept
    np.copyto(raw, rounded, where=(raw & 0x7F800000) < 0x7F000000)
