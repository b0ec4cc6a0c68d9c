"""Whether a recording is what it says: structure, checksums, counts, values, episodes."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import polars as pl
from jaxtyping import Int, Shaped

from resc.console import progress
from resc.errors import RecordingError
from resc.recording.decode import Arrays, Batch, batches, read_environments
from resc.recording.indexing import open_sources
from resc.recording.location import recordings_at
from resc.recording.reader import RolloutLog
from resc.recording.schema import ROLLOUT, Column
from resc.recording.source import Source
from resc.recording.tables import column_names

_ENDS = ("terminated", "truncated", "done")
_TOLERANCE = 1e-3
"""Of the return of an episode, summed in float32, relative to the sum of magnitudes."""


@dataclass
class Checked:
    """How much was checked, and what is wrong, one sentence each; `notes` are not faults."""

    files: int = 0
    batches: int = 0
    env_steps: int = 0
    episodes: int = 0
    faults: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def check(location: str | Path) -> Checked:
    """Reads everything in a recording; damage in one place does not keep it from the others.

    Structure: every file is complete, chunks have the right checksums, batches hold every
    environment once, and there are as many messages as the file says. Values: all numbers are
    finite. Episodes: each ends, and only it ends, in a step flagged as an end; its length and
    return are those of its steps; those of one environment do not overlap.
    """
    done, paths = Checked(), recordings_at(location)
    for path in paths:
        done.files += 1
        with _noting(done):
            _check_file(path, done)
    try:
        log = RolloutLog(location)
    except RecordingError as error:
        for path in paths:
            _check_alone(path, done)
        # What is wrong with one file is noted already; the files together may not fit.
        if not str(error).startswith(tuple(done.faults)):
            done.faults.append(str(error))
        return done
    with _noting(done):
        done.notes += [f"{part}." for part in log.superseded]
        _check_steps(log, done)
    return done


@contextmanager
def _noting(done: Checked) -> Iterator[None]:
    try:
        yield
    except RecordingError as error:
        if str(error) not in done.faults:
            done.faults.append(str(error))


def _check_alone(path: Path, done: Checked) -> None:
    """The steps of one file, whatever the others are."""
    part = Checked()
    with _noting(part):
        if open_sources(path):
            _check_steps(RolloutLog(path), part)
    done.batches += part.batches
    done.env_steps += part.env_steps
    done.episodes += part.episodes
    # The numbers of episodes count within this file.
    faults = (fault if str(path) in fault else f"{path}: {fault}" for fault in part.faults)
    done.faults += [fault for fault in faults if fault not in done.faults]


def _check_file(path: Path, done: Checked) -> None:
    sources = open_sources(path)
    if not all(source.complete for source in sources) or not sources:
        done.faults.append(
            f"{path} is not complete: it was cut, is being written, or its summary is damaged; "
            "all that can be read is, and 'recover' makes it a complete file."
        )
    if any(source.copy is not None for source in sources):
        done.notes.append(
            f"{path} was written again by another program: it is read slowly; 'recover' makes it a "
            "file like RESC's own."
        )
    for source in sources:
        done.faults += [f"{sentence}." for sentence in source.lacking]
        _check_source(source, done)


def _check_source(source: Source, done: Checked) -> None:
    path = source.path
    source.attachments()
    counts = {}
    for topic in source.topics:
        if topic == ROLLOUT:
            counts[topic] = len(batches(source)) * source.specification.num_envs
            continue
        with _noting(done):
            counts[topic] = len(list(source.messages(topic)))
    if source.complete and source.counts is not None:
        said = {topic: source.counts.get(n, 0) for topic, n in source.topics.items()}
        done.faults += [
            f"{path} says it holds {said.get(topic, 0)} messages of {topic} and holds {count}; "
            "recover it."
            for topic, count in counts.items()
            if said.get(topic, 0) != count
        ]


def _check_steps(log: RolloutLog, done: Checked) -> None:
    table = log.episodes
    done.episodes = len(table)
    done.faults += _listing_faults(log)
    last = {source.path: i for i, b in enumerate(log.batches) for source in b.sources}
    returns = _Returns(log)
    with progress(log.num_steps * log.num_envs, unit="step", unit_scale=True) as bar:
        for i, batch in enumerate(log.batches):
            spans = log.listing.spans[log.listing.spans["batch"] == i]
            with _noting(done):
                arrays = read_environments(log.columns, [batch], 0, log.num_envs - 1)
                done.faults += _value_faults(log.columns, batch, arrays)
                open_ones = [s for s in batch.sources if s.limit is None and not s.complete]
                growing = batch.steps == batch.recorded and any(
                    last[s.path] == i for s in open_ones
                )
                ends = table["end_step"].to_numpy()[spans["episode"]]
                done.faults += _end_faults(log.columns, batch, arrays, spans, ends, growing)
                returns.add(arrays, spans)
                done.batches += 1
                done.env_steps += batch.steps * log.num_envs
            bar.update(batch.steps * log.num_envs)
    done.faults += returns.faults(table)


def _listing_faults(log: RolloutLog) -> Iterator[str]:
    """What the table of episodes says of itself."""
    table = log.episodes.with_columns(run=pl.Series(log.listing.runs, dtype=pl.String))
    length = pl.col("end_step") - pl.col("start_step") + 1
    rows = {
        "has another length than its first and last step say": length != pl.col("length"),
        "is of an environment that does not exist": pl.col("env_id") >= log.num_envs,
        "has a return that is not finite": ~pl.col("return_").is_finite(),
        "begins before the one before it in its environment ends": pl.col("start_step")
        <= pl.col("end_step").shift(1).over("run", "env_id", order_by="start_step"),
    }
    for what, wrong in rows.items():
        found = table.filter(wrong)["index"].to_list()
        if found:
            yield f"Episode {found[0]} {what}{_others(len(found))}."


def _value_faults(columns: Sequence[Column], batch: Batch, arrays: Arrays) -> Iterator[str]:
    """Numbers that are not finite, column by column."""
    for name, i, j in column_names(columns):
        values = arrays[i][:, :, j]
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            wrong = np.argwhere(~np.isfinite(values))
            step, env_id = wrong[0].tolist()
            yield (
                f"{batch.source.path}: {name} of environment {env_id} is {values[step, env_id]} in "
                f"step {batch.start_step + step}{_others(len(wrong))}."
            )


def _end_faults(
    columns: Sequence[Column],
    batch: Batch,
    arrays: Arrays,
    spans: Shaped[np.ndarray, " s"],
    end_steps: Int[np.ndarray, " s"],
    growing: bool,
) -> Iterator[str]:
    """Steps flagged as ends where no episode ends, and the other way round."""
    flags = [a[:, :, 0] for c, a in zip(columns, arrays, strict=True) if _is(c, *_ENDS)]
    if not flags:
        return
    flagged = np.any(flags, axis=0)
    listed = np.zeros_like(flagged)
    ending = spans[batch.start_step + spans["upper"] - 1 == end_steps]
    listed[ending["upper"] - 1, ending["env_id"]] = True
    # The episodes of a batch are written after it, and may be what is missing of a file.
    cases = [(listed & ~flagged, "an episode ends that is not flagged as ended")]
    if not growing:
        cases.append((flagged & ~listed, "an end is flagged and no episode listed"))
    for wrong, what in cases:
        found = np.argwhere(wrong)
        if len(found):
            step, env_id = found[0].tolist()
            yield (
                f"{batch.source.path}: in step {batch.start_step + step} of environment {env_id} "
                f"{what}{_others(len(found))}."
            )


class _Returns:
    """Sums the rewards of every episode over the batches."""

    def __init__(self, log: RolloutLog) -> None:
        self.column = next((i for i, c in enumerate(log.columns) if _is(c, "reward")), None)
        self.sums, self.magnitudes = np.zeros(len(log)), np.zeros(len(log))
        self.steps = np.zeros(len(log), np.int64)
        # A mean of rounded rewards may lie half a unit of the last place off.
        bits = log.round_bits
        self.tolerance = _TOLERANCE if bits is None else max(_TOLERANCE, 2.0 ** -(bits + 1))

    def add(self, arrays: Arrays, spans: Shaped[np.ndarray, " s"]) -> None:
        """Adds the rewards of one batch."""
        if self.column is None:
            return
        rewards = arrays[self.column][:, :, 0].astype(np.float64)
        for values, sums in ((rewards, self.sums), (np.abs(rewards), self.magnitudes)):
            until = np.concatenate([np.zeros_like(values[:1]), values.cumsum(0)])
            upper, lower = (until[spans[side], spans["env_id"]] for side in ("upper", "lower"))
            np.add.at(sums, spans["episode"], upper - lower)
        np.add.at(self.steps, spans["episode"], spans["upper"] - spans["lower"])

    def faults(self, table: pl.DataFrame) -> Iterator[str]:
        """Episodes whose return is not the sum of their rewards; only those wholly read."""
        listed = table["return_"].to_numpy()
        whole = self.steps == table["length"].to_numpy()
        off = np.abs(self.sums - listed) > self.tolerance * (1 + self.magnitudes)
        found = np.flatnonzero(whole & off).tolist()
        if found:
            yield (
                f"Episode {found[0]} lists a return of {listed[found[0]]:g}, and its rewards sum "
                f"to {self.sums[found[0]]:g}{_others(len(found))}."
            )


def _is(column: Column, *names: str) -> bool:
    """Whether a column is one of these, of the step or of TorchRL's `next`."""
    return column.key[-1] in names and column.key[:-1] in ((), ("next",))


def _others(count: int) -> str:
    return f" ({count - 1} more like this)" if count > 1 else ""
