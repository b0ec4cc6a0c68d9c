"""The rare messages, one at a time: finished episodes, the scenes in use, worlds at starts."""

import struct
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Shaped

from resc.errors import RecordingError
from resc.recording.schema import ARRAY_FIELDS, EPISODE_KEYS, EPISODES, numpy_type, type_name
from resc.recording.wire import delimited, fixed_fields, read_varint

_OUTCOME = len(EPISODE_KEYS)
FLOATS = ("return_", "difficulty")
_ARRAYS, _NAME, _SHAPE = 2, 1, 2
_VALUES = {name: number for number, name in enumerate(ARRAY_FIELDS, 3)}

Named = Mapping[str, Shaped[np.ndarray, "..."]]
"""Arrays of a message by name."""


def encode_episodes(
    values: Mapping[str, Shaped[np.ndarray, " e"]], outcomes: Sequence[str], dt_ns: int
) -> list[tuple[int, int, bytes]]:
    """(log time, environment, `resc.Episode`) of each entry; its time is that of its last step."""
    for name, numbers in values.items():
        limit = len(outcomes) if name == "outcome" else 2**32
        if name not in FLOATS and (numbers.min() < 0 or numbers.max() >= limit):
            raise RecordingError(
                f"The '{name}' of an episode lies in [{numbers.min()}, {numbers.max()}]; expected "
                f"0 to {limit - 1} (outcome counts the names that the recorder got as 'outcomes')."
            )
    records = fixed_fields(EPISODES, len(values["outcome"]))
    for name in EPISODE_KEYS[:-1]:
        records[name] = values[name]
    endings = [delimited(_OUTCOME, name.encode()) for name in outcomes]
    times = records["end_step"].astype(np.int64) * dt_ns + records["env_id"]
    data = [r.tobytes() + endings[code] for r, code in zip(records, values["outcome"], strict=True)]
    return list(zip(times.tolist(), records["env_id"].tolist(), data, strict=True))


def decode_episodes(messages: Sequence[bytes]) -> tuple[dict[str, np.ndarray], list[str]]:
    """The fixed-width fields of some episodes, one array each, and their outcomes."""
    dtype = fixed_fields(EPISODES, 0).dtype
    records = np.frombuffer(b"".join(message[: dtype.itemsize] for message in messages), dtype)
    outcomes = []
    for message in messages:
        _, start = read_varint(message, dtype.itemsize + 1)  # a tag of one byte, then the length
        outcomes.append(message[start:].decode())
    return {name: records[name] for name in EPISODE_KEYS[:-1]}, outcomes


def encode_arrays(topic: str, arrays: Named, start_step: int) -> bytes:
    """One `resc.World` or `resc.Starts`: named arrays of any shape."""
    head = fixed_fields(topic, 1)
    head["start_step"] = start_step
    out = [head.tobytes()]
    for name, array in arrays.items():
        shape = struct.pack(f"<{array.ndim}I", *array.shape)
        values = delimited(_VALUES[type_name(array.dtype)], array.tobytes())
        body = delimited(_NAME, name.encode()) + delimited(_SHAPE, shape) + values
        out.append(delimited(_ARRAYS, body))
    return b"".join(out)


def decode_arrays(topic: str, message: bytes) -> tuple[int, dict[str, Shaped[np.ndarray, "..."]]]:
    """Start step and arrays of one `resc.World` or `resc.Starts`."""
    head = fixed_fields(topic, 0).dtype
    start_step = int(np.frombuffer(message, head, 1)["start_step"][0])
    arrays = {}
    for _, body in _delimited_fields(message, head.itemsize):
        parts = dict(_delimited_fields(body))
        kind = next(kind for kind, number in _VALUES.items() if number in parts)
        shape = struct.unpack(f"<{len(parts[_SHAPE]) // 4}I", parts[_SHAPE])
        values = np.ndarray(shape, numpy_type(kind), parts[_VALUES[kind]])
        arrays[parts[_NAME].decode()] = values.copy()
    return start_step, arrays


def before(limit: int | None, arrays: Named) -> Named:
    """Of the arrays of a message those of episodes that begin before a step; scenes as they are."""
    if limit is None or "step" not in arrays or (arrays["step"] < limit).all():
        return arrays
    return {name: values[arrays["step"] < limit] for name, values in arrays.items()}


def _delimited_fields(data: bytes, position: int = 0) -> Iterator[tuple[int, bytes]]:
    while position < len(data):
        tag, position = read_varint(data, position)
        length, position = read_varint(data, position)
        yield tag >> 3, data[position : position + length]
        position += length
