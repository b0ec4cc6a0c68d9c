"""Numbers that cannot be meant are refused in one sentence that names them."""

import math
import pickle

import pytest
from omegaconf import OmegaConf

from resc.errors import ConfigError, RescError
from resc.learning.training_run import TrainingRun
from resc.process import require_memory
from resc.setup import set_up

SMALL = (
    "num_envs=2",
    "pool_size=8",
    "renew_scenes=0",
    "algorithm.steps=2",
    "algorithm.minibatch=4",
)
EVERYTHING = (
    "sensor=[euler,limit_violations,clearance,surface_clearance]",
    "termination=[collision,contact,attitude,height,out_of_map,last_control_point,settled,time_limit]",
    "reward=[progress,point_progress,time,crash,collision,field_of_view,finish,clearance_margin,look_along_velocity]",
    "randomization=[mass,action_delay]",
    "metric=[least_clearance,time_within_half_metre]",
    "curriculum=linear",
)

CASES = {
    "env.dt_s": [10, 0, -0.02],
    "env.resolution_m": [0.0001, 100],
    "env.history": [0, 1000000],
    "env.layout": [3],
    "vehicle.mass_kg": [-1, 0, 100],
    "vehicle.inertia_kgm2": [[0.01, 0, 0.01]],
    "vehicle.torque_coefficient_m": [0],
    "vehicle.thrust_polynomial_n": [[0, 0, 0], [10, -5, 0]],
    "vehicle.arm_y_m": [[0.1]],
    "action.rate_limit_radps": [[120, 120, 60], [2, -2, 1]],
    "action.thrust_range_g": [[1.7, 0.3]],
    "action.gravity_mps2": [0],
    "action.longest_delay_steps": [-1, 100000000],
    "rate_loop.gains": [[-1, 0, 0]],
    "rate_loop.throttle_range": [[0.8, 0.3]],
    "rate_loop.torque_ratio": [0],
    "dynamics.substeps": [0, 1000000000],
    "dynamics.rotor_time_constant_s": [-1],
    "dynamics.drag_1ps": [-0.1],
    "task.control_points.radius_m": [0, 300],
    "task.control_points.half_height_m": [-0.2],
    "task.initial_state.speed_mps": [-1],
    "task.initial_state.tilt_rad": [17],
    "task.initial_state": [3],
    "scene.size_m": [1, -14],
    "scene.points": [0, 1000000000.0],
    "scene.spacing_m": [[2, 0.5]],
    "scene.turn_rad": [120],
    "scene.walls": [1.5],
    "scene.boxes": [-1, 200],
    "scene.guard_m": [-1, 50],
    "scene.height_m": [-1, 1e30],
    "scene.height_spread_m": [-0.1],
    "scene.side_m": [[0.8, 0.2]],
    "sensor.limit_violations.tilt_rad": [37.5],
    "sensor.limit_violations.speed_mps": [0],
    "observation.velocity.noise": [-0.1],
    "observation.velocity.clip": [0],
    "observation.velocity.scale": [math.inf, 1e30],
    "observation.velocity.history": [0],
    "observation.esdf_patch.side": [0, 100000],
    "observation.esdf_patch.spacing_m": [-1],
    "observation.kgp_esdf.truncation_m": [0.1],
    "observation.kgp_esdf.longest_guide_m": [0, 1000000000.0],
    "termination.collision.radius_m": [30],
    "termination.contact.radius_m": [-1],
    "termination.attitude.tilt_rad": [60],
    "termination.height.ceiling_m": [-1, 0.5],
    "termination.settled.after_s": [-1],
    "termination.time_limit.limit_s": [0, 0.001],
    "reward.progress.weight": ["heavy", math.nan, 1e30],
    "reward.progress.speed_mps": [0],
    "reward.point_progress.column_radius_m": [-0.5],
    "reward.point_progress.column_half_height_m": [0],
    "reward.collision.radius_m": [-0.3, 30],
    "reward.field_of_view.blind_m": [-1],
    "reward.field_of_view.horizontal_rad": [90],
    "reward.clearance_margin.margin_m": [0],
    "reward.look_along_velocity.slow_mps": [0],
    "reward": [3],
    "reward.progress": [3],
    "randomization.mass.spread": [1, -0.1],
    "randomization.action_delay.longest_steps": [-1, 9],
    "metric.time_within_half_metre.radius_m": [0],
    "model.hidden": [[0], [100000, 100000], 3],
    "algorithm.initial_std": [0],
    "model.activation": [5],
    "algorithm.steps": [0, 900000000],
    "algorithm.minibatch": [0, 1],
    "algorithm.epochs": [0, 1000000000],
    "algorithm.learning_rate": [0],
    "algorithm.final_learning_rate": [-1],
    "algorithm.gamma": [1.5],
    "algorithm.gae_lambda": [-0.1],
    "algorithm.clip_epsilon": [0, 1.0],
    "algorithm.max_grad_norm": [0],
    "algorithm.reward_scale": [0],
    "algorithm.target_kl": [-1],
    "algorithm.value_coefficient": [-1],
    "search.max_expansions": [0],
    "search.clearance_m": [-1],
    "search.nominal_m": [0],
    "search.spacing_m": [[2, 1]],
    "search.rule": ["best"],
    "search.method": [3, "theta_star"],
    "curriculum.obstacles.share": [0],
    "curriculum.obstacles.first": [2],
    "curriculum.obstacles.levels": [1, 1000000000],
    "num_envs": [0, -4, 100000000000],
    "pool_size": [0, 1000000000],
    "seed": [-1],
}
ELSEWHERE = {
    "scene.guard_m": "scene",
    "scene.height_m": "height",
    "termination.height.ceiling_m": "height",
}
"""What is named where a number is wrong only beside another."""


@pytest.fixture(scope="module")
def settings(compose):
    """All groups that take part in the cases, pickled: the fastest way to a copy."""
    law = "scene=training", "algorithm.schedule=linear"
    config = OmegaConf.to_container(compose(*SMALL, *law, *EVERYTHING), resolve=True)
    return pickle.dumps(OmegaConf.create(config))


def build_with(settings, path, value):
    """Builds a trainer with one setting changed."""
    changed = pickle.loads(settings)
    OmegaConf.update(changed, path, value, merge=False, force_add=True)
    return TrainingRun(changed).trainer()


@pytest.mark.parametrize("path", CASES)
def test_numbers_that_cannot_be_meant_are_refused_with_their_path(settings, path):
    name = ELSEWHERE.get(path, path.rpartition(".")[2])
    for value in CASES[path]:
        with pytest.raises(RescError) as caught:
            build_with(settings, path, value)
        message = str(caught.value)
        assert name in message
        assert "is not an argument" not in message
        assert "\n" not in message
        assert len(message) < 400


@pytest.mark.parametrize(
    ("scene", "overrides", "message"),
    [
        ("random_boxes", "scene.side_m=[0.8,0.2]", "side_m"),
        ("random_boxes", "scene.boxes=0", "boxes is 0"),
        ("random_boxes", "scene.keep_clear_m=-1", "keep_clear_m"),
        ("random_boxes", "scene.keep_clear_m=100", r"scene\.boxes is 200, but"),
        ("random_boxes", "scene.size_m=[2.0,20.0]", "size_m"),
        ("random_boxes", "scene.start_m=[0,0]", "start_m"),
        ("random_boxes", "scene.jitter_m=1e30", "jitter_m"),
        ("paper1_map11", "scene.jitter_m=-1", "jitter_m"),
        ("paper1_map11", "scene.goal_m=[100,0,1]", "goal_m"),
        ("paper1_map11", "scene.goal_m=[1.0,0.8,1.0]", r"Goal .* is inside an obstacle"),
        ("paper1_map11", "scene.size_m=[0,0]", "size_m"),
        ("paper1_map11", "scene.boxes=[[0,0,-1,1]]", r"boxes\[0\]"),
        ("paper1_map11", "scene.start_m=[1.0,2.0,-5.0]", r"ends in its first step \(height\)"),
    ],
)
def test_a_scene_that_cannot_be_meant_is_refused(compose, scene, overrides, message):
    config = compose(f"scene={scene}", overrides)
    with pytest.raises(RescError, match=message):
        set_up(config, size=8, seed=0).env(4, compiled=False)


SENSIBLE = {
    "reward.progress.weight": [0, -2.0],
    "observation.velocity.scale": [0.0, -1],
    "task.initial_state.speed_mps": [0],
    "scene.boxes": [0],
    "algorithm.entropy_coefficient": [-0.01],
    "algorithm.final_learning_rate": [0.0],
    "env.dt_s": [0.1, 0.002],
    "env.resolution_m": [0.25],
    "dynamics.substeps": [20],
    "model.hidden": [[]],
    "randomization.mass.spread": [0.0],
    "curriculum.obstacles.first": [0.5],
    "rate_loop.gains": [[0.15, 0.15, 0.0]],
    "vehicle.mass_kg": [0.8],
}


@pytest.mark.parametrize("path", SENSIBLE)
def test_numbers_of_studies_stay_allowed(settings, path):
    for value in SENSIBLE[path]:
        trainer = build_with(settings, path, value)
        assert all(math.isfinite(figure) for figure in trainer.iterate().values())


def test_what_this_machine_has_not_the_memory_for_is_refused_with_both_numbers():
    with pytest.raises(
        ConfigError, match=r"x is 1: that takes at least 1,024\.0 GiB, this machine"
    ):
        require_memory(2**40, "x is 1", "lower it")
    require_memory(2**20, "x is 1", "lower it")
