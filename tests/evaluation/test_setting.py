"""The policy brings its vehicle and senses, the evaluation its task and rules."""

import pytest
import torch

from resc import keys
from resc.errors import CheckpointError
from resc.evaluation.courses import lay_out
from resc.evaluation.setting import Rules
from resc.policies.stored import StoredPolicy

FREE = {"_target_": "resc.scenes.training.TrainingScene", "boxes": 0}


def test_vehicle_and_observation_are_the_policys(evaluation, stored):
    altered = stored.copy()
    altered["vehicle"]["mass_kg"] = 2.5
    rules = Rules(evaluation(), altered, own_routes=False).settings
    assert rules["vehicle"]["mass_kg"] == 2.5
    assert rules["observation"] == altered["observation"]
    assert rules["task"]["initial_state"]["speed_mps"] == 0.0
    assert "contact" in rules["termination"]
    assert "collision" not in rules["termination"]


def test_scenes_with_routes_keep_the_rules_of_the_training(evaluation, stored):
    rules = Rules(evaluation(), stored, own_routes=True).settings
    assert rules["task"] == stored["task"]
    assert rules["termination"] == stored["termination"]
    assert "least_clearance" in rules["metric"]


def test_limits_are_the_evaluations_and_senses_the_policys(evaluation, stored):
    altered = stored.copy()
    altered["sensor"]["limit_violations"]["speed_mps"] = 9.0
    altered["sensor"]["euler"] = {"_target_": "noisy"}
    sensors = Rules(evaluation(), altered, own_routes=False).settings["sensor"]
    assert sensors["limit_violations"]["speed_mps"] == 3.0
    assert sensors["euler"] == {"_target_": "noisy"}


def test_a_sensor_of_any_name_that_judges_is_the_evaluations(evaluation, stored):
    own, altered = evaluation(), stored.copy()
    own["sensor"]["mine"] = {**own["sensor"]["limit_violations"], "speed_mps": 4.0}
    altered["sensor"]["mine"] = {**own["sensor"]["mine"], "speed_mps": 9.0}
    sensors = Rules(own, altered, own_routes=False).settings["sensor"]
    assert sensors["mine"]["speed_mps"] == 4.0


def test_part_named_on_the_command_line_replaces_the_policys(evaluation, stored):
    chosen = evaluation("dynamics=lag_and_drag")
    rules = Rules(chosen, stored, own_routes=False).settings
    assert rules["dynamics"]["rotor_time_constant_s"] == 0.02


def test_a_vehicle_stored_without_gains_has_those_of_its_file_for_another_rate_loop(
    evaluation, stored
):
    old = stored.copy()
    old["vehicle"].pop("controllers", None)
    assert "controllers" not in Rules(evaluation(), old, own_routes=False).settings["vehicle"]
    px4 = evaluation("rate_loop=px4")
    assert "px4" in Rules(px4, old, own_routes=False).settings["vehicle"]["controllers"]
    old["vehicle"]["mass_kg"] = 1.7
    assert "controllers" not in Rules(px4, old, own_routes=False).settings["vehicle"]


def test_flights_begin_at_rest_where_their_scene_says(corridor, flying):
    course = corridor(3)
    env = flying([course])
    env.restart(torch.arange(3))
    torch.testing.assert_close(env.value_of(keys.POSITION_W), course.layout.start_w)
    assert (env.value_of(keys.VELOCITY_W) == 0).all()


def test_maps_of_different_size_fly_together(corridor, flying):
    small = corridor(1)
    large = corridor(1, size_m=[9.0, 7.0])
    env = flying([small, large])
    env.restart(torch.arange(2))
    assert env.pool.shared[keys.ESDF].shape == (2, 70, 90)
    world = env.world
    world[keys.POSITION_W] = torch.tensor([[5.9, 2.0, 1.0], [8.5, 6.5, 1.0]])
    env.world = world
    assert env.advance(torch.zeros(2, 4)).terminated[:, 0].tolist() == [False, False]
    world[keys.POSITION_W][0, 0] = 6.1  # beyond the small map, within the padding
    env.world = world
    assert env.advance(torch.zeros(2, 4)).terminated[:, 0].tolist() == [True, False]


def test_policy_of_another_observation_is_refused(evaluation, stored, policy):
    course = lay_out({"free": FREE}, 1, seed=0, planner=None)[0]
    env = Rules(evaluation(), stored, own_routes=True).env([course])
    wrong = (policy.layout[0], ("compass", 2), *policy.layout[2:])
    with pytest.raises(CheckpointError, match=f"compass .*{policy.layout[1][0]}"):
        StoredPolicy(policy.policy, wrong, stored).require_layout(env.stages)
