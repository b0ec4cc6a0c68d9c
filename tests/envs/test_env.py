import pytest
import torch
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from resc import keys
from resc.errors import ConfigError, NumericalError

FREE = "scene=free"
REST = "task=from_rest"


def actions(count, num_envs=4, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return 0.4 * (2 * torch.rand(count, num_envs, 4, generator=generator) - 1)


def started(env):
    env.restart(torch.arange(env.num_envs))
    return env


def snapshot(env):
    return env.world.clone()


def assert_same_world(a, b, rows=slice(None)):
    for key in a.keys(include_nested=True, leaves_only=True):
        assert torch.equal(a[key][rows], b[key][rows]), key


def test_torchrl_finds_the_specs_true(make_env):
    check_env_specs(make_env(), seed=0)


@pytest.mark.parametrize("num_envs", [1, 2, 3, 64])
def test_any_number_of_environments_flies(make_env, num_envs):
    env = make_env(f"num_envs={num_envs}")
    rollout = env.rollout(4, break_when_any_done=False)
    assert rollout.batch_size == (num_envs, 4)
    assert rollout["observation"].shape == (num_envs, 4, 45)
    assert rollout["next", "reward"].isfinite().all()
    assert rollout["next", "observation"].isfinite().all()


def test_no_environment_at_all_is_refused(make_env):
    with pytest.raises(ConfigError, match="num_envs is 0"):
        make_env("num_envs=0")


def test_the_same_seed_gives_the_same_bits_and_another_seed_does_not(make_env):
    runs = []
    for seed in (5, 5, 6):
        env = started(make_env(seed=seed))
        outputs = [env.advance(action) for action in actions(5)]
        runs.append(torch.cat([out.observation for out in outputs]))
    assert torch.equal(runs[0], runs[1])
    assert not torch.equal(runs[0], runs[2])


def test_setting_the_seed_again_begins_the_draws_anew(make_env):
    env = make_env()
    env.set_seed(3)
    first = env.reset()["observation"].clone()
    second = env.reset()["observation"].clone()
    env.set_seed(3)
    assert torch.equal(env.reset()["observation"], first)
    assert not torch.equal(first, second)


def test_an_environment_reset_alone_leaves_the_others_untouched_bit_for_bit(make_env):
    env = started(
        make_env("metric=[path_length,top_speed]", "randomization=[mass,inertia,thrust_map]")
    )
    for action in actions(3):
        env.advance(action)
    before, seen = snapshot(env), env.observation.clone()
    env.restart(torch.tensor([1]))
    after = snapshot(env)
    assert_same_world(before, after, rows=[0, 2, 3])
    assert torch.equal(env.observation[[0, 2, 3]], seen[[0, 2, 3]])
    assert not torch.equal(env.observation[1], seen[1])
    assert after[keys.CLOCK][:, 0].tolist() == [3, 0, 3, 3]


def test_torchrls_partial_reset_does_the_same(make_env):
    env = make_env()
    data = env.reset()
    for action in actions(3):
        data = env.step(data.set("action", action))["next"]
    before = snapshot(env)
    mask = torch.tensor([[False], [False], [True], [True]])
    fresh = env.reset(data.clone().set("_reset", mask))
    assert_same_world(before, snapshot(env), rows=[0, 1])
    assert torch.equal(fresh["observation"][:2], data["observation"][:2])
    assert not torch.equal(fresh["observation"][2:], data["observation"][2:])
    assert env.world[keys.CLOCK][:, 0].tolist() == [3, 3, 0, 0]


def test_restarting_nobody_changes_nothing(make_env):
    env = started(make_env())
    before = snapshot(env)
    env.restart(torch.empty(0, dtype=torch.int64))
    assert_same_world(before, snapshot(env))


def test_the_last_observation_of_an_episode_survives_the_restart(make_env):
    env = started(make_env())
    out = env.advance(actions(1)[0])
    last = out.observation.clone()
    env.restart(torch.arange(4))
    assert torch.equal(out.observation, last)


@pytest.mark.parametrize("num_envs", [3, 40])
def test_restarting_row_by_row_draws_the_same_as_restarting_all(make_env, num_envs):
    options = (f"num_envs={num_envs}", "randomization=[mass]")
    together = started(make_env(*options))
    one_by_one = make_env(*options)
    for row in range(num_envs):
        one_by_one.restart(torch.tensor([row]))
    assert_same_world(snapshot(together), snapshot(one_by_one))


def test_a_restored_world_goes_on_the_same_way(make_env):
    env = started(make_env("metric=[energy]"))
    env.advance(actions(1)[0])
    saved = snapshot(env)
    first = [env.advance(action) for action in actions(4, seed=1)]
    env.world = saved
    again = [env.advance(action) for action in actions(4, seed=1)]
    for a, b in zip(first, again, strict=True):
        assert all(torch.equal(x, y) for x, y in zip(a, b, strict=True))


def test_restoring_takes_a_copy(make_env):
    env = started(make_env())
    saved = snapshot(env)
    kept = saved.clone()
    env.world = saved
    env.advance(actions(1)[0])
    env.restart(torch.arange(4))
    assert_same_world(saved, kept)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_an_action_that_is_no_number_names_environment_and_step(make_env, bad):
    env = started(make_env())
    for action in actions(3):
        env.advance(action)
    action = torch.zeros(4, 4)
    action[2, 1] = bad
    with pytest.raises(NumericalError, match="environment 2 at step 3 of its episode"):
        env.advance(action)


def test_hovering_holds_the_height_but_for_the_published_bias(make_env):
    env = started(make_env(FREE, REST, "obstacle_observation=none"))
    height = env.value_of(keys.POSITION_W)[:, 2].clone()
    for _ in range(25):
        env.advance(torch.zeros(4, 4))
    drop = height - env.value_of(keys.POSITION_W)[:, 2]
    expected = (9.8 - 9.7946) * 0.5**2 / 2  # 0.055 % of gravity, for half a second
    assert_close(drop, torch.full((4,), expected), atol=2e-5, rtol=0)
    assert_close(env.value_of(keys.ATTITUDE_WB)[:, 1:3], torch.zeros(4, 2), atol=1e-5, rtol=0)


def test_a_random_mass_changes_the_motion_but_not_the_command(make_env):
    env = started(make_env(FREE, REST, "randomization=[mass]"))
    mass = env.value_of(keys.MASS)
    assert mass.unique().numel() == 4
    assert ((mass / 1.64 - 1).abs() <= 0.1).all()
    env.advance(torch.zeros(4, 4))
    expected = 1.64 * 9.7946 / mass[:, 0] - 9.8
    assert_close(env.value_of(keys.ACCELERATION_W)[:, 2], expected, atol=1e-4, rtol=0)


def test_removing_a_randomisation_leaves_the_draws_of_the_others_unchanged(make_env):
    both = started(make_env("randomization=[mass,inertia]")).world
    one = started(make_env("randomization=[inertia]")).world
    for key in (keys.INERTIA_B, keys.VELOCITY_W, keys.ATTITUDE_WB, keys.SCENE_INDEX, keys.ROUTE_W):
        assert torch.equal(both[key], one[key])
    assert not torch.equal(both[keys.MASS], one[keys.MASS])


def test_the_clock_truncates_and_ends_nothing_else(make_env):
    env = started(make_env(FREE, REST, "termination.time_limit.limit_s=0.1"))
    ends = [env.advance(torch.zeros(4, 4)) for _ in range(5)]
    assert not torch.cat([out.done for out in ends[:4]]).any()
    last = ends[4]
    assert last.truncated.all()
    assert last.done.all()
    assert not last.terminated.any()
    assert [env.stages.outcomes[i] for i in last.outcome[:, 0]] == ["time_limit"] * 4


def test_a_crash_terminates_and_is_no_truncation_even_at_the_time_limit(make_env):
    env = started(make_env(FREE, REST, "termination.time_limit.limit_s=0.1"))
    for _ in range(4):
        env.advance(torch.zeros(4, 4))
    world = snapshot(env)
    world[keys.POSITION_W][1, 2] = -0.5
    env.world = world
    out = env.advance(torch.zeros(4, 4))
    assert out.terminated[:, 0].tolist() == [False, True, False, False]
    assert out.truncated[:, 0].tolist() == [True, False, True, True]
    assert env.stages.outcomes[int(out.outcome[1])] == "height"


def test_a_finished_route_is_a_success(make_env):
    env = started(make_env(FREE, REST))
    world = snapshot(env)
    world[keys.ROUTE_INDEX][2] = world[keys.ROUTE_LENGTH][2] - 1
    world[keys.POSITION_W][2] = world[keys.ROUTE_W][2, -1]
    env.world = world
    out = env.advance(torch.zeros(4, 4))
    assert out.terminated[:, 0].tolist() == [False, False, True, False]
    assert env.stages.outcomes[int(out.outcome[2])] == "success"


def reward_terms(env, out):
    return dict(
        zip(
            [term.name for term in env.stages.terms.rewards],
            out.reward_terms.unbind(-1),
            strict=True,
        )
    )


def test_the_reward_is_the_sum_of_its_weighted_terms(make_env):
    env = started(make_env())
    for action in actions(5):
        out = env.advance(action)
        assert_close(out.reward[:, 0], sum(reward_terms(env, out).values()))
    weights = {term.name: term.weight for term in env.stages.terms.rewards}
    terms = reward_terms(env, out)
    assert_close(terms["time"], torch.full((4,), -weights["time"]))
    rate = env.value_of(keys.BODY_RATE_B).norm(dim=-1)
    assert_close(terms["body_rate"], -weights["body_rate"] * rate, atol=1e-5, rtol=0)


def test_an_ablated_reward_is_missing_from_the_sum_and_changes_nothing_else(make_env):
    full, ablated = started(make_env()), started(make_env("~reward.field_of_view"))
    for action in actions(3):
        with_term, without = full.advance(action), ablated.advance(action)
        share = reward_terms(full, with_term)["field_of_view"]
        assert_close(with_term.reward[:, 0] - share, without.reward[:, 0])
        assert torch.equal(with_term.observation, without.observation)


def test_a_crash_costs_once_and_hovering_on_costs_only_time_and_sight(make_env):
    env = started(make_env(FREE, REST))
    world = snapshot(env)
    world[keys.POSITION_W][0, 2] = 2.5
    env.world = world
    crash = reward_terms(env, env.advance(torch.zeros(4, 4)))["crash"]
    weight = next(term.weight for term in env.stages.terms.rewards if term.name == "crash")
    assert crash.tolist() == [-weight, 0.0, 0.0, 0.0]
    env.restart(torch.tensor([0]))
    assert reward_terms(env, env.advance(torch.zeros(4, 4)))["crash"].tolist() == [0.0] * 4


def test_metrics_start_at_zero_and_stand_still_after_the_finish(make_env):
    options = ("metric=[path_length]", "termination=[settled]", "task.initial_state.speed_mps=1.0")
    env = started(make_env(FREE, *options))
    assert env.value_of(("metric", "path_length")).abs().max() == 0
    env.advance(torch.zeros(4, 4))
    world = snapshot(env)
    world[keys.ROUTE_INDEX][0] = world[keys.ROUTE_LENGTH][0]
    env.world = world
    env.advance(torch.zeros(4, 4))  # the step that notices counts
    before = env.value_of(("metric", "path_length")).clone()
    env.advance(torch.zeros(4, 4))
    grew = env.value_of(("metric", "path_length")) > before
    assert grew[:, 0].tolist() == [False, True, True, True]


def test_the_scale_of_an_observation_multiplies_its_block_alone(make_env):
    plain, scaled = started(make_env()), started(make_env("observation.velocity.scale=0.5"))
    factor = torch.ones(45)
    factor[2:5] = 0.5
    assert_close(scaled.observation, plain.observation * factor)


def test_in_order_every_row_walks_through_its_own_entries(make_env):
    env = make_env("num_envs=3", in_order=True)
    seen = []
    for _ in range(4):
        env.restart(torch.arange(3))
        seen.append(env.value_of(keys.SCENE_INDEX)[:, 0].tolist())
    assert seen == [[0, 1, 2], [3, 4, 5], [6, 7, 0], [1, 2, 3]]
    env.restart(torch.tensor([1]))
    assert env.value_of(keys.SCENE_INDEX)[:, 0].tolist() == [1, 5, 3]


def test_no_episode_begins_in_a_closed_scene_and_renewal_names_the_rows_still_in_one(make_env):
    env = started(make_env("num_envs=16", closed=3))
    for _ in range(5):
        env.restart(torch.arange(16))
        closed = {(env.pool.head + i) % 8 for i in range(3)}
        assert not closed & set(env.value_of(keys.SCENE_INDEX)[:, 0].tolist())
        rows = env.renew(2)
        assert rows.numel() == 0
    entries = env.value_of(keys.SCENE_INDEX)[:, 0]
    rows = env.renew(8)
    assert rows.tolist() == list(range(16))
    assert len(entries) == 16


def test_reset_shows_the_route_of_the_scene_drawn(make_env):
    env = started(make_env(REST, "env.observation_frame=world", seed=4))
    entry = env.value_of(keys.SCENE_INDEX)[:, 0]
    assert torch.equal(env.value_of(keys.ROUTE_W), env.pool.tasks[keys.ROUTE_W][entry])
    assert torch.equal(env.value_of(keys.POSITION_W), env.pool.tasks[keys.START_W][entry])
    first = env.stages.observation_columns.index("control_points.first_x")
    offset = env.pool.tasks[keys.ROUTE_W][entry, 0] - env.pool.tasks[keys.START_W][entry]
    assert_close(env.observation[:, first : first + 3], offset)


def test_generator_states_bring_back_the_draws(make_env):
    env = started(make_env("randomization=[mass]"))
    states = env.generator_states()
    env.restart(torch.arange(4))
    first = snapshot(env)
    env.load_generator_states(states)
    env.restart(torch.arange(4))
    assert_same_world(first, snapshot(env))


def test_the_world_holds_only_finite_numbers_after_random_flight(make_env):
    env = started(make_env("randomization=[mass,inertia,thrust_map,action_delay]"))
    for action in 2.5 * actions(30):
        out = env.advance(action)
        rows = out.done[:, 0].nonzero()[:, 0]
        env.restart(rows)
        assert env.observation.isfinite().all()
    for key in env.world.keys(include_nested=True, leaves_only=True):
        assert env.world[key].isfinite().all(), key
