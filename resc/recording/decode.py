"""Fragments to TensorDicts."""

from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
import torch
from jaxtyping import Shaped
from tensordict import TensorDict

from resc.errors import RecordingError
from resc.recording import wire
from resc.recording.schema import ROLLOUT, Column
from resc.recording.source import ChunkRef, Source

Arrays = list[Shaped[np.ndarray, "t n _"]]
"""One array for each column."""


@dataclass(frozen=True)
class Batch:
    """One collector batch: the chunks that hold its fragments, in the order of the environments."""

    source: Source
    start_step: int
    chunks: tuple[ChunkRef, ...]

    @property
    def session(self) -> str:
        """The recorder that wrote it."""
        return self.source.specification.session

    def arrays(self, first: int, last: int) -> Arrays:
        """The values of environments `first` to `last`, from only the chunks that hold them."""
        columns = self.source.specification.columns
        origin = self.start_step * self.source.specification.dt_ns
        layout, out = None, []
        for chunk in self.chunks:
            if chunk.end_time - origin < first or chunk.start_time - origin > last:
                continue
            for rows in self.source.rows(chunk, ROLLOUT):
                if layout is None:
                    layout = self._layout(rows)
                    shape = (layout.steps, last + 1 - first)
                    out = [np.empty((*shape, c.width), c.numpy_dtype) for c in columns]
                selected, place = _select(rows, first, last)
                wire.decode_fragments(columns, layout, selected, [array[:, place] for array in out])
        return out

    def _layout(self, rows: wire.Rows) -> wire.Layout:
        columns = self.source.specification.columns
        layout = wire.fragment_layout(columns, wire.fragment_steps(columns, rows.message(0)))
        if len(layout.template) != rows.size:
            raise RecordingError(
                f"{self.source.path} holds a fragment of {rows.size} bytes where its columns need "
                f"{len(layout.template)}; it was rewritten, read the original."
            )
        return layout


def batches(source: Source) -> list[Batch]:
    """The batches of a file whose fragments are all there."""
    dt_ns, num_envs = source.specification.dt_ns, source.specification.num_envs
    found = []
    chunks = source.chunks_of(ROLLOUT)
    for start_step, group in groupby(chunks, lambda chunk: chunk.start_time // dt_ns):
        batch = Batch(source, start_step, tuple(group))
        if batch.chunks[-1].end_time - start_step * dt_ns == num_envs - 1:
            found.append(batch)
        elif source.complete:
            raise RecordingError(
                f"{source.path} was rearranged by another program; read the file that RESC wrote."
            )
    return found


def join(columns: tuple[Column, ...], num_envs: int, parts: list[Arrays]) -> TensorDict:
    """Batches one after the other, with the recorded keys and shapes; empties `parts`."""
    steps = sum(len(part[0]) for part in parts)
    result = TensorDict({}, batch_size=[steps, num_envs])
    for column in columns:
        # Taking the pieces out frees them: two copies of everything never coexist.
        pieces = [part.pop(0) for part in parts]
        empty = np.empty((0, num_envs, column.width), column.numpy_dtype)
        values = pieces[0] if len(pieces) == 1 else np.concatenate([empty, *pieces])
        shape = (steps, num_envs, *(column.shape or ()))
        result[column.key] = torch.from_numpy(values).reshape(shape)
    return result


def _select(rows: wire.Rows, first: int, last: int) -> tuple[wire.Rows, slice]:
    """The fragments of environments `first` to `last` among rows, and their place in the output."""
    found = int(wire.fragment_headers(rows)["env_id"][0])
    skip = max(first - found, 0)
    count = max(min(rows.count - skip, last + 1 - found - skip), 0)
    place = max(found - first, 0)
    chosen = replace(rows, first=rows.first + skip * rows.stride, count=count)
    return chosen, slice(place, place + count)
