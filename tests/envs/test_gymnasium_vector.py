"""The batch behind Gymnasium's and Stable-Baselines3's interfaces: same numbers, their conventions.

In DYING every episode ends after two steps, by the clock.
"""

import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from numpy.testing import assert_array_equal as assert_same
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.vec_env import VecMonitor

from resc.envs.gymnasium_env import QuadrotorGymEnv
from resc.envs.gymnasium_vector import QuadrotorVectorEnv
from resc.envs.sb3_vec_env import QuadrotorVecEnv
from resc.errors import CallError, ConfigError

COUNT = 3
FREE = ("+experiment=obstacle_free", f"num_envs={COUNT}")
DYING = (*FREE, "termination=[time_limit]", "termination.time_limit.limit_s=0.04")
STILL = np.zeros((COUNT, 4), np.float32)
NONE, ALL = np.zeros(COUNT, bool), np.ones(COUNT, bool)
ROWS = torch.arange(COUNT)
MODES = [mode.value for mode in AutoresetMode]


def actions(steps):
    return np.random.default_rng(0).uniform(-1, 1, (steps, COUNT, 4)).astype(np.float32)


@pytest.fixture
def vector(make_env):
    return lambda mode, *overrides: QuadrotorVectorEnv(make_env(*(overrides or DYING)), mode)


def test_spaces_and_metadata_are_what_gymnasium_expects(vector):
    envs = vector("SameStep")
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert envs.metadata["render_fps"] == 50
    assert envs.observation_space.shape == (COUNT, *envs.single_observation_space.shape)
    assert envs.action_space.shape == (COUNT, 4)
    observation, info = envs.reset(seed=1)
    assert observation in envs.observation_space
    assert info == {}
    observation, reward, terminated, truncated, _ = envs.step(envs.action_space.sample())
    assert observation in envs.observation_space
    assert [part.shape for part in (reward, terminated, truncated)] == [(COUNT,)] * 3
    assert [part.dtype for part in (reward, terminated, truncated)] == [np.float32, bool, bool]


def test_numbers_are_those_of_the_environment(vector, make_env):
    env, envs = make_env(*FREE), vector("Disabled", *FREE)
    env.set_seed(7)
    assert_same(envs.reset(seed=7)[0], env.restart(ROWS))
    for action in actions(3):
        observation, reward, terminated, truncated, _ = envs.step(action)
        out = env.advance(torch.from_numpy(action))
        assert_same(observation, out.observation)
        assert_same(reward, out.reward[:, 0])
        assert_same(terminated | truncated, out.done[:, 0])


@pytest.mark.parametrize("mode", MODES)
def test_an_ending_and_the_next_episode_are_as_in_gymnasiums_own_vector(make_env, vector, mode):
    """What Gymnasium makes of a single environment: the same flags, zeros and keys at each step."""
    single = (*DYING, "num_envs=1")
    theirs = SyncVectorEnv(
        [lambda: QuadrotorGymEnv(make_env(*single)) for _ in range(COUNT)], autoreset_mode=mode
    )
    ours = vector(mode)
    assert ours.reset(seed=0)[0].shape == theirs.reset(seed=0)[0].shape
    for _ in range(5):
        answers = [envs.step(STILL) for envs in (ours, theirs)]
        for own, other in zip(*(answer[2:4] for answer in answers), strict=True):
            assert_same(own, other)
        assert_same(answers[0][1] == 0, answers[1][1] == 0)
        assert_alike(*(answer[4] for answer in answers))
        ended = answers[0][2] | answers[0][3]
        if mode == "Disabled" and ended.any():
            for envs in (ours, theirs):
                envs.reset(options={"reset_mask": ended})


def assert_alike(own, other):
    """Two infos of the same keys, types and masks."""
    assert own.keys() == other.keys()
    for name, value in own.items():
        if isinstance(value, dict):
            assert_alike(value, other[name])
        else:
            assert value.shape == other[name].shape, name
            assert value.dtype == other[name].dtype, name
            if value.dtype == bool:
                assert_same(value, other[name], name)


def test_next_step_spends_a_step_on_the_reset(vector, make_env):
    envs, env = vector(AutoresetMode.NEXT_STEP), make_env(*DYING)
    env.set_seed(1)
    env.restart(ROWS)
    envs.reset(seed=1)
    flags = []
    for step in range(5):
        wild = np.full((COUNT, 4), np.nan, np.float32) if step == 2 else STILL
        observation, reward, terminated, truncated, info = envs.step(wild)
        out = env.advance(torch.zeros(COUNT, 4))
        flags.append(bool(truncated.all()))
        assert not terminated.any()
        if step == 1:
            assert_same(observation, out.observation)  # the last one of the episode
            assert list(info["outcome"]) == ["time_limit"] * COUNT
            assert_same(info["_outcome"], ALL)
            assert_same(info["is_success"], NONE)
        if step == 2:
            assert_same(observation, env.restart(ROWS))
            assert not reward.any()
    assert flags == [False, True, False, False, True]


def test_same_step_tells_the_last_observation_apart(vector, make_env):
    envs, env = vector(AutoresetMode.SAME_STEP), make_env(*DYING)
    env.set_seed(1)
    env.restart(ROWS)
    envs.reset(seed=1)
    assert envs.step(STILL)[4] == {}
    env.advance(torch.zeros(COUNT, 4))
    observation, _, _, truncated, info = envs.step(STILL)
    out = env.advance(torch.zeros(COUNT, 4))
    assert truncated.all()
    assert_same(np.stack(info["final_obs"]), out.observation)
    assert_same(info["_final_obs"], ALL)
    assert_same(info["_final_info"], ALL)
    assert list(info["final_info"]["outcome"]) == ["time_limit"] * COUNT
    assert_same(observation, env.restart(ROWS))


def test_disabled_leaves_the_reset_to_the_caller(vector):
    envs = vector(AutoresetMode.DISABLED)
    envs.reset(seed=1)
    envs.step(STILL)
    envs.step(STILL)
    with pytest.raises(CallError, match=r"episodes of environments \[0, 1, 2\] have ended; begin"):
        envs.step(STILL)
    before = envs.env.observation.clone()
    observation, _ = envs.reset(options={"reset_mask": np.array([False, True, False])})
    assert_same((observation != before.numpy()).any(-1), [False, True, False])
    with pytest.raises(CallError, match=r"environments \[0, 2\] have ended"):
        envs.step(STILL)
    envs.reset(options={"reset_mask": np.array([True, False, True])})
    assert not envs.step(STILL)[3].any()


def test_a_seed_gives_the_same_flight_again(vector):
    envs = vector("SameStep")
    flown = []
    for seed in (3, 3, 4):
        seen = [envs.reset(seed=seed)[0]]
        flown.append(np.stack(seen + [envs.step(action)[0] for action in actions(5)]))
    assert_same(flown[0], flown[1])
    assert (flown[0] != flown[2]).any(-1).all()


def test_what_is_returned_stays_as_it_was(vector):
    envs = vector("SameStep", *FREE)
    first, _ = envs.reset(seed=1)
    kept = first.copy()
    second = envs.step(STILL)[0]
    assert_same(first, kept)
    again = second.copy()
    second[:] = 0.0
    assert_same(envs.env.observation, again)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"options": {"reset_maks": ALL}}, "no option 'reset_maks'. Did you mean 'reset_mask'?"),
        (
            {"options": {"reset_mask": [True] * COUNT}},
            "reset_mask is .*; expected an array of bool",
        ),
        ({"options": {"reset_mask": NONE}}, "one of them True at least"),
        ({"options": {"reset_mask": np.ones(2, bool)}}, "with 3 entries"),
        ({"seed": [1, 2, 3]}, r"seed is \[1, 2, 3\]; the whole batch has one"),
    ],
)
def test_a_wrong_reset_gets_one_sentence(vector, arguments, sentence):
    envs = vector("SameStep", *FREE)
    envs.reset()
    with pytest.raises(CallError, match=sentence):
        envs.reset(**arguments)


def test_what_cannot_be_done_yet_or_at_all_gets_one_sentence(vector):
    envs = vector("SameStep", *FREE)
    with pytest.raises(CallError, match="the first reset is of all environments"):
        envs.reset(options={"reset_mask": ALL})
    envs.reset()
    with pytest.raises(CallError, match=r"shape \[2, 4\]; expected \[3, 4\]"):
        envs.step(np.zeros((2, 4)))
    with pytest.raises(CallError, match="The action is no array of numbers"):
        envs.step(np.array(["up"]))
    with pytest.raises(ConfigError, match="autoreset_mode is 'same'; expected one of NextStep, Sa"):
        vector("same", *FREE)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_gymnasiums_statistics_count_every_step_once(vector, mode):
    envs = RecordEpisodeStatistics(vector(mode))
    envs.reset(seed=0)
    returns = envs.step(STILL)[1]
    _, reward, _, _, info = envs.step(STILL)
    np.testing.assert_allclose(info["episode"]["r"], returns + reward, rtol=1e-6)
    assert_same(info["episode"]["l"], [2] * COUNT)


class TestStableBaselines3:
    @pytest.fixture
    def envs(self, vector):
        return QuadrotorVecEnv(vector("SameStep"))

    # The observation has no bounds.
    @pytest.mark.filterwarnings("ignore:.*observation space.*infinity")
    def test_a_single_environment_passes_its_checker(self, make_env):
        check_env(QuadrotorGymEnv(make_env(*FREE, "num_envs=1")))

    def test_an_episode_that_ends_is_told_as_it_expects(self, envs, make_env):
        env = make_env(*DYING)
        env.set_seed(5)
        first = env.restart(ROWS)
        envs.seed(5)
        assert_same(envs.reset(), first)
        assert envs.step(STILL)[3] == [{}, {}, {}]
        observation, reward, ended, infos = envs.step(STILL)
        env.advance(torch.zeros(COUNT, 4))
        out = env.advance(torch.zeros(COUNT, 4))
        assert ended.all()
        assert_same(reward, out.reward[:, 0])
        assert_same([info.pop("terminal_observation") for info in infos], out.observation)
        expected = {"TimeLimit.truncated": True, "outcome": "time_limit", "is_success": False}
        assert infos == [expected] * COUNT
        assert_same(observation, env.restart(ROWS))

    def test_ppo_learns_on_it_and_sees_returns(self, envs):
        model = PPO("MlpPolicy", VecMonitor(envs), n_steps=4, batch_size=6, n_epochs=1, seed=0)
        model.learn(12)
        assert [episode["l"] for episode in model.ep_info_buffer] == [2] * 6
        assert list(model.ep_success_buffer) == [False] * 6

    def test_attributes_are_those_of_the_batch(self, envs):
        assert envs.get_attr("render_mode") == [None] * COUNT
        assert envs.get_attr("num_envs", [0, 2]) == [COUNT] * 2
        assert envs.env_is_wrapped(VecMonitor, 1) == [False]
        with pytest.raises(CallError, match="wind cannot be set in one environment: all are one"):
            envs.set_attr("wind", 1.0)
        with pytest.raises(CallError, match="renew cannot be called in one environment"):
            envs.env_method("renew", 1)

    def test_another_autoreset_mode_is_refused(self, vector):
        with pytest.raises(ConfigError, match="autoreset_mode is NextStep, but Stable-Baselines3"):
            QuadrotorVecEnv(vector("NextStep"))
