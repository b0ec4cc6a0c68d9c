"""Terms of one's own take part as those of the package do, whatever their class and their keys."""

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from resc import keys
from resc.envs.quadrotor import QuadrotorEnv
from resc.envs.stages import Stages
from resc.envs.terms import Terms
from resc.setup import set_up
from resc.term import Observation, Sensor, Term, Termination
from resc.terms.metrics.flight import PathLength
from resc.terms.observations.velocity import Velocity

LAPS = ("task", "laps")


class Noisy(Sensor):
    """The height, measured with an error that is drawn at every step."""

    reads = (keys.POSITION_W,)
    step_draws = 1

    def compute(self, position, unit):
        return position[:, 2:] + unit


class Measured(Observation):
    """What that sensor says."""

    reads = (("sensor", "altimeter"),)
    columns = ("height",)

    def compute(self, height):
        return height


class Ghost(Termination):
    """An obstacle that no map knows: it is met in the first step."""

    reads = (keys.POSITION_W,)
    collision = True

    def compute(self, position):
        return position[:, :1].isfinite()


class Laps(Term):
    """A task without control points: it counts steps under a key of its own."""

    section = "task"
    reads = (keys.POSITION_W, LAPS)
    writes = (LAPS, keys.FINISHED)
    keeps = (LAPS,)

    def begin(self, tensors):
        return {LAPS: tensors[keys.CLOCK] + 5}

    def compute(self, position, laps):
        return laps + 1, laps + 1 > 6


class Seen(Observation):
    """The laps flown."""

    reads = (LAPS,)
    columns = ("laps",)

    def compute(self, laps):
        return laps


@pytest.fixture(scope="module")
def flying(compose):
    """`flying(observations=[...], ...)`: an environment of three with some lists replaced."""
    config = compose("obstacle_observation=none", "scene=free", "reward=[time]")
    setup = set_up(config, size=4, seed=0)

    def make(**changed):
        terms = {name: getattr(setup.stages.terms, name) for name in Terms.__dataclass_fields__}
        stages = Stages(Terms(**terms | changed), setup.stages.context)
        env = QuadrotorEnv(stages, setup.pool, num_envs=3, compiled=False)
        env.restart(torch.arange(3))
        return env

    return make


def test_a_sensor_may_draw_at_every_step_and_at_the_reset(flying):
    env = flying(
        sensors=[Noisy().named("altimeter")],
        observations=[Measured().named("height")],
        terminations=[Ghost().named("ghost")],
    )
    errors = []
    for _ in range(3):
        errors.append(env.observation[:, 0] - env.value_of(keys.POSITION_W)[:, 2])
        env.advance(torch.zeros(3, 4))
    assert ((torch.stack(errors) >= -1e-6) & (torch.stack(errors) < 1)).all()
    assert len({round(float(error), 4) for part in errors for error in part}) == 9
    assert env.stages.step_draws == {"sensor.altimeter": 1}


def test_a_task_may_keep_other_keys_than_control_points(flying):
    env = flying(
        task=Laps().named("control_points"),
        observations=[Seen().named("laps")],
        terminations=[Ghost().named("ghost")],
        sensors=[],
    )
    assert env.observation[:, 0].tolist() == [5.0] * 3
    out = env.advance(torch.zeros(3, 4))
    assert out.observation[:, 0].tolist() == [6.0] * 3
    assert env.advance(torch.zeros(3, 4)).outcome[:, 0].tolist() == [0] * 3
    assert keys.ROUTE_INDEX not in env.stages.persistent


def test_every_kind_of_term_takes_a_tensordict(flying):
    state = TensorDict(
        {
            "state": {"velocity_w": torch.tensor([[1.0, 2.0, 3.0]])},
            "frame": {"ahead": torch.tensor([[0.0, 1.0]])},
        },
        batch_size=[1],
    )
    term = Velocity(scale=2.0, history=2).named("velocity")
    seen = term(state)["observation", "velocity"]
    assert_close(seen, torch.tensor([[4.0, -2.0, 6.0, 4.0, -2.0, 6.0]]))
    metric = PathLength().named("path_length")
    flown = TensorDict({"metric": {"path_length": torch.tensor([[4.0]])}}, batch_size=[1])
    for key in metric.reads:
        flown[key] = torch.zeros(1, 3)
    flown["memory", "task", "finished"] = torch.tensor([[False]])
    assert metric(flown)["metric", "path_length"].item() == pytest.approx(4.0, abs=1e-3)
