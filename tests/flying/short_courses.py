"""A pilot that needs no training, and short courses for it to fly."""

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch
from omegaconf import DictConfig, OmegaConf
from torch import Tensor

from resc.envs.quadrotor import QuadrotorEnv, layout_of
from resc.evaluation.courses import Course, lay_out
from resc.evaluation.setting import Rules
from resc.planning.route import RoutePlanner, planner_for
from resc.policies.heads import Gaussian
from resc.policies.networks import Mlp
from resc.policies.policy import Policy
from resc.policies.stored import StoredPolicy
from resc.setup import build_stages

SPEED_MPS = 2.0
CORRIDOR = {
    "_target_": "resc.scenes.named.NamedScene",
    "boxes": [[0.0, 3.0, 6.0, 0.5], [2.5, 0.0, 0.5, 1.5]],
    "start_m": [1.0, 1.0, 1.0],
    "goal_m": [4.5, 1.0, 1.0],
    "origin_m": [0.0, 0.0],
    "size_m": [6.0, 4.0],
    "jitter_m": 0.05,
}
"""A wall to fly round: about 4 m."""


class Pilot(Policy):
    """Flies to the control point ahead: proportional control of velocity, attitude, body rates."""

    def __init__(self, layout: tuple[tuple[str, int], ...]) -> None:
        width = sum(width for _, width in layout)
        super().__init__(Mlp(hidden=[]), Gaussian(4), width)
        ends = torch.tensor([width for _, width in layout]).cumsum(0).tolist()
        self.at = {
            name: slice(end - width, end) for (name, width), end in zip(layout, ends, strict=True)
        }

    def decide(self, observation: Tensor, state: None = None) -> tuple[Tensor, None]:
        velocity, attitude = (observation[:, self.at[name]] for name in ("velocity", "attitude"))
        ahead = observation[:, self.at["control_points"]][:, :3]
        reach = ahead.norm(dim=-1, keepdim=True).clamp(min=1e-6)
        wanted = ahead / reach * (1.5 * reach + 0.6).clamp(max=SPEED_MPS)
        push = (2 * (wanted - velocity)).clamp(-5, 5)
        roll, pitch, yaw = attitude.unbind(-1)
        forward = push[:, 0] * yaw.cos() + push[:, 1] * yaw.sin()
        left = push[:, 1] * yaw.cos() - push[:, 0] * yaw.sin()
        turn = torch.atan2(ahead[:, 1], ahead[:, 0]) - yaw
        turn = torch.remainder(turn + math.pi, 2 * math.pi) - math.pi
        thrust_g = (1 + push[:, 2] / 9.8) / (roll.cos() * pitch.cos())
        rates = (
            8 * (torch.atan(-left / 9.8) - roll),
            8 * (torch.atan(forward / 9.8) - pitch),
            2 * turn,
        )
        limits = observation.new_tensor([2.0944, 2.0944, 1.0472])
        action = torch.cat((torch.stack(rates, -1) / limits, ((thrust_g - 1) / 0.7)[:, None]), -1)
        return action.clamp(-1, 1), state


@pytest.fixture(scope="session")
def stored(compose: Callable[..., DictConfig]) -> DictConfig:
    """The configuration that comes with a policy; a plain one, as the pilot sees no obstacles."""
    config = compose("obstacle_observation=none", "reward=[progress]", "algorithm.minibatch=128")
    return OmegaConf.create(OmegaConf.to_container(config, resolve=True))


@pytest.fixture(scope="session")
def policy_for() -> Callable[[DictConfig], StoredPolicy]:
    """`policy_for(config)`: the pilot as a policy that was trained with a configuration."""

    def make(config: DictConfig) -> StoredPolicy:
        layout = tuple(layout_of(build_stages(config)))
        return StoredPolicy(Pilot(layout), layout, config)

    return make


@pytest.fixture(scope="session")
def policy(policy_for: Callable[[DictConfig], StoredPolicy], stored: DictConfig) -> StoredPolicy:
    """The pilot as a policy."""
    return policy_for(stored)


@pytest.fixture(scope="session")
def evaluation(composer: Callable[..., DictConfig]) -> Callable[..., dict[str, Any]]:
    """`evaluation(*overrides)`: the configuration of conf/evaluate.yaml."""

    def composed(*overrides: str) -> dict[str, Any]:
        config = composer("evaluate", ("recorder=none", *overrides))
        return OmegaConf.to_container(config, resolve=True)

    return composed


@pytest.fixture(scope="session")
def planner(stored: DictConfig) -> RoutePlanner:
    """The default planner."""
    made = planner_for(search=stored["search"], task=stored["task"], env=stored["env"])
    assert made is not None
    return made


@pytest.fixture(scope="session")
def corridor(planner: RoutePlanner) -> Callable[..., Course]:
    """`corridor(flights, **changes)`: a course round a wall."""

    def course(flights: int, **changes: Any) -> Course:
        return lay_out({"corridor": {**CORRIDOR, **changes}}, flights, seed=0, planner=planner)[0]

    return course


@pytest.fixture(scope="session")
def flying(
    evaluation: Callable[..., dict[str, Any]], stored: DictConfig
) -> Callable[..., QuadrotorEnv]:
    """`flying(courses, *overrides)`: an environment with a row for every flight."""

    def env(courses: list[Course], *overrides: str) -> QuadrotorEnv:
        rules = Rules(evaluation(*overrides), stored, own_routes=courses[0].own_routes)
        return rules.env(courses)

    return env
