"""One quadrotor behind Gymnasium's interface, for libraries that speak it."""

from collections.abc import Collection, Mapping
from typing import Any, Protocol, runtime_checkable

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from resc.envs.quadrotor import QuadrotorEnv
from resc.envs.torchrl_face import require_untransformed
from resc.errors import CallError, ConfigError, nearest

RENDER_MODE = "rgb_array"
"""The only one."""
METADATA: dict[str, Any] = {"render_modes": [RENDER_MODE], "render_fps": 50}


@runtime_checkable
class Camera(Protocol):
    """What draws the environments; it looks at each step, so that it knows their trails."""

    def look(self) -> None:
        """Notes where the vehicles are, after every reset and step."""

    def frame(self, row: int) -> UInt8[np.ndarray, "h w 3"]:
        """A picture of one environment as it is now."""
        ...


class QuadrotorGymEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """The Gymnasium face of a `QuadrotorEnv` of one environment: same task, same numbers.

    Actions are in [-1, 1], observations unbounded. The `info` of an episode's last step says how it
    ended: `outcome` is a name, `is_success` whether it is that of a success. For speed use
    `QuadrotorVectorEnv`: a step of one environment costs nearly as much as a step of a hundred.

    Args:
        env: The environment behind it, such as `resc.make_env(num_envs=1)`.
        camera: What draws it, if anything does.
    """

    metadata = METADATA

    def __init__(self, env: QuadrotorEnv, camera: Camera | None = None) -> None:
        require_untransformed(env)
        require_single(env.num_envs)
        self.env = env
        self.camera = camera
        self.render_mode = RENDER_MODE if camera else None
        self.metadata = metadata_of(env)
        self.action_space, self.observation_space = spaces_of(env)
        self._row = torch.zeros(1, dtype=torch.int64)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begins an episode; a seed restarts every random sequence, and there are no options."""
        require_options(options, ())
        super().reset(seed=seed)
        if seed is not None:
            self.env.set_seed(seed)
        observation = self.env.restart(self._row)
        if self.camera:
            self.camera.look()
        return array_of(observation)[0], {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """One control step: observation, reward, terminated, truncated, info."""
        out = self.env.advance(batch_of(action, self.env).unsqueeze(0))
        terminated, truncated = bool(out.terminated), bool(out.truncated)
        info = {}
        if terminated or truncated:
            outcome = int(out.outcome)
            info = {"outcome": self.env.stages.outcomes[outcome], "is_success": outcome == 0}
        if self.camera:
            self.camera.look()
        return array_of(out.observation)[0], float(out.reward), terminated, truncated, info

    def render(self) -> UInt8[np.ndarray, "h w 3"] | None:  # pyright: ignore[reportIncompatibleMethodOverride] - no list of frames
        """A picture of now, if there is a camera."""
        return self.camera.frame(0) if self.camera else None


def require_single(num_envs: object) -> None:
    """Raises ConfigError for more environments than one."""
    if num_envs != 1:
        raise ConfigError(
            f"num_envs is {num_envs}; Gymnasium's interface of one environment is for num_envs=1: "
            "gymnasium.make_vec makes more."
        )


def spaces_of(env: QuadrotorEnv) -> tuple[Box, Box]:
    """Of the actions and of the observations of one environment."""
    return (
        Box(-1.0, 1.0, (env.stages.terms.action.width,), np.float32),
        Box(-np.inf, np.inf, (env.observation_width,), np.float32),
    )


def metadata_of(env: QuadrotorEnv) -> dict[str, Any]:
    """What Gymnasium's wrappers ask for: how it can be drawn, and how fast in real time."""
    return METADATA | {"render_fps": round(1 / env.stages.context.dt_s)}


def require_options(options: Mapping[str, Any] | None, known: Collection[str]) -> None:
    """Raises CallError for an option of reset that nothing reads."""
    if idle := [name for name in options or {} if name not in known]:
        raise CallError(f"reset has no option {idle[0]!r}.{nearest(str(idle[0]), known)}")


def batch_of(action: object, env: QuadrotorEnv) -> Tensor:
    """Actions as a tensor of its own that `env` takes, whatever array or type of number they are.

    Raises:
        CallError: They are no numbers.
    """
    try:
        return torch.as_tensor(action, dtype=torch.float32, device=env.device).clone()
    except (TypeError, ValueError, RuntimeError) as error:
        raise CallError(f"The action is no array of numbers ({error}).") from None


def array_of(
    batch: Float[Tensor, "n ..."] | Bool[Tensor, "n ..."],
) -> Float[np.ndarray, "n ..."] | Bool[np.ndarray, "n ..."]:
    """A copy, so that the caller may write to it."""
    return batch.cpu().numpy().copy()
