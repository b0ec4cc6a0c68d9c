"""How episodes end: counted batch by batch, and listed for the recorder."""

from collections import deque

import torch
from tensordict import TensorDict
from torch import Tensor

from resc.envs.stages import StepOutput

WINDOW = 2000
"""Finished episodes that the running rates look back on."""


class EpisodeStatistics:
    """Return, length and outcome of every finished episode.

    Args:
        num_envs: Batch size.
        outcomes: Their names, by number; the first is success.
        device: Of the environment.
    """

    def __init__(self, num_envs: int, outcomes: tuple[str, ...], device: torch.device) -> None:
        self.outcomes = outcomes
        self.returns = torch.zeros(num_envs, device=device)
        self.lengths = torch.zeros(num_envs, dtype=torch.int64, device=device)
        self.numbers = torch.zeros(num_envs, dtype=torch.int64, device=device)
        self.recent: deque[tuple[int, float, int]] = deque(maxlen=WINDOW)
        self.total = 0
        self.finished: list[TensorDict] = []
        self.start_step = 0

    def begin_batch(self, start_step: int) -> None:
        """Forgets the episodes listed so far; `start_step` is the first step of the batch."""
        self.finished = []
        self.start_step = start_step

    def step(self, t: int, out: StepOutput, scene: Tensor) -> None:
        """Counts one control step."""
        self.returns += out.reward[:, 0]
        self.lengths += 1
        self.scene = scene
        rows = out.done[:, 0].nonzero()[:, 0]
        if len(rows):
            self._finish(t, rows, out.outcome[rows, 0])

    def cut(self, t: int, rows: Tensor, outcome: str) -> None:
        """Counts episodes that were ended from outside."""
        if len(rows):
            self._finish(t, rows, torch.full_like(rows, self.outcomes.index(outcome)))

    def episodes(self) -> TensorDict | None:
        """The episodes that finished in this batch [e], for the recorder."""
        if not self.finished:
            return None
        # torch.cat is annotated for tensors alone; tensordict makes it take its own.
        return torch.cat(self.finished)  # pyright: ignore[reportArgumentType, reportReturnType]

    def rates(self) -> dict[str, float]:
        """Share of each outcome, mean return and length over the last finished episodes.

        Episodes cut from outside are excluded.
        """
        rows = [row for row in self.recent if row[0] < len(self.outcomes) - 1]
        if not rows:
            return {}
        codes, returns, lengths = (
            torch.tensor(column, dtype=torch.float64) for column in zip(*rows, strict=True)
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

    def state(self) -> dict[str, Tensor | int | list[tuple[int, float, int]]]:
        """For a checkpoint."""
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
        self.recent = deque((tuple(row) for row in state["recent"]), maxlen=WINDOW)
        self.total = state["total"]

    def _finish(self, t: int, rows: Tensor, codes: Tensor) -> None:
        end = self.start_step + t
        lengths, returns = self.lengths[rows], self.returns[rows]
        self.recent.extend(zip(codes.tolist(), returns.tolist(), lengths.tolist(), strict=True))
        self.total += len(rows)
        self.finished.append(
            TensorDict(
                {
                    "env_id": rows,
                    "episode": self.numbers[rows],
                    "start_step": end - lengths + 1,
                    "end_step": torch.full_like(rows, end),
                    "length": lengths,
                    "return_": returns,
                    "outcome": codes,
                    "scene": self.scene[rows, 0],
                },
                batch_size=[len(rows)],
            ).cpu()
        )
        self.numbers[rows] += 1
        self.returns[rows] = 0
        self.lengths[rows] = 0
