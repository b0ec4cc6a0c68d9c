"""What every pilot of conf/pilot keeps, one case per file; and how pilots are chosen."""

from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf
from torch.testing import assert_close

from resc.errors import CheckpointError, ConfigError
from resc.evaluation.setting import Rules
from resc.flying.pilot import FolderPilot, Pilot, build_pilots

ROOT = Path(__file__).parents[2]
NAMES = sorted(path.stem for path in (ROOT / "conf" / "pilot").glob("*.yaml"))
COUNT, STEPS = 4, 25
PERMUTATION = torch.tensor([2, 0, 3, 1])


@pytest.fixture(scope="module")
def shipped():
    """The configuration of the shipped policy."""
    return OmegaConf.load(ROOT / "policies" / "obstacles" / "config.yaml")


@pytest.fixture(scope="module")
def env(evaluation, shipped, corridor):
    """Four flights round a wall, as the shipped policy sees them."""
    course = corridor(COUNT)
    return Rules(evaluation(), shipped, own_routes=False).env([course])


@pytest.fixture(scope="module", params=NAMES)
def pilot(request, evaluation):
    """One of conf/pilot."""
    (made,) = build_pilots(evaluation(f"pilot={request.param}")["pilot"])
    return made


@pytest.fixture(scope="module")
def seen(env, pilot):
    """World, observation and action of every step of its first half second."""
    env.set_seed(0)
    observation = env.restart(torch.arange(COUNT))
    pilot.check(env.stages)
    pilot.begin(COUNT, env.stages, env.pool.shared)
    steps = []
    for _ in range(STEPS):
        world = env.world
        before = world.clone()
        with torch.no_grad():
            action = pilot.act(world, observation)
        assert (world == before).all()
        steps.append((before, observation.clone(), action))
        observation = env.advance(action).observation
    return steps


def flown(pilot, env, steps):
    """The actions of the pilot, from a fresh beginning, on what was seen."""
    pilot.begin(len(steps[0][1]), env.stages, env.pool.shared)
    with torch.no_grad():
        return [pilot.act(world, observation) for world, observation, *_ in steps]


def test_actions_are_finite_and_within_their_range(seen, env):
    for _, _, action in seen:
        assert action.shape == (COUNT, env.stages.terms.action.width)
        assert action.dtype == torch.float32
        assert action.isfinite().all()
        assert (action.abs() <= 1).all()


def test_the_same_flights_from_a_new_beginning_give_the_same_actions(seen, pilot, env):
    for again, (_, _, action) in zip(flown(pilot, env, seen), seen, strict=True):
        assert torch.equal(again, action)


def test_permuted_flights_give_permuted_actions(seen, pilot, env):
    rows = [(world[PERMUTATION], observation[PERMUTATION]) for world, observation, _ in seen]
    for again, (_, _, action) in zip(flown(pilot, env, rows), seen, strict=True):
        assert_close(again, action[PERMUTATION], atol=1e-4, rtol=1e-4)


def test_one_flight_alone_is_flown_as_among_others(seen, pilot, env):
    rows = [(world[1:2], observation[1:2]) for world, observation, _ in seen]
    for again, (_, _, action) in zip(flown(pilot, env, rows), seen, strict=True):
        assert_close(again, action[1:2], atol=1e-4, rtol=1e-4)


def test_facts_are_words_for_a_recording(pilot):
    facts = pilot.facts()
    assert facts
    assert all(isinstance(part, str) for entry in facts.items() for part in entry)


def test_name_is_that_of_the_configuration(evaluation):
    pilots = build_pilots(evaluation("pilot=[pursuit,policy]")["pilot"])
    assert [pilot.name for pilot in pilots] == ["pursuit", "policy"]


def test_without_a_pilot_nothing_flies():
    with pytest.raises(ConfigError, match="pilot is empty; name at least one file of conf/pilot"):
        build_pilots({})


def test_class_that_is_no_pilot_is_refused():
    node = {"_target_": "resc.terms.sensors.euler.Euler"}
    with pytest.raises(ConfigError, match=r"pilot\.mine builds a Euler, which is not a Pilot"):
        build_pilots({"mine": node})


def test_policy_refuses_an_environment_that_shows_something_else(make_stages):
    pilot = FolderPilot(folder="policies/obstacles")
    with pytest.raises(CheckpointError, match="fly it with the observation of its own"):
        pilot.check(make_stages("obstacle_observation=none"))


def test_a_pilot_needs_no_more_than_act(env):
    class Hover(Pilot):
        def act(self, world, observation):
            return torch.zeros(len(observation), 4)

    pilot = Hover().named("hover")
    pilot.check(env.stages)
    pilot.begin(COUNT, env.stages, env.pool.shared)
    assert (pilot.name, pilot.facts()) == ("hover", {})
