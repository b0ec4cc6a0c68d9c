"""What the collector hands over: checked, and copied to private host memory."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from torch import Tensor

from resc.errors import RecordingError
from resc.recording.schema import ARRAY_FIELDS, EPISODE_KEYS, type_name
from resc.recording.specification import Specification

Leaves = dict[tuple[str, ...], Tensor]


def column_leaves(batch: TensorDictBase, specification: Specification, num_envs: int) -> Leaves:
    """The recorded leaves of a batch `[T, N]`, of the recorded environments."""
    shape = list(batch.batch_size)
    if len(shape) != 2 or shape[0] == 0 or shape[1] != num_envs:
        raise RecordingError(
            f"The batch has the shape {shape}; expected [T, {num_envs}], time first and not empty."
        )
    leaves: Leaves = {}
    for column in specification.columns:
        leaf = batch.get(column.key, None)
        if leaf is None:
            raise RecordingError(
                f"The batch has no {column.key}; put it there or drop it from the columns."
            )
        found, expected = (leaf.dtype, tuple(leaf.shape[2:])), (column.dtype, column.shape)
        if found != expected:
            raise RecordingError(
                f"{column.key} is {found[0]} {found[1]} in the batch and {expected[0]} "
                f"{expected[1]} in the columns; make them agree."
            )
        leaves[column.key] = leaf[:, : specification.num_envs]
    return leaves


def episode_leaves(episodes: TensorDictBase) -> Leaves:
    """The recorded leaves of the finished episodes `[E]`."""
    leaves: Leaves = {(name,): episodes.get(name, None) for name in EPISODE_KEYS}
    for (name,), leaf in leaves.items():
        if leaf is None:
            expected = ", ".join(EPISODE_KEYS)
            raise RecordingError(f"The episodes have no '{name}'; expected {expected}.")
    return leaves


def array_leaves(arrays: Mapping[str, Tensor], what: str) -> Leaves:
    """Named arrays as leaves, of the types that a message can hold."""
    for name, tensor in arrays.items():
        if type_name(tensor.dtype) not in ARRAY_FIELDS:
            raise RecordingError(
                f"{what} array '{name}' has dtype {tensor.dtype}; "
                f"convert it to one of {', '.join(ARRAY_FIELDS)}."
            )
    return {(name,): tensor for name, tensor in arrays.items()}


def rows_of_recorded(leaves: Leaves, specification: Specification, num_envs: int) -> Leaves:
    """The rows of recorded environments; nothing where there are none."""
    if leaves and specification.num_envs < num_envs:
        rows = leaves[("env_id",)] < specification.num_envs
        leaves = {key: leaf[rows.to(leaf.device)] for key, leaf in leaves.items()}
    return leaves if leaves and len(leaves[("env_id",)]) > 0 else {}


@dataclass(frozen=True)
class HostBatch:
    """Private host copies of one batch; complete after `wait()`."""

    number: int
    start_step: int
    time_ns: int
    rollout: Leaves
    episodes: Leaves
    tables: dict[str, Leaves]
    wait: Callable[[], None]


def host_batch(
    number: int, start_step: int, rollout: Leaves, episodes: Leaves, tables: Mapping[str, Leaves]
) -> HostBatch:
    """Copies of the leaves of a batch, of its episodes and of arrays by topic; any may be empty."""
    (rollout, wait_rollout), (episodes, wait_episodes) = to_host(rollout), to_host(episodes)
    found = {topic: to_host(leaves) for topic, leaves in tables.items() if leaves}

    def wait() -> None:
        for waits in (wait_rollout, wait_episodes, *(waits for _, waits in found.values())):
            waits()

    arrays = {topic: leaves for topic, (leaves, _) in found.items()}
    return HostBatch(number, start_step, time.time_ns(), rollout, episodes, arrays, wait)


def to_host(leaves: Mapping[tuple[str, ...], Tensor]) -> tuple[Leaves, Callable[[], None]]:
    """Private copies, and a function that waits for them; GPU tensors come by pinned memory.

    The collector may overwrite its tensors at once: on a GPU the copies are queued before its next
    kernels, on the stream that is current here.
    """
    host: Leaves = {}
    for key, leaf in leaves.items():
        host[key] = torch.empty_like(leaf, device="cpu", pin_memory=leaf.is_cuda)
        host[key].copy_(leaf.detach(), non_blocking=leaf.is_cuda)
    devices = {leaf.device for leaf in leaves.values() if leaf.is_cuda}
    events = [torch.cuda.current_stream(device).record_event() for device in devices]

    def wait() -> None:
        for event in events:
            event.synchronize()

    return host, wait
