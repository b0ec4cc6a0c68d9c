"""How episodes end: counted batch by batch, and listed for the recorder."""

from collections import deque
from collections.abc import Mapping, Sequence
from typing import cast

import torch
from tensordict import TensorDict
from torch import Tensor

from resc import ranks
from resc.envs.stages import StepOutput

RENEWED = "scene_renewed"
"""Outcome of an episode cut because its scene was renewed."""
WINDOW = 2000
"""Finished episodes that the running rates look back on."""
BINS = 5
"""Bins of difficulty, of equal width from 0 to 1."""
Row = tuple[int, float, int, tuple[float, ...]]
"""Outcome, return, length and difficulties of an episode."""


class EpisodeStatistics:
    """Return, length, outcome and difficulties of every finished episode.

    Args:
        num_envs: Batch size.
        outcomes: Their names, by number; the first is success.
        device: Of the environment.
        difficulties: Names of the difficulties that episodes are flown at.
    """

    def __init__(
        self,
        num_envs: int,
        outcomes: tuple[str, ...],
        device: torch.device,
        difficulties: Sequence[str] = (),
    ) -> None:
        self.outcomes = outcomes
        self.names = tuple(difficulties)
        self.returns = torch.zeros(num_envs, device=device)
        self.lengths = torch.zeros(num_envs, dtype=torch.int64, device=device)
        self.numbers = torch.zeros(num_envs, dtype=torch.int64, device=device)
        self.recent: deque[Row] = deque(maxlen=WINDOW)
        self.total = 0
        self._finished: list[TensorDict] = []
        self._ended: list[dict[str, Tensor]] = []  # since, still on the device
        self._of_all: list[TensorDict] | None = None
        self.start_step = 0

    def begin_batch(self, start_step: int) -> None:
        """Forgets the episodes listed so far; `start_step` is the first step of the batch."""
        self._settle()
        self._finished, self._of_all = [], None
        self.start_step = start_step

    def step(
        self,
        t: int,
        out: StepOutput,
        rows: Tensor,
        scene: Tensor,
        difficulties: Mapping[str, Tensor],
    ) -> None:
        """Counts one control step, of episodes in these scenes at these difficulties [n, 1].

        Those in `rows` [k] end with it.
        """
        self.returns += out.reward[:, 0]
        self.lengths += 1
        self.scene = scene
        self.difficulties = difficulties
        if len(rows):
            self._finish(t, rows, out.outcome[rows, 0])

    def cut(self, t: int, rows: Tensor, outcome: str) -> None:
        """Counts episodes that were ended from outside."""
        if len(rows):
            self._finish(t, rows, torch.full_like(rows, self.outcomes.index(outcome)))

    def episodes(self) -> TensorDict | None:
        """The episodes that finished in this batch [e], for the recorder."""
        self._settle()
        return _joined(self._finished)

    def exchange(self) -> None:
        """Counts what ended in this batch with the other processes of the training, too.

        `rates`, `success_by_difficulty` and `complete` are then of all of them.
        """
        if ranks.count() == 1:
            return
        own = self.episodes()
        every = ranks.gather(None if own is None else own.to_dict())
        parts = {n: TensorDict(part) for n, part in enumerate(every) if part is not None}
        self._of_all = [part.auto_batch_size_(1) for part in parts.values()]
        for number, part in parts.items():
            if number != ranks.rank():
                levels = [cast(Tensor, part["difficulties", name]) for name in self.names]
                self._count(part["outcome"], part["return_"], part["length"], levels)

    def complete(self) -> TensorDict | None:
        """As `episodes`, without those that were cut from outside, with their `success`."""
        episodes = self.episodes() if self._of_all is None else _joined(self._of_all)
        if episodes is None:
            return None
        codes = cast(Tensor, episodes["outcome"])
        complete = cast(TensorDict, episodes[codes < len(self.outcomes) - 1])
        complete["success"] = complete["outcome"] == 0
        return complete

    def begun_at(self, row: int, steps: int, flown: int) -> int:
        """First step in the run of the episode that had flown at `steps` of this batch's `flown`.

        Where one had just ended there, that one.
        """
        self._settle()
        last = self.start_step + max(steps - 1, 0)
        for part in self._finished:
            own = (
                (part["env_id"] == row) & (part["start_step"] <= last) & (part["end_step"] >= last)
            )
            if own.any():
                return int(part["start_step"][own][0])
        return self.start_step + flown - int(self.lengths[row])

    def rates(self) -> dict[str, float]:
        """Share of each outcome, mean return and length over the last finished episodes.

        Episodes cut from outside are excluded.
        """
        self._settle()
        rows = [row for row in self.recent if row[0] < len(self.outcomes) - 1]
        if not rows:
            return {}
        codes, returns, lengths = (
            torch.tensor([row[i] for row in rows], dtype=torch.float64) for i in range(3)
        )
        shares = {
            f"outcome/{name}": float((codes == i).double().mean())
            for i, name in enumerate(self.outcomes[:-1])
        }
        return {
            **shares,
            "episode/return": float(returns.mean()),
            "episode/length": float(lengths.mean()),
        }

    def success_by_difficulty(self, names: Sequence[str]) -> dict[str, float]:
        """Share of successes among the last finished episodes, by bins of the named difficulties.

        A bin without an episode is left out, and episodes cut from outside are excluded.
        """
        self._settle()
        rows = [row for row in self.recent if row[0] < len(self.outcomes) - 1]
        shares = {}
        for name in names:
            column = self.names.index(name)
            bins = [min(int(row[3][column] * BINS + 1e-4), BINS - 1) for row in rows]
            for number in sorted(set(bins)):
                codes = [row[0] for row, i in zip(rows, bins, strict=True) if i == number]
                label = f"{number / BINS:.1f}-{(number + 1) / BINS:.1f}"
                shares[f"success_by_{name}/{label}"] = codes.count(0) / len(codes)
        return shares

    def state(self) -> dict[str, Tensor | int | list[Row]]:
        """For a checkpoint."""
        self._settle()
        return {
            "returns": self.returns,
            "lengths": self.lengths,
            "numbers": self.numbers,
            "recent": list(self.recent),
            "total": self.total,
        }

    def load_state(self, state: dict) -> None:
        """Takes a checkpoint's state."""
        self.returns, self.lengths, self.numbers = (
            state["returns"],
            state["lengths"],
            state["numbers"],
        )
        self.recent = deque(state["recent"], maxlen=WINDOW)
        self.total = state["total"]

    def _finish(self, t: int, rows: Tensor, codes: Tensor) -> None:
        end = self.start_step + t
        lengths = self.lengths[rows]
        self._ended.append(
            {
                "env_id": rows,
                "episode": self.numbers[rows],
                "start_step": end - lengths + 1,
                "end_step": torch.full_like(rows, end),
                "length": lengths,
                "return_": self.returns[rows],
                "outcome": codes,
                "scene": self.scene[rows, 0],
                **{name: self.difficulties[name][rows, 0] for name in self.names},
            }
        )
        self.numbers[rows] += 1
        self.returns[rows] = 0
        self.lengths[rows] = 0

    def _settle(self) -> None:
        """Takes the episodes that ended since from the device, all at once."""
        if not self._ended:
            return
        columns = {
            name: torch.cat([part[name] for part in self._ended]).cpu() for name in self._ended[0]
        }
        self._ended = []
        count = len(columns["env_id"])
        flown_at = {name: columns.pop(name) for name in self.names}
        outcome, returned, length = (columns[name] for name in ("outcome", "return_", "length"))
        levels = self._count(outcome, returned, length, [*flown_at.values()])
        columns["difficulty"] = levels.mean(-1) if self.names else torch.ones(count)
        parts = columns | {"difficulties": TensorDict(flown_at, batch_size=[count])}
        self._finished.append(TensorDict(parts, batch_size=[count]))

    def _count(
        self, codes: Tensor, returns: Tensor, lengths: Tensor, difficulties: Sequence[Tensor]
    ) -> Tensor:
        """Adds episodes to those that rates look back on; returns their difficulties [e, names]."""
        levels = torch.stack([*difficulties], -1) if difficulties else torch.zeros(len(codes), 0)
        columns = (codes.tolist(), returns.tolist(), lengths.tolist(), map(tuple, levels.tolist()))
        self.recent.extend(zip(*columns, strict=True))
        self.total += len(codes)
        return levels


def _joined(parts: Sequence[TensorDict]) -> TensorDict | None:
    """Episodes one after the other; None where there are none."""
    if not parts:
        return None
    # torch.cat is annotated for tensors alone; tensordict makes it take its own.
    return torch.cat([*parts])  # pyright: ignore[reportArgumentType, reportReturnType]
