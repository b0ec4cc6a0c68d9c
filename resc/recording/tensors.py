"""What is read as tensors: apart, because importing torch takes longer than most commands do."""

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from jaxtyping import Shaped
from tensordict import TensorDict
from torch import Tensor

from resc.recording.schema import Column


def to_tensordict(columns: tuple[Column, ...], records: Shaped[np.ndarray, "..."]) -> TensorDict:
    """Records with the recorded keys and shapes."""
    result = TensorDict({}, batch_size=records.shape)
    for i, column in enumerate(columns):
        result[column.key] = as_tensor(column, records[str(i)].copy())
    return result


def of_environments(
    columns: tuple[Column, ...], arrays: Sequence[Shaped[np.ndarray, "t n _"]]
) -> TensorDict:
    """One array for each column with the recorded keys and shapes, `[T, N]`."""
    result = TensorDict({}, batch_size=arrays[0].shape[:2])
    for column, array in zip(columns, arrays, strict=True):
        result[column.key] = as_tensor(column, array)
    return result


def as_tensor(column: Column, values: Shaped[np.ndarray, "*shape _"]) -> Tensor:
    """The values of a column with their recorded shape."""
    return torch.from_numpy(values).reshape(*values.shape[:-1], *(column.shape or ()))


def tensors_of(arrays: Mapping[str, Shaped[np.ndarray, "..."]]) -> dict[str, Tensor]:
    """Named arrays as tensors that share their memory."""
    return {name: torch.from_numpy(values) for name, values in arrays.items()}
