"""The messages of what the recorder is given: steps, episodes, starts, scenes."""

from collections.abc import Callable

import numpy as np

from resc.recording import events, wire
from resc.recording.batches import HostBatch, Leaves
from resc.recording.schema import EPISODES, ROLLOUT, WORLD
from resc.recording.segments import Segments
from resc.recording.specification import Specification


class MessageWriter:
    """Encodes batches and scenes, and appends them to the files; for one thread only.

    Args:
        segments: The files.
        specification: What is recorded of each batch.
    """

    def __init__(self, segments: Segments, specification: Specification) -> None:
        self._segments, self._specification = segments, specification
        self._scenes: dict[str, np.ndarray] = {}
        self.written = 0
        """Batches that are on the disk."""

    def write_batch(self, batch: HostBatch) -> None:
        """Appends a batch, the episodes that ended in it, and how new ones began."""
        batch.wait()
        self._segments.begin(batch.start_step)
        if batch.rollout:
            self._write_fragments(batch)
        if batch.episodes:
            messages = events.encode_episodes(
                {name: leaf.flatten().numpy() for (name,), leaf in batch.episodes.items()},
                self._specification.outcomes,
                self._specification.dt_ns,
            )
            self._segments.append(EPISODES, messages, batch.time_ns)
        for topic, leaves in batch.tables.items():
            arrays = {name: leaf.numpy() for (name,), leaf in leaves.items()}
            data = events.encode_arrays(topic, arrays, batch.start_step)
            origin = batch.start_step * self._specification.dt_ns
            self._segments.append(topic, [(origin, 0, data)], batch.time_ns)
        if batch.rollout or batch.episodes or batch.tables:
            self._segments.commit()
        self.written += bool(batch.rollout)

    def _write_fragments(self, batch: HostBatch) -> None:
        columns, bits = self._specification.columns, self._specification.round_bits
        arrays = []
        for column in columns:
            leaf = batch.rollout[column.key]
            arrays.append(leaf.reshape(*leaf.shape[:2], column.width).numpy())
            if bits is not None and arrays[-1].dtype == np.float32:
                wire.round_mantissa(arrays[-1], bits)
        fragments = wire.encode_fragments(columns, arrays, batch.number, batch.start_step)
        origin = batch.start_step * self._specification.dt_ns
        messages = [(origin + env_id, env_id, data) for env_id, data in enumerate(fragments)]
        self._segments.append(ROLLOUT, messages, batch.time_ns)

    def write_world(
        self, leaves: Leaves, wait: Callable[[], None], start_step: int, time_ns: int
    ) -> None:
        """Appends the scenes used from `start_step` on."""
        wait()
        self._segments.begin(start_step)
        arrays = {name: leaf.numpy() for (name,), leaf in leaves.items()}
        data = events.encode_arrays(WORLD, arrays, start_step)
        # Pinned first: these may be the first scenes of a file, which then holds all of them.
        self._scenes = _replaced(self._scenes, arrays)
        self._segments.pin(WORLD, lambda: events.encode_arrays(WORLD, self._scenes, start_step))
        self._segments.append(WORLD, [(start_step * self._specification.dt_ns, 0, data)], time_ns)
        self._segments.commit()


def _replaced(
    scenes: dict[str, np.ndarray], arrays: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """All scenes, after some of them were put again."""
    if "entry" not in arrays or scenes.keys() != arrays.keys():
        return arrays
    rows = np.searchsorted(scenes["entry"], arrays["entry"])
    for name, values in arrays.items():
        scenes[name][rows] = values
    return scenes
