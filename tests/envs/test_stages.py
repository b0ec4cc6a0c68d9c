import pytest
import torch

from resc import keys
from resc.envs.stages import Stages
from resc.envs.terms import Terms
from resc.errors import ConfigError
from resc.setup import build_stages
from resc.term import Context, Observation, Reward


class ReadsClearanceBefore(Reward):
    """A reward on the clearance before the step."""

    reads = (keys.previous(keys.CLEARANCE),)

    def compute(self, before):
        return before


class SeesThePassing(Observation):
    """An observation of something that only a step writes."""

    reads = (keys.PASSED,)
    columns = ("passed",)

    def compute(self, passed):
        return passed.float()


class ReadsNothingKnown(Reward):
    """A reward on a key that no term writes."""

    reads = (("sensor", "camera"),)

    def compute(self, camera):
        return camera


@pytest.fixture(scope="module")
def assembled(compose):
    """`assembled(rewards=..., ...)`: the default stages with some lists of terms replaced."""
    config = compose()

    def make(**changed):
        stages = build_stages(config)
        terms = {name: getattr(stages.terms, name) for name in Terms.__dataclass_fields__}
        return Stages(
            Terms(**terms | changed),
            Context(dt_s=0.02, resolution_m=0.1, vehicle=stages.context.vehicle),
        )

    return make


def test_a_key_that_nothing_writes_is_named_with_its_reader(assembled):
    with pytest.raises(
        ConfigError, match=r"reward\.lonely reads sensor\.camera, which nothing before it writes"
    ):
        assembled(rewards=[ReadsNothingKnown(weight=1.0).named("lonely")])


def test_a_missing_sensor_is_named_with_its_reader(make_stages):
    with pytest.raises(ConfigError, match=r"termination\.collision reads sensor\.clearance"):
        make_stages("sensor=[euler,limit_violations]")


def test_a_sensor_must_come_after_the_one_it_reads(make_stages):
    with pytest.raises(ConfigError, match=r"sensor\.limit_violations reads sensor\.euler"):
        make_stages("sensor=[limit_violations,clearance,euler]")


def test_the_past_of_a_key_that_no_step_keeps_is_refused_at_build(assembled):
    with pytest.raises(ConfigError, match=r"reward\.looks_back reads memory\.sensor\.clearance"):
        assembled(rewards=[ReadsClearanceBefore(weight=1.0).named("looks_back")])


def test_an_observation_of_something_absent_at_reset_is_refused_at_build(assembled):
    with pytest.raises(ConfigError, match=r"observation\.sees reads task\.passed"):
        assembled(observations=[SeesThePassing().named("sees")])


@pytest.mark.parametrize("group", ["reward", "termination"])
def test_a_step_needs_rewards_and_terminations(compose, group):
    config = compose()
    config[group] = {}
    with pytest.raises(ConfigError, match=group):
        build_stages(config)


def test_every_key_of_the_world_has_its_declared_shape_and_type(make_env):
    env = make_env(
        "metric=[energy,top_speed]", "randomization=[mass,inertia,thrust_map,action_delay]"
    )
    env.restart(torch.arange(4))
    env.advance(torch.zeros(4, 4))
    world = env.world
    for key, declared in keys.DECLARED.items():
        if key not in world.keys(include_nested=True):
            continue
        value = world[key]
        assert value.dtype == declared.dtype, key
        assert value.ndim == 1 + len(declared.shape), key
        for size, wanted in zip(value.shape[1:], declared.shape, strict=True):
            assert isinstance(wanted, str) or size == wanted, key


def test_every_map_of_the_pool_has_its_declared_shape_and_type(make_env):
    pool = make_env().pool
    shared = {key for key, declared in keys.DECLARED.items() if declared.shared}
    assert set(pool.shared) == shared
    for key in shared:
        assert pool.shared[key].dtype == keys.DECLARED[key].dtype, key
        assert pool.shared[key].ndim == len(keys.DECLARED[key].shape), key


def test_gradients_flow_through_a_step_to_the_action(make_env):
    env = make_env("scene=free", "task=from_rest", "obstacle_observation=none")
    env.restart(torch.arange(4))
    action = torch.zeros(4, 4, requires_grad=True)
    world = dict(env.world.flatten_keys(".").items())
    world = {tuple(key.split(".")): value for key, value in world.items()}
    for _ in range(2):
        world, out = env.stages.step(world, env.pool.shared, action, {})
    out.reward.sum().backward()
    assert action.grad.isfinite().all()
    assert (action.grad[:, 3] != 0).any()
