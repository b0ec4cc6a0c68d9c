"""The limits of an evaluation are asked of a policy that observes them, and of no other."""

import json

import pytest
import torch
from omegaconf import OmegaConf

from resc import keys
from resc.errors import ConfigError
from resc.evaluation.campaign import Evaluation
from resc.evaluation.commanded import commanded_scenes, dial_of
from resc.evaluation.courses import lay_out
from resc.evaluation.references import limits_of
from resc.evaluation.setting import Rules
from resc.flying.replay import fly_again
from resc.planning.route import planner_for
from resc.policies.stored import StoredPolicy
from resc.recording.reader import RolloutLog
from resc.viewing.plot import inflation_m

CORRIDOR = {
    "_target_": "resc.scenes.named.NamedScene",
    "boxes": [[2.5, 0.0, 0.5, 0.5]],
    "start_m": [1.0, 2.2, 1.0],
    "goal_m": [4.5, 2.2, 1.0],
    "origin_m": [0.0, 0.0],
    "size_m": [6.0, 4.0],
    "jitter_m": 0.05,
}
ASKED = ("limits.speed_mps=2.0", "limits.margin_m=0.4")


@pytest.fixture(scope="module")
def with_dial(compose):
    """The configuration of a policy that was trained with the dial."""
    few = (
        "obstacle_observation=none",
        "reward=[progress,time]",
        "termination.time_limit.limit_s=1.0",
    )
    config = compose("+experiment=dial", *few)
    return OmegaConf.to_container(config, resolve=True)


@pytest.fixture(scope="module")
def dial_policy(policy_for, with_dial):
    """The pilot as a policy with a dial, which it does not look at."""
    return policy_for(OmegaConf.create(with_dial))


def own_dial(stored):
    return dial_of(stored.get("randomization"), stored.get("observation"))


def asked(evaluation, stored, policy, *overrides):
    config = evaluation(*overrides)
    policy = StoredPolicy(policy.policy, policy.layout, OmegaConf.create(stored))
    return Evaluation(config, policy, {}, overrides).asked


def test_a_dial_is_what_is_drawn_and_seen(with_dial, stored):
    dial = own_dial(with_dial)
    assert dial.speed.speed_mps == (1.2, 4.5)
    assert dial.margin.margin_m == (0.15, 0.45)
    blind = {k: v for k, v in with_dial["observation"].items() if k != "limits"}
    assert own_dial({**with_dial, "observation": blind}) is None
    assert own_dial(stored) is None


def test_limits_fix_the_draws_the_count_and_the_search(evaluation, with_dial, policy):
    config = asked(evaluation, with_dial, policy, *ASKED)
    assert config["randomization"]["speed_limit"]["speed_mps"] == [2.0, 2.0]
    assert config["randomization"]["margin"]["margin_m"] == [0.4, 0.4]
    assert config["sensor"]["limit_violations"]["speed_mps"] == 2.0
    assert config["search"]["clearance_m"] == 0.5
    assert (
        asked(evaluation, with_dial, policy, "limits.margin_m=0.2")["search"]["clearance_m"] == 0.3
    )


def test_the_speed_that_is_counted_turns_the_dial_as_the_bound_follows_it(
    evaluation, with_dial, policy
):
    config = asked(evaluation, with_dial, policy, "sensor.limit_violations.speed_mps=2.5")
    assert config["randomization"]["speed_limit"]["speed_mps"] == [2.5, 2.5]


def test_a_clearance_that_is_given_stays(evaluation, with_dial, policy):
    config = asked(evaluation, with_dial, policy, *ASKED, "search.clearance_m=0.45")
    assert config["search"]["clearance_m"] == 0.45


def test_scenes_that_plan_their_own_routes_keep_the_margin_too(evaluation, with_dial, policy):
    config = evaluation(*ASKED)
    scenes = {"planned": {"clearance_m": [0.35, 0.5]}, "named": {}}
    limits = limits_of(config["limits"])
    kept = commanded_scenes(scenes, own_dial(with_dial), limits)
    assert kept == {"planned": {"clearance_m": [0.5, 0.5]}, "named": {}}


@pytest.mark.parametrize(
    ("override", "told"),
    [
        (
            "limits.speed_mps=5.0",
            "limits.speed_mps is 5, but the policy was trained from 1.2 to 4.5",
        ),
        ("limits.margin_m=0.1", "limits.margin_m is 0.1, but the policy was trained from 0.15 to"),
    ],
)
def test_settings_outside_of_what_was_trained_are_refused(
    evaluation, with_dial, policy, override, told
):
    with pytest.raises(ConfigError, match=told):
        asked(evaluation, with_dial, policy, override)


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("limits.speed_mps=2.0", "limits.speed_mps is 2, but the policy does not observe its lim"),
        ("limits.margin_m=0.2", "limits.margin_m is 0.2, .* it was trained with 0.3; leave it out"),
    ],
)
def test_a_policy_without_the_dial_is_asked_nothing(evaluation, stored, policy, override, told):
    with pytest.raises(ConfigError, match=told):
        asked(evaluation, stored, policy, override)


@pytest.mark.parametrize(
    "override", ["flights=3", "sensor.limit_violations.speed_mps=2.0", "limits.jerk_mps3=30.0"]
)
def test_without_the_dial_nothing_changes(evaluation, stored, policy, override):
    assert asked(evaluation, stored, policy, override) == evaluation(override)


def test_every_flight_has_the_limits_that_are_asked(evaluation, with_dial, policy):
    config = asked(evaluation, with_dial, policy, *ASKED)
    nodes = {name: with_dial[name] for name in ("search", "task", "env")}
    courses = lay_out({"corridor": CORRIDOR}, 2, seed=0, planner=planner_for(**nodes))
    env = Rules(config, with_dial, own_routes=False).env(courses)
    env.restart(torch.arange(2))
    assert env.value_of(keys.SPEED_LIMIT)[:, 0].tolist() == [2.0, 2.0]
    assert torch.equal(env.value_of(keys.MARGIN), torch.full((2, 1), 0.4))


@pytest.fixture(scope="module")
def flown(evaluation, dial_policy, tmp_path_factory):
    """A recorded evaluation of the policy at 1.5 m/s and 0.2 m: its folder and its report."""
    folder = tmp_path_factory.mktemp("dial") / "runs" / "2025-11-22" / "10-00-00_evaluate"
    overrides = ["limits.speed_mps=1.5", "limits.margin_m=0.2", "flights=1", "scene_files=0"]
    short = "termination.time_limit.limit_s=2.0"
    config = evaluation("recorder=mcap", "policy=somewhere", short, *overrides)
    planned = {"planned": evaluation("+scene=planned")["scene"]}
    scenes = {"corridor": CORRIDOR, **planned}
    return folder, Evaluation(config, dial_policy, scenes, overrides).fly(folder)


def test_the_report_counts_by_the_limits_that_are_asked(flown):
    folder, text = flown
    assert "closer than 0.2 m [%]" in text
    assert "a limit above 1.5 m/s" in " ".join(text.split())
    report = json.loads((folder / "summary.json").read_text())["scenes"]["corridor"]
    assert report["over_limit_share"] > 0.2  # the pilot wants 2 m/s
    assert report["time_over_bound"] is None


def test_a_flight_with_the_dial_is_replayed_bit_for_bit(flown):
    folder, _ = flown
    replayed = fly_again(f"{folder / 'rollouts'}#0")
    assert replayed.largest == 0
    assert replayed.env.value_of(keys.SPEED_LIMIT)[0].item() == 1.5
    assert replayed.env.value_of(keys.MARGIN)[0].item() == pytest.approx(0.2)
    own = next(folder.glob("rollouts_own_routes"))
    assert fly_again(f"{own}#0").largest == 0


def test_the_picture_of_an_episode_shows_its_own_margin(flown):
    folder, _ = flown
    log = RolloutLog(folder / "rollouts_own_routes")
    assert inflation_m(log, 0) == pytest.approx(0.2)
