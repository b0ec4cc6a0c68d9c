"""Protobuf messages to and from numpy, whole batches at a time.

A packed repeated field of fixed width is a tag, a length and a little-endian array. With fixed-width headers the messages of
one batch differ only in the bytes of these arrays and of the environment number, so N messages are one `[N, size]` byte
matrix: a template row, overwritten by strided copies.
"""

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Shaped, UInt8
from torch import Tensor

from resc.recording.schema import Column, Leaf, Tree, column_tree

_LENGTH_DELIMITED = 2
_HEADER = np.dtype([
    ("tag_1", "u1"), ("env_id", "<u4"), ("tag_2", "u1"), ("batch", "<u4"), ("tag_3", "u1"), ("start_step", "<u8")
])  # fmt: skip
_HEADER_TAGS = {"tag_1": 0x0D, "tag_2": 0x15, "tag_3": 0x19}

EPISODE = np.dtype([
    ("tag_1", "u1"), ("env_id", "<u4"), ("tag_2", "u1"), ("episode", "<u4"),
    ("tag_3", "u1"), ("start_step", "<u8"), ("tag_4", "u1"), ("end_step", "<u8"),
    ("tag_5", "u1"), ("length", "<u4"), ("tag_6", "u1"), ("scene", "<u4"),
    ("tag_7", "u1"), ("return_", "<f4"), ("tag_8", "u1"), ("success", "?"),
])  # fmt: skip
"""One `resc.Episode` message without its last field, the outcome."""
EPISODE_KEYS = tuple(name for name in EPISODE.names or () if not name.startswith("tag_"))
_EPISODE_TAGS = (0x0D, 0x15, 0x19, 0x21, 0x2D, 0x35, 0x3D, 0x40)
_OUTCOME_FIELD = 9

_WORLD_FIELDS = {torch.float32: 3, torch.bool: 4, torch.int32: 5, torch.uint32: 6}
_WORLD_DTYPES = {3: np.dtype("<f4"), 4: np.dtype("?"), 5: np.dtype("<i4"), 6: np.dtype("<u4")}


def varint(value: int) -> bytes:
    """Base-128 encoding of a non-negative integer."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def _read_varint(data: bytes, position: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[position]
        position += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, position
        shift += 7


def _delimited(number: int, payload: bytes) -> bytes:
    return varint(number << 3 | _LENGTH_DELIMITED) + varint(len(payload)) + payload


def _fields(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Length-delimited and 8-byte fields of a message, as (number, payload)."""
    position = 0
    while position < len(data):
        tag, position = _read_varint(data, position)
        length = 8
        if tag & 7 == _LENGTH_DELIMITED:
            length, position = _read_varint(data, position)
        yield tag >> 3, data[position : position + length]
        position += length


@dataclass(frozen=True)
class Layout:
    """The bytes all fragments of a batch share, and where in them each component's array begins."""

    template: UInt8[np.ndarray, " size"]
    offsets: tuple[tuple[Leaf, int], ...]
    steps: int


@lru_cache(maxsize=64)
def fragment_layout(columns: tuple[Column, ...], steps: int) -> Layout:
    """Layout of the fragments of a batch that is `steps` long."""
    header = np.zeros(1, _HEADER)
    for name, tag in _HEADER_TAGS.items():
        header[name] = tag
    body, offsets = _tree_layout(column_tree(columns), columns, steps, first=len(_HEADER_TAGS) + 1)
    template = np.frombuffer(header.tobytes() + body, np.uint8)
    return Layout(template, tuple((leaf, _HEADER.itemsize + offset) for leaf, offset in offsets), steps)


def _tree_layout(
    tree: Tree, columns: Sequence[Column], steps: int, first: int = 1
) -> tuple[bytes, list[tuple[Leaf, int]]]:
    out, offsets = b"", []
    for number, (_, child) in enumerate(tree.items(), first):
        if isinstance(child, Leaf):
            payload, inner = bytes(steps * columns[child.column].numpy_dtype.itemsize), [(child, 0)]
        else:
            payload, inner = _tree_layout(child, columns, steps)
        out += _delimited(number, payload)
        offsets += [(leaf, len(out) - len(payload) + offset) for leaf, offset in inner]
    return out, offsets


@dataclass(frozen=True)
class Rows:
    """Equally long messages at equal distances in a buffer."""

    buffer: bytes | np.ndarray
    first: int
    stride: int
    size: int
    count: int

    def view(self, dtype: np.dtype, offset: int = 0, values: int = 1) -> Shaped[np.ndarray, "n values"]:
        """The array at `offset` of each message; no copy."""
        return np.ndarray(
            (self.count, values), dtype, self.buffer, self.first + offset, (self.stride, dtype.itemsize)
        )

    def message(self, index: int) -> bytes:
        """The bytes of one message."""
        start = self.first + index * self.stride
        return bytes(self.buffer[start : start + self.size])


def encode_fragments(
    columns: tuple[Column, ...], arrays: Sequence[Shaped[np.ndarray, "t n c"]], batch: int, start_step: int
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
    data = memoryview(matrix).cast("B")
    return [data[i : i + size] for i in range(0, len(data), size)]


def fragment_steps(columns: tuple[Column, ...], message: bytes) -> int:
    """Steps in a fragment, from the length of its first array."""
    position, node = _HEADER.itemsize, column_tree(columns)
    while True:
        _, position = _read_varint(message, position)
        length, position = _read_varint(message, position)
        node = next(iter(node.values()))
        if isinstance(node, Leaf):
            return length // columns[node.column].numpy_dtype.itemsize


def fragment_headers(rows: Rows) -> Shaped[np.ndarray, " n"]:
    """Structured array with `env_id`, `batch` and `start_step` of each fragment."""
    return rows.view(_HEADER)[:, 0]


def decode_fragments(
    columns: tuple[Column, ...], layout: Layout, rows: Rows, out: Sequence[Shaped[np.ndarray, "t n c"]]
) -> None:
    """Copy the values of some fragments into one array for each column."""
    for (column, component), offset in layout.offsets:
        dtype = columns[column].numpy_dtype
        raw = rows.view(np.dtype(np.uint8), offset, layout.steps * dtype.itemsize)
        # Fields lie at odd addresses; moving the bytes to even ones first makes the transposition twice as fast.
        out[column][:, :, component] = np.ascontiguousarray(raw).view(dtype).T


def encode_episodes(
    values: Mapping[str, np.ndarray], outcome: np.ndarray, outcomes: Sequence[str]
) -> list[bytes]:
    """One `resc.Episode` for each entry of the arrays."""
    records = np.zeros(len(outcome), EPISODE)
    for number, (name, tag) in enumerate(zip(EPISODE_KEYS, _EPISODE_TAGS, strict=True), 1):
        records[f"tag_{number}"], records[name] = tag, values[name]
    endings = [_delimited(_OUTCOME_FIELD, name.encode()) for name in outcomes]
    return [record.tobytes() + endings[code] for record, code in zip(records, outcome, strict=True)]


def decode_episodes(messages: Sequence[bytes]) -> tuple[np.ndarray, list[str]]:
    """Structured array of type `EPISODE`, and the outcome of each episode."""
    records = np.frombuffer(b"".join(message[: EPISODE.itemsize] for message in messages), EPISODE)
    endings = [_read_varint(message, EPISODE.itemsize + 1)[1] for message in messages]
    return records, [message[start:].decode() for message, start in zip(messages, endings, strict=True)]


def encode_world(arrays: Mapping[str, Tensor], start_step: int) -> bytes:
    """One `resc.World`: named arrays of any shape."""
    out = bytes([0x09]) + struct.pack("<Q", start_step)
    for name, tensor in arrays.items():
        array = tensor.numpy()
        shape = struct.pack(f"<{array.ndim}I", *array.shape)
        body = _delimited(1, name.encode()) + _delimited(2, shape)
        out += _delimited(2, body + _delimited(_WORLD_FIELDS[tensor.dtype], array.tobytes()))
    return out


def decode_world(message: bytes) -> tuple[int, dict[str, Tensor]]:
    """Start step and arrays of one `resc.World`."""
    start_step, arrays = 0, {}
    for number, payload in _fields(message):
        if number == 1:
            (start_step,) = struct.unpack("<Q", payload)
            continue
        parts = dict(_fields(payload))
        kind = next(field for field in parts if field in _WORLD_DTYPES)
        shape = struct.unpack(f"<{len(parts[2]) // 4}I", parts[2])
        values = np.ndarray(shape, _WORLD_DTYPES[kind], parts[kind]).copy()
        arrays[parts[1].decode()] = torch.from_numpy(values)
    return start_step, arrays


def round_mantissa(values: np.ndarray, bits: int) -> None:
    """Round float32 values in place to `bits` stored mantissa bits, ties to even.

    Relative error <= 2^-(bits + 1). Infinities, NaN and values of 1.7e38 and above, which could overflow, stay as they are.
    """
    raw = values.view(np.uint32)
    drop = 23 - bits
    rounded = (raw + ((raw >> drop) & 1) + np.uint32((1 << (drop - 1)) - 1)) & np.uint32(0xFFFFFFFF << drop & 0xFFFFFFFF)
    np.copyto(raw, rounded, where=(raw & 0x7F800000) < 0x7F000000)
