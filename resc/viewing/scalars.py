"""Named numbers, one message a step: protobuf schemas and messages built at run time."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from jaxtyping import Float

from resc.recording.wire import delimited, varint

_FIXED32 = 5

Numbers = Mapping[str, Any]
"""Names to one value for each step, or to numbers of their own."""


def scalar_schema(name: str, numbers: Numbers) -> bytes:
    """Serialised `FileDescriptorSet` of the message `resc.<name>`."""
    message = DescriptorProto(name=name)
    _describe(message, numbers, f".resc.{name}")
    file = FileDescriptorProto(
        name=f"resc/{name.lower()}.proto", package="resc", syntax="proto3", message_type=[message]
    )
    return FileDescriptorSet(file=[file]).SerializeToString()


def encode_scalars(numbers: Numbers) -> list[bytes]:
    """One message for each step."""
    template, places = _layout(numbers)
    steps = len(places[0][0])
    matrix = np.tile(np.frombuffer(template, np.uint8), (steps, 1))
    for values, at in places:
        matrix[:, at : at + 4] = values.astype("<f4")[:, None].view(np.uint8)
    return [row.tobytes() for row in matrix]


def _describe(message: DescriptorProto, numbers: Numbers, scope: str) -> None:
    for number, (name, child) in enumerate(numbers.items(), 1):
        # json_name: without it tools print camelCase names.
        field = message.field.add(name=name, json_name=name, number=number)
        field.label = FieldDescriptorProto.LABEL_OPTIONAL
        if isinstance(child, Mapping):
            nested = message.nested_type.add(name=name[0].upper() + name[1:])
            field.type = FieldDescriptorProto.TYPE_MESSAGE
            field.type_name = f"{scope}.{nested.name}"
            _describe(nested, child, field.type_name)
        else:
            field.type = FieldDescriptorProto.TYPE_FLOAT


def _layout(numbers: Numbers) -> tuple[bytes, list[tuple[Float[np.ndarray, " t"], int]]]:
    """The bytes that all messages share, and where in them the value of each array goes."""
    out, places = b"", []
    for number, child in enumerate(numbers.values(), 1):
        if isinstance(child, Mapping):
            payload, inner = _layout(child)
            out += delimited(number, payload)
            places += [(values, len(out) - len(payload) + at) for values, at in inner]
        else:
            out += varint(number << 3 | _FIXED32)
            places.append((child, len(out)))
            out += bytes(4)
    return out, places
