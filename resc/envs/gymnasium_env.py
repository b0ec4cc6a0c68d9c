"""One quadrotor behind Gymnasium's interface, for libraries that speak it."""

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box

from resc.envs.quadrotor import QuadrotorEnv, require_untransformed
from resc.errors import ConfigError


class QuadrotorGymEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """The Gymnasium face of a `QuadrotorEnv` of one environment: same task, same numbers.

    Actions are in [-1, 1], observations unbounded. `info["outcome"]` of an episode's last step
    names how it ended. For speed use `QuadrotorEnv`: a step of one environment costs nearly as
    much as a step of a hundred.

    Args:
        env: The environment behind it, such as `resc.make_env(num_envs=1)`.
    """

    def __init__(self, env: QuadrotorEnv) -> None:
        require_untransformed(env)
        if env.num_envs != 1:
            raise ConfigError(
                f"num_envs is {env.num_envs}; Gymnasium's interface is for num_envs=1."
            )
        self.env = env
        self.action_space = Box(-1.0, 1.0, (env.stages.terms.action.width,), np.float32)
        self.observation_space = Box(-np.inf, np.inf, (env.observation_width,), np.float32)
        self._row = torch.zeros(1, dtype=torch.int64)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begins an episode; a seed restarts every random sequence."""
        super().reset(seed=seed)
        if seed is not None:
            self.env.set_seed(seed)
        return _first_row(self.env.restart(self._row)), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """One control step: observation, reward, terminated, truncated, info."""
        batch = torch.as_tensor(action, dtype=torch.float32, device=self.env.device).unsqueeze(0)
        out = self.env.advance(batch)
        terminated, truncated = bool(out.terminated), bool(out.truncated)
        info = {}
        if terminated or truncated:
            info["outcome"] = self.env.stages.outcomes[int(out.outcome)]
        return _first_row(out.observation), float(out.reward), terminated, truncated, info


def _first_row(batch: torch.Tensor) -> np.ndarray:
    """A copy, so that the caller may write to it."""
    return batch[0].cpu().numpy().copy()
