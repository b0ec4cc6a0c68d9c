"""Recorded episodes to learn from, in a replay buffer of TorchRL."""

from pathlib import Path

from torchrl.data import LazyMemmapStorage, LazyTensorStorage, TensorDictReplayBuffer

from resc.envs.stages import Stages
from resc.flying.transitions import transitions
from resc.recording.selection import Selection


def replay_buffer(
    episodes: Selection,
    *,
    batch_size: int,
    stages: Stages | None = None,
    scratch_dir: Path | None = None,
) -> TensorDictReplayBuffer:
    """A buffer of all transitions of recorded episodes, for TorchRL's losses.

    Args:
        episodes: `RolloutLog(...).where(...)`.
        batch_size: Of `sample()`.
        stages: See `transitions`.
        scratch_dir: Where to keep the transitions; in memory if None.
    """
    data = transitions(episodes, stages=stages)
    storage = (
        LazyTensorStorage(len(data))
        if scratch_dir is None
        else LazyMemmapStorage(len(data), scratch_dir=scratch_dir)
    )
    buffer = TensorDictReplayBuffer(storage=storage, batch_size=batch_size)
    buffer.extend(data)
    return buffer
