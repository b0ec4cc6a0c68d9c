"""Every preset of observation, reward, curriculum and scene flies with every other.

Each combination builds, flies with resets, and keeps its declared specs, for 1, 2, 3 and 64
environments. CI meets every preset and every number of environments at least once, in 20 steps; the
whole product takes hours. The contract of all parts (test_contract.py) is what `make test` runs.
"""

import functools
import itertools
from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf

from resc.build import build_terms
from resc.setup import Setup, build_stages, set_up
from resc.term import Curriculum

CONF = Path(__file__).parents[1] / "conf"
COUNTS = (1, 2, 3, 64)


def names(group):
    return sorted(path.stem for path in (CONF / group).glob("*.yaml"))


OBSERVATIONS = [f"obstacle_observation={name}" for name in names("obstacle_observation")]
REWARDS = [None] + [
    f"reward={name}"
    for name in names("reward")
    if "defaults" in OmegaConf.load(CONF / "reward" / f"{name}.yaml")
]
"""The default list, and the files that are lists of others."""
CURRICULA = [f"curriculum={name}" for name in names("curriculum")]
SCENES = [f"scene={name}" for name in names("scene")]
MOVING = [f"scene={name}" for name in ("dynamic", "dynamic_training")]
"""Scenes that are refused where nothing shows the policy what moves."""
GROUPS = (OBSERVATIONS, REWARDS, CURRICULA, SCENES)
PRODUCT = list(itertools.product(*GROUPS))
COVER = [
    (tuple(group[row % len(group)] for group in GROUPS), COUNTS[row % len(COUNTS)])
    for row in range(max(map(len, GROUPS)))
]


@pytest.fixture(scope="module")
def flown(compose):
    """`flown(combination, num_envs, steps)`: flies it, checking every step against the specs."""

    @functools.lru_cache(maxsize=2)  # the product walks through observations and rewards first
    def scenes(*overrides):
        config = compose(*overrides)
        curricula = build_terms(config["curriculum"], "curriculum", Curriculum)
        return set_up(config, size=8, seed=0, curricula=curricula).pool

    def fly(combination, num_envs, steps):
        seen = ["sensing=local"] * (combination[-1] in MOVING)
        overrides = [*seen, *(override for override in combination if override)]
        config = compose(*overrides, f"num_envs={num_envs}")
        env = Setup(build_stages(config), scenes(*seen, *combination[2:])).env(
            num_envs, compiled=False
        )
        generator = torch.Generator().manual_seed(0)
        everyone = torch.arange(num_envs)
        assert env.observation_spec["observation"].is_in(env.restart(everyone))
        for step in range(steps):
            out = env.advance(1.8 * torch.rand(num_envs, 4, generator=generator) - 0.9)
            assert env.observation_spec["observation"].is_in(out.observation)
            assert env.observation_spec["outcome"].is_in(out.outcome)
            assert env.reward_spec.is_in(out.reward)
            for name in ("done", "terminated", "truncated"):
                assert env.full_done_spec[name].is_in(getattr(out, name))
            assert out.observation.isfinite().all()
            assert out.reward.isfinite().all()
            out.done[::2] |= step == steps // 2  # so that resets are met where no episode ends
            seen = env.restart(out.done[:, 0].nonzero()[:, 0])
            assert env.observation_spec["observation"].is_in(seen)
            assert seen.isfinite().all()

    return fly


def identifier(combination):
    return "-".join(override.split("=")[1] if override else "default" for override in combination)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("combination", "num_envs"), [pytest.param(c, n, id=f"{identifier(c)}-{n}") for c, n in COVER]
)
def test_every_preset_flies_and_keeps_its_specs(flown, combination, num_envs):
    flown(combination, num_envs, steps=20)


@pytest.mark.slow  # some 3000 combinations
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("scene", SCENES)
def test_every_combination_flies_and_keeps_its_specs(flown, scene):
    for combination, num_envs in itertools.product(by_scene(scene), COUNTS):
        try:
            flown(combination, num_envs, steps=50)
        except Exception as error:
            raise AssertionError(f"{identifier(combination)}-{num_envs}") from error


def by_scene(scene):
    """All combinations with a scene, those of one curriculum one after the other."""
    with_it = (combination for combination in PRODUCT if combination[-1] == scene)
    return sorted(with_it, key=lambda combination: combination[2])
