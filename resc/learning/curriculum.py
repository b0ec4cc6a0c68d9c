"""The curricula of a run: told what was flown, they set the difficulty of what is flown next."""

from collections.abc import Sequence

import torch
from tensordict import TensorDict
from torch import Tensor

from resc import keys
from resc.envs.quadrotor import QuadrotorEnv
from resc.envs.stages import Stages
from resc.envs.trial import watched
from resc.errors import ConfigError, nearest
from resc.keys import NestedKey
from resc.term import Curriculum


class Curricula:
    """Runs the curricula after every batch and hands their difficulties to the environment.

    Args:
        terms: One for each difficulty that something in the environment reads.
        env: Their reader.

    Raises:
        ConfigError: A difficulty is written that nothing reads, or read that nothing writes, or a
            curriculum gives what is no difficulty.
    """

    def __init__(self, terms: Sequence[Curriculum], env: QuadrotorEnv) -> None:
        read = env.stages.difficulties
        terms = [term for term in terms if term.name in read or not term.optional]
        _check_difficulties([term.name for term in terms], env.stages)
        self.terms = terms
        self.env = env
        self.memory: dict[str, dict[NestedKey, Tensor]] = {
            term.name: {key: torch.full((1, 1), value) for key, value in term.initial.items()}
            for term in terms
        }
        with torch.no_grad(), watched(terms, batch=1):
            for share, count in ((0.0, 0), (0.5, 3), (1.0, 3)):
                for term in terms:
                    self._next(term, share, torch.ones(count, 1), torch.ones(count, 1).bool())
        self._publish()

    @property
    def difficulties(self) -> dict[str, float]:
        """The present difficulties, by name."""
        return {name: float(m[keys.CURRICULUM_DIFFICULTY]) for name, m in self.memory.items()}

    @property
    def active(self) -> tuple[str, ...]:
        """Names of the difficulties that are not full from beginning to end."""
        return tuple(term.name for term in self.terms if tuple(term.levels) != (1.0,))

    def advance(self, share: float, episodes: TensorDict | None) -> None:
        """Runs every curriculum once.

        Args:
            share: Of the run's environment steps, trained on so far.
            episodes: Those finished in the last batch [e]: `success` and, under `difficulties`, the
                difficulty of each name that they were flown at.
        """
        for term in self.terms:
            flown_at, succeeded = torch.zeros(0, 1), torch.zeros(0, 1, dtype=torch.bool)
            if episodes is not None:
                flown_at = episodes["difficulties", term.name].unsqueeze(-1)
                succeeded = episodes["success"].unsqueeze(-1)
            self.memory[term.name] = self._next(term, share, flown_at, succeeded)
        self._publish()

    def figures(self) -> dict[str, float]:
        """The difficulties to log: those that are not full from beginning to end."""
        values = self.difficulties
        return {f"difficulty/{name}": values[name] for name in self.active}

    def state(self) -> dict[str, dict[str, Tensor]]:
        """For a checkpoint."""
        return {
            name: {"/".join(key): value for key, value in memory.items()}
            for name, memory in self.memory.items()
        }

    def load_state(self, state: dict[str, dict[str, Tensor]]) -> None:
        """Takes a checkpoint's state."""
        self.memory = {
            name: {tuple(key.split("/")): value.cpu() for key, value in memory.items()}
            for name, memory in state.items()
        }
        self._publish()

    def _next(
        self, term: Curriculum, share: float, flown_at: Tensor, succeeded: Tensor
    ) -> dict[NestedKey, Tensor]:
        """What a curriculum remembers after these episodes [e, 1]."""
        memory = self.memory[term.name]
        tensors = memory | {
            keys.TRAINED_SHARE: torch.full((1, 1), share),
            keys.EPISODE_DIFFICULTY: flown_at,
            keys.EPISODE_SUCCESS: succeeded,
        }
        term.run(tensors)
        value = tensors[keys.CURRICULUM_DIFFICULTY]
        tensors[keys.CURRICULUM_DIFFICULTY] = value.clamp(0, 1)
        return {key: tensors[key] for key in memory}

    def _publish(self) -> None:
        for name, value in self.difficulties.items():
            self.env.set_difficulty(name, value)


def _check_difficulties(written: Sequence[str], stages: Stages) -> None:
    """What is written must be read, and what is read, written."""
    read = stages.difficulties
    for name in written:
        if name not in read:
            raise ConfigError(
                f"curriculum.{name} writes the difficulty '{name}', which nothing reads; drop it "
                f"(~curriculum.{name}) or name it where it should act, e.g. "
                f"scene.difficulty={name}.{nearest(name, read)}"
            )
    for path, name in stages.eased.items():
        if name not in written:
            raise ConfigError(
                f"{path}.difficulty is '{name}', which no curriculum writes; add curriculum.{name} "
                f"or set {path}.difficulty=null.{nearest(name, written)}"
            )
