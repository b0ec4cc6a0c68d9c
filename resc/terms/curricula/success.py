"""As hard as the policy can take."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.quantities import Count
from resc.term import Curriculum

EPISODES = ("curriculum", "episodes")
SUCCESSES = ("curriculum", "successes")
SAME = 1e-4
"""Difficulties closer than this are one and the same, float32 considered."""


class Success(Curriculum):
    """Difficulty that rises a level where the policy succeeds, and falls one where it fails.

    Counts episodes begun at the present difficulty; those begun before a change say nothing about
    it. Once `episodes` of them are finished, d rises by 1 / (levels - 1) if more than `raise_above`
    of them succeeded, falls by as much if fewer than `lower_below` did, and counting restarts.

    Args:
        episodes: Finished episodes, at least, that one decision rests on.
        raise_above: Success rate above which the difficulty rises.
        lower_below: Success rate below which it falls.
        levels: Difficulties from 0 to 1, also those that scenes are laid out at.
        first: Difficulty at the start of training: one of the levels.
    """

    reads = (
        keys.CURRICULUM_DIFFICULTY,
        EPISODES,
        SUCCESSES,
        keys.EPISODE_DIFFICULTY,
        keys.EPISODE_SUCCESS,
    )
    writes = (keys.CURRICULUM_DIFFICULTY, EPISODES, SUCCESSES)

    def __init__(
        self,
        *,
        episodes: int = 1000,
        raise_above: float = 0.8,
        lower_below: float = 0.4,
        levels: Count = 4,
        first: float = 0.0,
    ) -> None:
        super().__init__()
        if episodes < 1 or levels < 2:
            raise ConfigError(
                f"episodes is {episodes}, levels {levels}; expected at least 1 and 2."
            )
        if not 0 <= lower_below < raise_above <= 1:
            raise ConfigError(
                f"lower_below is {lower_below}, raise_above {raise_above}; expected "
                "0 <= lower_below < raise_above <= 1."
            )
        self.levels = [i / (levels - 1) for i in range(levels)]
        if min(abs(first - level) for level in self.levels) > SAME:
            raise ConfigError(f"first is {first}; expected one of the {levels} levels from 0 to 1.")
        self.episodes = episodes
        self.raise_above = raise_above
        self.lower_below = lower_below
        self.steps = levels - 1
        self.initial = {keys.CURRICULUM_DIFFICULTY: first, EPISODES: 0.0, SUCCESSES: 0.0}

    def compute(
        self,
        difficulty: Float[Tensor, "1 1"],
        episodes: Float[Tensor, "1 1"],
        successes: Float[Tensor, "1 1"],
        flown_at: Float[Tensor, "e 1"],
        succeeded: Bool[Tensor, "e 1"],
    ) -> tuple[Tensor, Tensor, Tensor]:
        here = (flown_at - difficulty).abs() < SAME
        episodes = episodes + here.sum()
        successes = successes + (here & succeeded).sum()
        decided = episodes >= self.episodes
        rate = successes / episodes.clamp(min=1)
        change = (rate > self.raise_above).float() - (rate < self.lower_below).float()
        level = (difficulty * self.steps).round() + decided * change
        moved = level.clamp(0, self.steps) / self.steps
        return moved, torch.where(decided, 0.0, episodes), torch.where(decided, 0.0, successes)
