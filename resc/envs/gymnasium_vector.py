"""The whole batch behind Gymnasium's interface for vectors of environments."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from resc.envs.gymnasium_env import (
    RENDER_MODE,
    Camera,
    array_of,
    batch_of,
    metadata_of,
    require_options,
    spaces_of,
)
from resc.envs.quadrotor import QuadrotorEnv
from resc.envs.stages import StepOutput
from resc.envs.torchrl_face import require_untransformed
from resc.errors import CallError, ConfigError

MASK = "reset_mask"
Answer = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]


class QuadrotorVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """The Gymnasium face of a `QuadrotorEnv`: a step of all environments at once.

    One seed is that of the whole batch. Where an episode ends, `info` says how, by `outcome` and
    `is_success` with their masks; in `AutoresetMode.SAME_STEP`, where the returned observation is
    of the next episode already, they are in `final_info`, and `final_obs` is the last observation.

    Args:
        env: The environment behind it, such as `resc.make_env(num_envs=1024)`.
        autoreset_mode: What begins the next episode: the step after an episode's last one, which
            leaves out that row's action, this last step itself, or the caller, by
            `reset(options={"reset_mask": ended})`.
        camera: What draws it, if anything does.
    """

    def __init__(
        self,
        env: QuadrotorEnv,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        camera: Camera | None = None,
    ) -> None:
        require_untransformed(env)
        self.env = env
        self.num_envs = env.num_envs
        self.camera = camera
        self.render_mode = RENDER_MODE if camera else None
        self.autoreset_mode = mode_of(autoreset_mode)
        self.metadata = metadata_of(env) | {"autoreset_mode": self.autoreset_mode}
        self.single_action_space, self.single_observation_space = spaces_of(env)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._ended = np.zeros(self.num_envs, bool)
        self._outcomes = np.array(env.stages.outcomes, object)
        self._begun = False

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begins episodes in all rows, or in those of the option `reset_mask`, bool [n].

        A seed restarts every random sequence of the batch.
        """
        require_options(options, (MASK,))
        mask = self._mask(options)
        if not isinstance(seed, int | None):
            raise CallError(f"seed is {seed!r}; the whole batch has one, a whole number.")
        super().reset(seed=seed)
        if seed is not None:
            self.env.set_seed(seed)
        observation = self.env.restart(_rows(mask))
        self._begun, self._ended = True, self._ended & ~mask
        self._look()
        return array_of(observation), {}

    def step(self, actions: np.ndarray) -> Answer:
        """One control step: observations, rewards, terminated, truncated [n, ...], info."""
        begin = {
            AutoresetMode.NEXT_STEP: self._step_or_begin,
            AutoresetMode.SAME_STEP: self._step_and_begin,
            AutoresetMode.DISABLED: self._step_only,
        }
        answer = begin[self.autoreset_mode](batch_of(actions, self.env))
        self._look()
        return answer

    def render(self) -> tuple[UInt8[np.ndarray, "h w 3"], ...] | None:
        """A picture of each environment as it is now, if there is a camera."""
        if not self.camera:
            return None
        return tuple(self.camera.frame(row) for row in range(self.num_envs))

    def _step_or_begin(self, action: Float[Tensor, "n a"]) -> Answer:
        """Rows that ended in the last step begin; the others fly on."""
        begin, rows = self._ended, _rows(self._ended)
        if len(rows):
            action[rows] = 0.0  # it may be anything
        out = self.env.advance(action)
        observation, (reward, terminated, truncated) = out.observation, _columns(out)
        if len(rows):
            observation = self.env.restart(rows)
            reward[begin], terminated[begin], truncated[begin] = 0.0, False, False
        self._ended = terminated | truncated
        info = self._endings(self._ended, out.outcome)
        return array_of(observation), reward, terminated, truncated, info

    def _step_and_begin(self, action: Float[Tensor, "n a"]) -> Answer:
        """Rows that end begin at once."""
        out = self.env.advance(action)
        reward, terminated, truncated = _columns(out)
        ended = terminated | truncated
        if not ended.any():
            return array_of(out.observation), reward, terminated, truncated, {}
        rows = _rows(ended)
        last = np.full(self.num_envs, None, object)
        for row, seen in zip(rows.tolist(), out.observation[rows].cpu().numpy(), strict=True):
            last[row] = seen
        info = {
            "final_obs": last,
            "_final_obs": ended,
            "final_info": self._endings(ended, out.outcome),
            "_final_info": ended.copy(),
        }
        return array_of(self.env.restart(rows)), reward, terminated, truncated, info

    def _step_only(self, action: Float[Tensor, "n a"]) -> Answer:
        """Rows that ended must have been begun by the caller."""
        if self._ended.any():
            raise CallError(
                f"The episodes of environments {np.flatnonzero(self._ended).tolist()} have ended; "
                f"begin new ones with reset(options={{'{MASK}': terminated | truncated}})."
            )
        out = self.env.advance(action)
        reward, terminated, truncated = _columns(out)
        self._ended = terminated | truncated
        info = self._endings(self._ended, out.outcome)
        return array_of(out.observation), reward, terminated, truncated, info

    def _endings(
        self, ended: Bool[np.ndarray, " n"], outcome: Int[Tensor, "n 1"]
    ) -> dict[str, Any]:
        """How episodes ended, for the rows that did."""
        if not ended.any():
            return {}
        numbers = outcome[:, 0].cpu().numpy()
        names = np.full(self.num_envs, None, object)
        names[ended] = self._outcomes[numbers[ended]]
        return {
            "outcome": names,
            "_outcome": ended.copy(),
            "is_success": ended & (numbers == 0),
            "_is_success": ended.copy(),
        }

    def _mask(self, options: Mapping[str, Any] | None) -> Bool[np.ndarray, " n"]:
        """The rows to be begun: all, unless the options name some."""
        if MASK not in (options or {}):
            return np.ones(self.num_envs, bool)
        assert options is not None
        mask = options[MASK]
        shaped = isinstance(mask, np.ndarray) and mask.dtype == bool
        if not shaped or mask.shape != (self.num_envs,) or not mask.any():
            raise CallError(
                f"{MASK} is {mask!r}; expected an array of bool with {self.num_envs} entries, one "
                "of them True at least, such as terminated | truncated."
            )
        if not self._begun:
            raise CallError(f"{MASK} is for later; the first reset is of all environments.")
        return mask

    def _look(self) -> None:
        if self.camera:
            self.camera.look()


def mode_of(given: object) -> AutoresetMode:
    """An autoreset mode, also by its name.

    Raises:
        ConfigError: There is no such mode.
    """
    try:
        return AutoresetMode(given)
    except ValueError:
        names = ", ".join(mode.value for mode in AutoresetMode)
        raise ConfigError(f"autoreset_mode is {given!r}; expected one of {names}.") from None


def _rows(mask: Bool[np.ndarray, " n"]) -> Int[Tensor, " k"]:
    return torch.from_numpy(np.flatnonzero(mask))


def _columns(
    out: StepOutput,
) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Reward, terminated and truncated, for the caller to keep."""
    parts = (out.reward, out.terminated, out.truncated)
    reward, terminated, truncated = (array_of(part)[:, 0] for part in parts)
    return reward, terminated, truncated
