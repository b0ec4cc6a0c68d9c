"""The finished episodes of a recording, and where their steps are."""

from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import groupby

import numpy as np
import polars as pl
from jaxtyping import Int, Shaped

from resc.errors import RecordingError
from resc.recording.decode import SPAN, Batch, ranges, read_spans, spans_of
from resc.recording.schema import Column
from resc.recording.source import Source
from resc.recording.tables import episode_table


class Listing:
    """Episodes by number, in the order recorded.

    Args:
        sources: The files of a recording.
        batches: Their batches.
        outcomes: Names that `outcome` may take.
    """

    def __init__(
        self, sources: Sequence[Source], batches: Sequence[Batch], outcomes: Sequence[str]
    ) -> None:
        self._sources, self._batches, self._outcomes = sources, batches, outcomes

    @cached_property
    def table(self) -> pl.DataFrame:
        """One a row, with `complete`: whether all its steps are in these files."""
        found = self.spans["upper"] - self.spans["lower"]
        steps = np.bincount(self.spans["episode"], found, minlength=len(self._listed))
        complete = steps == self._listed["length"].to_numpy()
        listed = self._listed.drop("run", "first_env")
        return listed.with_columns(complete=pl.Series(complete, dtype=pl.Boolean))

    @cached_property
    def runs(self) -> list[str]:
        """The run that each episode is of."""
        return self._listed["run"].to_list()

    @cached_property
    def spans(self) -> Shaped[np.ndarray, " s"]:
        """Where the recorded steps of the episodes are: `decode.SPAN`, by episode, then by time."""
        columns = ("index", "env_id", "start_step", "end_step")
        episodes = {name: self._listed[name].to_numpy() for name in columns}
        owners, found = np.array(self.runs, object), []
        for run in dict.fromkeys(self.runs):
            numbers = [i for i, batch in enumerate(self._batches) if batch.source.run == run]
            numbers.sort(key=lambda number: self._batches[number].start_step)
            own = {name: values[owners == run] for name, values in episodes.items()}
            found.append(spans_of(self._batches, np.array(numbers, np.int64), own))
        spans = np.concatenate([np.empty(0, SPAN), *found])
        return spans[np.argsort(spans["episode"], kind="stable")]

    def by_run(self, numbers: Sequence[int]) -> Iterator[tuple[list[Source], pl.DataFrame]]:
        """Consecutive episodes of one run and rank, with its files, as these number them."""
        for number in numbers:
            require_index(number, len(self.table), "episode", "episodes")
        firsts = self._listed["first_env"].to_list()
        for (run, first), group in groupby(numbers, lambda n: (self.runs[n], firsts[n])):
            of_run = (source for source in self._sources if source.run == run)
            sources = [source for source in of_run if source.first_env == first]
            yield sources, self.table[list(group)].with_columns(pl.col("env_id") - first)

    def steps_of(
        self, numbers: Int[np.ndarray, " e"]
    ) -> tuple[Shaped[np.ndarray, " rows"], Int[np.ndarray, " e"]]:
        """The steps of some episodes one after the other, as records, and how many each has."""
        counts = self.table["length"].to_numpy()[numbers]
        partial = numbers[~self.table["complete"].to_numpy()[numbers]]
        if len(partial):
            raise RecordingError(
                f"Some steps of {len(partial)} of these {len(numbers)} episodes, such as "
                f"{partial[0]}, are not recorded in these files; leave them out with "
                "where(complete=True), or read what there is with env()."
            )
        firsts = np.searchsorted(self.spans["episode"], [numbers, numbers + 1])
        pieces = firsts[1] - firsts[0]
        rows = np.repeat(firsts[0], pieces) + ranges(pieces)
        return read_spans(self._columns, self._batches, self.spans[rows]), counts

    def about(self, numbers: Sequence[int]) -> dict[str, Int[np.ndarray, " rows"]]:
        """What the rows of a table of steps say of themselves: those of some batches.

        `tables.STEP_COLUMNS`, one environment after the other; -1 where no episode is listed.
        """
        found, num_envs = [self._batches[number] for number in numbers], self.num_envs
        lengths = np.array([batch.steps for batch in found], np.int64)
        starts = np.array([batch.start_step for batch in found], np.int64)
        steps = np.repeat(starts, lengths) + ranges(lengths)
        offsets = np.full(len(self._batches), -1)
        offsets[list(numbers)] = np.cumsum(lengths) - lengths
        spans = self.spans[offsets[self.spans["batch"]] >= 0]
        first = spans["env_id"] * len(steps) + offsets[spans["batch"]] + spans["lower"]
        counts = spans["upper"] - spans["lower"]
        index = np.full(num_envs * len(steps), -1)
        index[np.repeat(first, counts) + ranges(counts)] = np.repeat(spans["episode"], counts)
        # Steps of no episode have index -1, the last entry.
        episode = np.append(self._listed["episode"].to_numpy(), -1)
        return {
            "index": index,
            "env_id": np.repeat(np.arange(num_envs), len(steps)),
            "episode": episode[index],
            "step": np.tile(steps, num_envs),
        }

    @cached_property
    def _listed(self) -> pl.DataFrame:
        return episode_table(self._sources, self._outcomes)

    @property
    def _columns(self) -> tuple[Column, ...]:
        return self._sources[0].specification.columns

    @property
    def num_envs(self) -> int:
        """Environments in every batch."""
        own = self._sources[0].specification.num_envs
        return own + max(source.first_env for source in self._sources)


def require_index(index: int, count: int, what: str, plural: str) -> None:
    """Refuses a number that counts nothing recorded; a negative one does not count from the end.

    Raises:
        RecordingError: It is below 0, not below `count`, or no whole number.
    """
    if isinstance(index, bool) or not hasattr(index, "__index__") or not 0 <= index < count:
        last = f"the last is {count - 1}" if count else "there is none"
        raise RecordingError(
            f"There is no {what} {index}; the recording holds {count} {plural}, counted from 0: "
            f"{last}."
        )
