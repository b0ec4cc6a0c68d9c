"""Numbers that turn bad in the middle of a training: the term, environment and step are named."""

import re

import pytest
import torch
from omegaconf import OmegaConf

from resc import keys
from resc.envs.quadrotor import QuadrotorEnv
from resc.envs.stages import Stages
from resc.envs.terms import Terms
from resc.errors import NumericalError
from resc.learning.trainer import Trainer
from resc.learning.training_run import TrainingRun
from resc.setup import build_stages, set_up
from resc.term import Observation, Reward, Termination
from resc.terms.estimators.fd_lpf import FiniteDifference
from resc.terms.estimators.noise import Noise
from resc.terms.sensors.imu import Imu
from resc.terms.sensors.mocap import Mocap

STEPS = 8


class Rots(Reward):
    """NaN in the fifth step of an episode, in environments above the height of 1 m or so."""

    reads = (keys.CLOCK,)
    value = torch.nan

    def compute(self, clock):
        return torch.where(clock == 5, self.value, 0.0)


class Rotten(Observation):
    """Infinite after five steps of an episode."""

    reads = (keys.CLOCK,)
    columns = ("good", "bad")

    def compute(self, clock):
        return torch.cat((clock, 1 / (clock - 5).abs()), -1)


class AfterFive(Termination):
    """Ends every episode after its fifth step."""

    reads = (keys.CLOCK,)

    def compute(self, clock):
        return clock >= 5


@pytest.fixture(scope="module")
def trainer(compose):
    """`trainer(rewards=[...])`: PPO on two environments with further terms in some groups."""
    config = compose(
        "scene=free",
        "reward=paper2025",
        "task=from_rest",
        "algorithm.minibatch=8",
        "task.initial_state.difficulty=null",
    )
    pool = set_up(config, size=2, seed=0).pool

    def make(**more):
        stages = build_stages(config)
        terms = {name: getattr(stages.terms, name) for name in Terms.__dataclass_fields__}
        for group, term in more.items():
            several = term if isinstance(term, list) else [term.named("mine")]
            single = group == "estimator"
            terms[group] = term.named(group) if single else [*terms[group], *several]
        env = QuadrotorEnv(Stages(Terms(**terms), stages.context), pool, num_envs=2, compiled=False)
        own = {"algorithm": {**config["algorithm"], "steps": STEPS}, "num_envs": 2}
        run = TrainingRun(OmegaConf.create({**config, **own, "compile": False}))
        algorithm = run.algorithm(env.stages)
        return Trainer(env, algorithm)

    return make


def test_a_reward_that_turns_nan_is_named_and_not_the_learning_rate(trainer):
    ppo = trainer(rewards=Rots(weight=0.5))
    before = [p.clone() for p in ppo.algorithm.parameters]
    with pytest.raises(NumericalError) as caught:
        ppo.iterate()
    assert str(caught.value).startswith(
        "reward.mine is nan in environment 0 after 5 steps of its episode and 5 of the run; look "
    )
    assert "learning_rate" not in str(caught.value)
    for old, new in zip(before, ppo.algorithm.parameters, strict=True):
        assert torch.equal(old, new)


def test_steps_of_the_run_go_on_over_batches_and_episodes(trainer):
    ppo = trainer(rewards=Rots(weight=0.5), terminations=AfterFive())
    ppo.env.stages.terms.rewards[-1].value = 0.0
    ppo.iterate()
    ppo.env.stages.terms.rewards[-1].value = torch.nan
    with pytest.raises(NumericalError, match="after 5 steps of its episode and 10 of the run"):
        ppo.iterate()


def test_an_observation_that_turns_infinite_is_named_with_its_column(trainer):
    with pytest.raises(NumericalError) as caught:
        trainer(observations=Rotten()).iterate()
    assert str(caught.value).startswith(
        "observation.mine.bad is inf in environment 0 after 5 steps of its episode and 5 of the run"
    )


class Blind(Mocap):
    """Delivers no number in the fourth step of an episode."""

    def compute(self, clock, *given):
        position, *rest = super().compute(clock, *given)
        return torch.where(clock == 4, torch.nan, position), *rest


class Lost(Noise):
    """Loses the velocity in the fourth step of an episode."""

    reads = (*Noise.reads, keys.CLOCK)

    def compute(self, *given):
        *state, clock, unit = given
        position, velocity, *rest = super().compute(*state, unit)
        return position, torch.where(clock == 4, torch.nan, velocity), *rest


def test_a_sensor_that_turns_nan_is_named(trainer):
    with pytest.raises(NumericalError) as caught:
        trainer(
            sensors=[Blind(rate_hz=50.0).named("mocap"), Imu().named("imu")],
            estimator=FiniteDifference(cutoff_hz=10.0),
        ).iterate()
    assert str(caught.value).startswith(
        "sensor.mocap_position_w is nan in environment 0 at step 4 of its episode; look at the "
        "numbers of sensor.mocap"
    )


def test_an_estimator_that_turns_nan_is_named_and_its_sensors_are_cleared(trainer):
    term = Lost(position_m=0.0, velocity_mps=0.0, attitude_rad=0.0, body_rate_radps=0.0)
    with pytest.raises(NumericalError) as caught:
        trainer(estimator=term).iterate()
    assert str(caught.value).startswith(
        "estimate.velocity_w is nan in environment 0 at step 4 of its episode; look at the numbers "
        "of estimator"
    )


def test_the_last_observation_of_an_episode_is_looked_at_too(trainer):
    with pytest.raises(NumericalError, match=r"observation\.mine\.bad is inf .* after 5 steps"):
        trainer(observations=Rotten(), terminations=AfterFive()).iterate()


def test_without_anything_wrong_in_the_flight_the_loss_points_to_the_learning_rate(trainer):
    ppo = trainer(rewards=Rots(weight=1.0))
    ppo.env.stages.terms.rewards[-1].value = 1e25
    with pytest.raises(
        NumericalError, match=r"loss is not finite.*reward\.mine of up to 1e\+25.*learning_rate"
    ):
        ppo.iterate()


def test_weights_that_are_not_finite_are_blamed_on_the_training(trainer):
    ppo = trainer()
    ppo.algorithm.parameters[0].data.fill_(torch.nan)
    with pytest.raises(NumericalError, match="although all that is observed is finite"):
        ppo.collector.collect()


def test_an_action_answering_a_bad_observation_names_the_observation(make_env):
    env = make_env("num_envs=2")
    env.restart(torch.arange(2))
    env.observation = env.observation.clone()
    column = env.stages.observation_columns.index("velocity.y")
    env.observation[1, column] = torch.nan
    action = torch.zeros(2, 4)
    action[1] = torch.nan
    message = "observation.velocity.y is nan in environment 1 at step 0 of its episode"
    with pytest.raises(NumericalError, match=re.escape(message)):
        env.advance(action)
