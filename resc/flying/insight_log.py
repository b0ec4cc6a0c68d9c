"""What vehicles came to know, for a recorder: routes as they are renewed, and maps."""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from resc import keys
from resc.envs.quadrotor import QuadrotorEnv
from resc.envs.stages import World
from resc.maps.known_map import UNKNOWN
from resc.recording.known_cells import packed

Arrays = dict[str, Tensor]
Rows = Int[Tensor, " k"]
RENEWED = 1
"""Status of a check that found a new route: the first of an episode has no other cause."""


class RouteLog:
    """Takes down every new route when it arrives; one that is as the old one is none.

    Args:
        env: What is flown, with replanning.
    """

    def __init__(self, env: QuadrotorEnv) -> None:
        self.env = env
        self.planned = torch.zeros(env.num_envs, dtype=torch.int64, device=env.device)
        self.found: list[Arrays] = []

    def begin(self, step: int, rows: Rows) -> None:
        """Episodes begin in some rows, with this step."""
        rows = rows.to(self.env.device)
        self.planned[rows] = step
        status = self.env.value_of(keys.REPLAN_STATUS)[rows, 0]
        self._note(step, rows, torch.where(status == RENEWED, 0, status))

    def step(self, step: int, before: World, flying: Bool[Tensor, "n 1"]) -> None:
        """A control step has been flown; `flying` are the episodes that go on after it."""
        after = {key: self.env.value_of(key) for key in (keys.REPLANS, keys.PENDING_STEPS)}
        planned = after[keys.REPLANS] > before[keys.REPLANS]
        self.planned = torch.where(planned[:, 0], step + 1, self.planned)
        waited = (before[keys.PENDING_STEPS] >= 0) | planned
        rows = (waited & (after[keys.PENDING_STEPS] < 0) & flying)[:, 0].nonzero()[:, 0]
        if len(rows):
            new = self.env.value_of(keys.ROUTE_W)[rows] != before[keys.ROUTE_W][rows]
            rows = rows[new.flatten(1).any(1)]
            self._note(step + 1, rows, self.env.value_of(keys.REPLAN_STATUS)[rows, 0])

    def take(self) -> Arrays:
        """The routes since the last call, in the order of arrival; nothing without any."""
        taken, self.found = self.found, []
        return _joined(taken)

    def _note(self, step: int, rows: Rows, cause: Int[Tensor, " k"]) -> None:
        if not len(rows):
            return
        self.found.append(
            {
                "env_id": rows.cpu(),
                "step": torch.full_like(rows, step).cpu(),
                "planned_step": self.planned[rows].cpu(),
                "cause": cause.long().cpu(),
                "length": self.env.value_of(keys.ROUTE_LENGTH)[rows, 0].cpu(),
                "route_w": self.env.value_of(keys.ROUTE_W)[rows].cpu(),
            }
        )


class KnownMapLog:
    """Takes down the maps that vehicles know: `rate_hz` times a second, and at the end.

    Args:
        env: What is flown, with a sensing.
        rate_hz: At most one for each control step.
    """

    def __init__(self, env: QuadrotorEnv, rate_hz: float) -> None:
        self.env = env
        self.every = max(1, round(1 / (rate_hz * env.stages.context.dt_s)))
        self.found: list[Arrays] = []

    def begin(self, step: int, rows: Rows) -> None:
        """Episodes begin in some rows, with this step."""
        self._note(step, rows)

    def step(self, step: int, flying: Bool[Tensor, "n 1"], ended: Bool[Tensor, "n 1"]) -> None:
        """A control step has been flown by those that were `flying`; some have `ended` with it."""
        due = flying if (step + 1) % self.every == 0 else ended
        self._note(step + 1, due[:, 0].nonzero()[:, 0])

    def take(self) -> Arrays:
        """The maps since the last call; nothing without any."""
        taken, self.found = self.found, []
        return _joined(taken)

    def _note(self, step: int, rows: Rows) -> None:
        if not len(rows):
            return
        rows = rows.to(self.env.device)
        seen = self.env.value_of(keys.KNOWN_EVIDENCE)[rows] != UNKNOWN
        occupied = self.env.value_of(keys.KNOWN_ESDF)[rows] <= 0
        cells = packed(seen.cpu().numpy(), occupied.cpu().numpy())
        like = torch.ones_like(rows).cpu()
        self.found.append(
            {
                "env_id": rows.cpu(),
                "step": like * step,
                "rows": like * seen.shape[1],
                "columns": like * seen.shape[2],
                "cells": torch.from_numpy(cells),
            }
        )


def _joined(parts: Sequence[Arrays]) -> Arrays:
    """Arrays one after the other."""
    return {name: torch.cat([part[name] for part in parts]) for name in (parts or [{}])[0]}
