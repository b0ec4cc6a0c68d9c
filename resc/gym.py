"""RESC for Gymnasium: `gymnasium.make("resc/Flight-v0")` and `gymnasium.make_vec`.

`import resc` registers the name.
"""

from collections.abc import Sequence

import numpy as np
import torch
from gymnasium.vector import AutoresetMode

from resc.command_line import override
from resc.door import make_env
from resc.envs.gymnasium_env import RENDER_MODE, QuadrotorGymEnv, require_single
from resc.envs.gymnasium_vector import QuadrotorVectorEnv, mode_of
from resc.envs.quadrotor import QuadrotorEnv
from resc.errors import ConfigError
from resc.viewing.top_view import TopView

LARGEST_SEED = 2**31


class Flight(QuadrotorGymEnv):
    """What `gymnasium.make("resc/Flight-v0")` makes.

    Args:
        render_mode: `rgb_array`, or None.
        overrides: Of the configuration, as `resc.make_env` takes them.
        **settings: The same as keywords: `obstacle_observation="none"`. Without `seed`, each
            environment flies other episodes until it is reset with one.
    """

    def __init__(
        self, render_mode: str | None = None, overrides: Sequence[str] = (), **settings: object
    ) -> None:
        _require_mode(render_mode)
        require_single(settings.setdefault("num_envs", 1))
        env = _made(overrides, settings)
        super().__init__(env, TopView(env) if render_mode else None)


class Flights(QuadrotorVectorEnv):
    """What `gymnasium.make_vec("resc/Flight-v0", num_envs=...)` makes.

    Args:
        num_envs: Batch size.
        autoreset_mode: Gymnasium's, or its name: `NextStep`, `SameStep` or `Disabled`.
        render_mode: As of `Flight`, with its other arguments.
        overrides: As of `Flight`.
        **settings: As of `Flight`.
    """

    def __init__(
        self,
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        overrides: Sequence[str] = (),
        **settings: object,
    ) -> None:
        _require_mode(render_mode)
        mode = mode_of(autoreset_mode)
        env = _made(overrides, {"num_envs": num_envs, **settings})
        super().__init__(env, mode, TopView(env) if render_mode else None)


def _made(overrides: Sequence[str], settings: dict[str, object]) -> QuadrotorEnv:
    """The environment, its random sequences seeded as Gymnasium does it."""
    if isinstance(overrides, str):
        raise ConfigError(f"overrides is {overrides!r}; give a list of texts, [{overrides!r}].")
    if "max_episode_steps" in settings:
        raise ConfigError(
            "max_episode_steps is for gymnasium.make; for a batch set the time limit: "
            'overrides=["termination.time_limit.limit_s=10.0"].'
        )
    env = make_env(*overrides, *(_override(name, value) for name, value in settings.items()))
    if "seed" not in settings and not any(text.startswith("seed=") for text in overrides):
        env.set_seed(int(np.random.default_rng().integers(LARGEST_SEED)))
    return env


def _override(name: str, value: object) -> str:
    """A keyword as an override."""
    if isinstance(value, torch.device):
        value = str(value)
    if isinstance(value, Sequence) and not isinstance(value, str):
        plain = all(isinstance(one, str) for one in value)
        if plain:
            return override(name, list(value))
    elif value is None or isinstance(value, str | int | float):
        return override(name, value)
    raise ConfigError(
        f"{name} is {value!r}; as a keyword, a setting is a text, a number, a truth value, None or "
        f'a list of names. Anything else goes into overrides: ["{name}.part=1.0"].'
    )


def _require_mode(render_mode: str | None) -> None:
    if render_mode not in (None, RENDER_MODE):
        raise ConfigError(f"render_mode is {render_mode!r}; there is {RENDER_MODE!r} alone.")
