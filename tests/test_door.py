"""`resc.load`, `resc.make_env`, `resc.load_policy`: what train.py makes, from Python."""

import functools
import pickle
import subprocess
import sys

import pytest
import torch
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.singleton import Singleton
from omegaconf import OmegaConf
from torch.testing import assert_close

import resc
import resc.schema
from resc.errors import CheckpointError, ConfigError


def plain(config):
    return OmegaConf.to_container(config, resolve=True)


def test_importing_resc_imports_no_torch_and_no_hydra_and_gymnasium_knows_it_then():
    asked = (
        "import resc, sys, gymnasium; gymnasium.spec('resc/Flight-v0'); "
        "print(sorted({'torch', 'hydra', 'omegaconf'} & {*sys.modules}))"
    )
    done = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, timeout=60)
    assert (done.stdout, done.stderr) == ("[]\n", "")


def test_the_door_is_listed_and_nothing_else_is_behind_it():
    assert {*resc.__all__} <= {*dir(resc)}
    assert all(callable(getattr(resc, name)) for name in resc.__all__)
    with pytest.raises(AttributeError, match="module 'resc' has no attribute 'make'"):
        _ = resc.make  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize(
    "overrides", [(), ("reward.progress.weight=15.0", "dynamics=lag_and_drag")]
)
def test_load_composes_what_train_composes(compose, overrides):
    ours = resc.load("compile=false", "num_envs=4", *overrides)
    assert plain(ours) == plain(compose(*overrides))


@pytest.mark.parametrize(
    ("override", "sentence"),
    [
        ("num_env=3", "train has no 'num_env'. Did you mean 'num_envs'?"),
        ("reward=[progres]", "reward has no 'progres'. Did you mean 'progress'?"),
        ("reward.progress.wieght=1", "reward.progress has no 'wieght'. Did you mean 'weight'?"),
        ("reward=[progress,progress]", "reward.progress is defined by reward/progress, listed tw"),
        ("reward=3", "reward is 3; expected names of files in conf/reward"),
        ("+task.shape=1", "task.shape is not a setting"),
        ("seed=-1", "seed is -1; expected 0 to "),
        ("num_envs=many", "Value 'many' of type 'str' could not be converted to Integer"),
        ("seed=0,1", "Ambiguous value for argument 'seed=0,1'"),
        ("-m", "-m is an option of the command line; give overrides, such as seed=1."),
    ],
)
def test_a_wrong_override_gets_the_sentence_of_the_scripts(override, sentence):
    with pytest.raises(ConfigError) as raised:
        resc.load(override)
    assert sentence in str(raised.value)


def test_another_application_of_hydra_is_left_as_it_is(compose):
    """The application is that of the tests, which `compose` has begun."""
    store = ConfigStore.instance()
    store.store(name="schema", node={"theirs": 1})
    try:
        theirs = GlobalHydra.instance(), GlobalHydra.instance().hydra
        assert resc.load("seed=3")["seed"] == 3
        with pytest.raises(ConfigError):
            resc.load("sede=3")
        assert (GlobalHydra.instance(), GlobalHydra.instance().hydra) == theirs
        assert ConfigStore.instance() is store
        assert store.load("schema.yaml").node == {"theirs": 1}
        assert resc.load("seed=4")["seed"] == 4
    finally:
        resc.schema.register()
    assert compose("seed=11")["seed"] == 11


def test_nothing_of_hydra_is_left_where_there_was_nothing(monkeypatch):
    begun = {GlobalHydra, HydraConfig}
    others = {kind: it for kind, it in Singleton._instances.items() if kind not in begun}
    monkeypatch.setattr(Singleton, "_instances", others)
    assert resc.load("seed=3")["seed"] == 3
    assert begun.isdisjoint(Singleton._instances)


def test_an_environment_is_that_of_training_wherever_it_is_made(make_env, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ours = resc.make_env("obstacle_observation=ray_sampling", num_envs=4, pool_size=8, seed=5)
    theirs = make_env("obstacle_observation=ray_sampling", scenes=8, seed=5)
    rows = torch.arange(4)
    assert_close(ours.restart(rows), theirs.restart(rows))
    action = torch.zeros(4, 4)
    assert_close(ours.advance(action).observation, theirs.advance(action).observation)
    assert not list(tmp_path.iterdir())


def test_keywords_are_settings():
    env = resc.make_env("num_envs=2", num_envs=3, seed=7, device=torch.device("cpu"), pool_size=5)
    assert (env.num_envs, env.seed_value, len(env.pool)) == (3, 7, 5)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"num_env": 3}, "num_env is not a keyword of make_env; .* Did you mean 'num_envs'?"),
        ({"num_envs": 0}, "num_envs is 0; expected at least 1"),
        ({"device": "tpu"}, "device is 'tpu', which this machine does not have; use device=cpu"),
    ],
)
def test_wrong_keywords_are_refused(settings, sentence):
    with pytest.raises(ConfigError, match=sentence):
        resc.make_env(**settings)


def test_makers_of_environments_can_be_pickled_for_other_processes():
    maker = functools.partial(resc.make_env, "seed=1", num_envs=2, pool_size=4)
    assert pickle.loads(pickle.dumps(maker))().num_envs == 2


def test_a_shipped_policy_flies_from_anywhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    policy = resc.load_policy("policies/obstacles")
    env = resc.make_env(num_envs=3, pool_size=8)
    flown = env.rollout(3, policy, break_when_any_done=False)
    assert_close(flown["action"], policy(flown["observation"]))
    policy.require_layout(env.stages)


def test_a_policy_that_is_not_there_is_named():
    with pytest.raises(CheckpointError, match="policies/obstacle holds no policy"):
        resc.load_policy("policies/obstacle")


@pytest.mark.parametrize(
    "idle", ["resume=latest", "init_from=latest", "total_frames=5", "algorithm.steps=4", "~logger"]
)
def test_what_means_nothing_to_an_environment_is_refused(idle):
    with pytest.raises(ConfigError, match="belongs to a training run and changes nothing"):
        resc.make_env(idle, num_envs=1, pool_size=1)


@pytest.mark.parametrize(
    ("overrides", "idle"),
    [
        (["curriculum=fixed"], ["curriculum=fixed"]),
        (["~curriculum"], ["~curriculum"]),
        (
            ["curriculum=fixed", "curriculum.initial_state.value=0.0"],
            ["curriculum=fixed", "curriculum.initial_state.value=0.0"],
        ),
        (
            ["curriculum=success", "curriculum.caution.share=0.6", "seed=1"],
            ["curriculum.caution.share=0.6"],
        ),
        (["scene.difficulty=null", "curriculum=success"], ["curriculum=success"]),
    ],
)
def test_a_curriculum_that_changes_nothing_in_an_environment_is_refused(overrides, idle):
    with pytest.raises(ConfigError) as raised:
        resc.make_env(*overrides, num_envs=1, pool_size=8)
    assert str(raised.value).startswith(f"{', '.join(idle)}: nothing is trained here")
    assert "env.set_difficulty(name, value)" in str(raised.value)


@pytest.mark.parametrize(
    ("overrides", "level"),
    [
        (["curriculum=success"], 1.0),
        (["curriculum=linear", "+curriculum.obstacles.last=0.5"], 0.5),
        (["curriculum=fixed", "curriculum.obstacles.value=0.5"], 0.5),
    ],
)
def test_scenes_are_laid_out_at_the_levels_of_a_curriculum_and_flown_at_the_greatest(
    overrides, level
):
    env = resc.make_env(*overrides, num_envs=4, pool_size=8)
    assert float(env.pool.levels[-1]) == env.scene_difficulty == level
    assert {name: float(value) for name, value in env.difficulties.items()} == {
        **dict.fromkeys(env.difficulties, 1.0),
        "obstacles": level,
    }
    env.restart(torch.arange(4))
    assert env.flown_difficulties["obstacles"].tolist() == [[level]] * 4
