"""The whole batch behind the interface of Stable-Baselines3 (the extra `benchmark`)."""

from collections.abc import Sequence
from typing import Any, NoReturn

import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices

from resc.envs.gymnasium_vector import QuadrotorVectorEnv
from resc.errors import CallError, ConfigError


class QuadrotorVecEnv(VecEnv):
    """What Stable-Baselines3 trains on: one step of all environments, and none of Python for each.

    The `info` of an episode's last step holds `terminal_observation`, `TimeLimit.truncated`,
    `outcome` and `is_success`. The environments are one batch, so they have one seed, and none of
    them has attributes of its own.

    Args:
        envs: The batch, in `AutoresetMode.SAME_STEP`, such as `gymnasium.make_vec("resc/Flight-v0",
            num_envs=1024, autoreset_mode="SameStep")`.
    """

    def __init__(self, envs: QuadrotorVectorEnv) -> None:
        if envs.autoreset_mode is not AutoresetMode.SAME_STEP:
            raise ConfigError(
                f"autoreset_mode is {envs.autoreset_mode.value}, but Stable-Baselines3 begins "
                "episodes in the step that ends one; make the environments with "
                "autoreset_mode='SameStep'."
            )
        self.envs = envs
        self._actions = np.zeros(0)
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)

    def reset(self) -> np.ndarray:
        """Begins episodes in all rows; `seed` and `set_options` are for the next reset."""
        observations, _ = self.envs.reset(seed=self._seeds[0], options=self._options[0] or None)
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        """Takes the actions [n, a] of a step."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Makes the step: observations, rewards, whether an episode ended, an info each."""
        observations, rewards, terminated, truncated, info = self.envs.step(self._actions)
        ended = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for row in np.flatnonzero(ended).tolist():
            last = info["final_info"]
            infos[row] = {
                "terminal_observation": info["final_obs"][row],
                "TimeLimit.truncated": bool(truncated[row]),
                "outcome": last["outcome"][row],
                "is_success": bool(last["is_success"][row]),
            }
        return observations, rewards, ended, infos

    def get_images(self) -> Sequence[np.ndarray]:
        """A picture of each environment as it is now."""
        return self.envs.render() or ()

    def close(self) -> None:
        """There is nothing to be closed."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """An attribute of the batch, once for each of the rows."""
        return [getattr(self.envs, attr_name) for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: VecEnvIndices = None) -> list[bool]:
        """False for each of the rows."""
        return [False for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: object, indices: VecEnvIndices = None) -> NoReturn:
        """Refused."""
        raise _one_batch(f"{attr_name} cannot be set")

    def env_method(
        self, method_name: str, *args: object, indices: VecEnvIndices = None, **kwargs: object
    ) -> NoReturn:
        """Refused."""
        raise _one_batch(f"{method_name} cannot be called")


def _one_batch(what: str) -> CallError:
    return CallError(
        f"{what} in one environment: all are one batch; use its attribute envs.env, which has "
        "set_difficulty and renew."
    )
