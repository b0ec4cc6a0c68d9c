"""A recording is an experiment that can be repeated."""

import json

import pytest
import torch

from resc import keys
from resc.errors import ConfigError, RecordingError
from resc.flying.episodes import RENEWED
from resc.flying.replay import (
    compare,
    fly_again,
    parse,
    put_back,
    recorded_config,
    replay,
)
from resc.learning.progress import CsvLogger, ProgressTable
from resc.learning.training import train
from resc.learning.training_run import TrainingRun
from resc.recording.reader import RolloutLog
from resc.scenes.pool import layout_from
from resc.setup import among, build_stages

RUN = (
    "num_envs=8",
    "pool_size=16",
    "renew_scenes=2",
    "total_frames=768",
    "obstacle_observation=none",
    "algorithm.steps=16",
    "algorithm.minibatch=64",
    "model.hidden=[16]",
    "recorder=mcap",
)
LATER = ("pillars_w", "start_motion")
"""Arrays of scenes that older recordings lack."""
EVERYTHING = (
    "randomization=[mass,inertia,thrust_map,torque_coefficient,action_delay]",
    "rate_loop=torque",
    "dynamics=lag_and_drag",
    "curriculum=linear",
    "env.history=2",
    "observation.velocity.noise=0.1",
)
SEEN = ("sensing=depth", "replanning=in_flight")
PX4 = ("rate_loop=px4", "vehicle=iris_px4", "dynamics=gazebo")
MOVING = (
    "scene=dynamic_training",
    "sensing=lidar2d",
    "sensing.beams=60",
    "sensing.fade=2",
    "replanning=in_flight",
    "observation=[velocity,attitude,body_rate,control_points,nearest_movers]",
    "total_frames=384",
)


def recorded(config, folder):
    """The recording of a short training run."""
    trainer = TrainingRun(config).trainer()
    with TrainingRun(config).recorded.open(
        trainer.env.stages,
        directory=folder / "rollouts",
        outcomes=trainer.statistics.outcomes,
        num_envs=8,
    ) as recorder:
        train(
            trainer,
            folder,
            total_frames=config["total_frames"],
            recorder=recorder,
            logger=CsvLogger(folder=folder),
            table=ProgressTable(folder / "progress.csv"),
            checkpoint_every_s=1e9,
        )
    return folder / "rollouts"


@pytest.fixture(scope="module")
def recording(compose, tmp_path_factory):
    """The folder of a short training run's recording."""
    return recorded(compose(*RUN, "scene=training"), tmp_path_factory.mktemp("run"))


@pytest.mark.slow
def test_an_episode_among_movers_comes_out_again_bit_for_bit(compose, tmp_path):
    recording = recorded(compose(*RUN, *MOVING), tmp_path)
    log = RolloutLog(recording)
    length = log.episodes["length"]
    number = int(length.arg_max())
    assert log.scene(number)["movers_w"].shape == (12, 10)
    result = fly_again(f"{recording}#{number}")
    assert result.largest == 0.0, result.report()
    assert result.steps == length[number] > 20


@pytest.mark.parametrize(
    "parts",
    [
        pytest.param(EVERYTHING, id="everything"),
        pytest.param(PX4, id="px4", marks=pytest.mark.slow),
        pytest.param(SEEN, id="seen", marks=pytest.mark.slow),
    ],
)
def test_an_episode_of_other_parts_comes_out_again_bit_for_bit(compose, parts, tmp_path):
    few = "total_frames=512"
    recording = recorded(compose(*RUN, "scene=training", *parts, few), tmp_path)
    episodes = RolloutLog(recording).episodes
    number = int((episodes["outcome"] == RENEWED).arg_max())
    result = fly_again(f"{recording}#{number}")
    assert result.largest == 0.0, result.report()
    assert result.steps == episodes["length"][number] > 0


def test_an_episode_of_a_training_run_comes_out_again_bit_for_bit(recording):
    episodes = RolloutLog(recording).episodes
    assert len(episodes) > 5
    assert RENEWED in set(episodes["outcome"])
    cut = int((episodes["outcome"] == RENEWED).arg_max())
    for number in (0, cut, len(episodes) - 1):
        result = fly_again(f"{recording}#{number}")
        assert result.largest == 0.0, result.report()
        assert result.steps == episodes["length"][number]


def test_an_episode_recorded_before_there_were_pillars_comes_out_again(recording):
    log = RolloutLog(recording)
    old = {n: a.unsqueeze(0) for n, a in log.scene(0).items() if n not in LATER}
    assert len(old) == len(log.scene(0)) - len(LATER)
    config = recorded_config(log)
    setup = among(layout_from(old), build_stages(config), config["device"])
    env = setup.env(8, compiled=config["compile"], in_order=True)
    put_back(env, log.start(0))
    row = int(log.episodes["env_id"][0])
    deviations = compare(env, log.episode(0), row, cut=log.episodes["outcome"][0] == RENEWED)
    assert max(deviations.values()) == 0.0


@pytest.mark.slow
def test_another_action_is_noticed(recording):
    log = RolloutLog(recording)
    number = int(log.episodes["length"].arg_max())
    steps = log.episode(number)
    steps["sampled_action"][3] += 0.1
    result = fly_again(f"{recording}#{number}")
    env, row = result.env, int(log.episodes["env_id"][number])
    put_back(env, log.start(number))
    deviations = compare(env, steps, row, cut=False)
    assert deviations[keys.BODY_RATE_B] > 1e-3
    assert deviations[keys.REWARD] > 0
    with pytest.raises(RecordingError, match="no column sampled_action, which a replay needs"):
        compare(env, steps.exclude("sampled_action"), row, cut=False)
    assert keys.REWARD not in compare(env, steps.exclude("reward"), row, cut=False)


def test_a_start_of_another_simulator_is_refused_by_its_parts(recording):
    log = RolloutLog(recording)
    start = log.start(0)
    del start["params", "mass"]
    env = fly_again(f"{recording}#0").env
    with pytest.raises(RecordingError, match=r"differ in params\.mass; replay with the version"):
        put_back(env, start)


def test_an_episode_that_is_not_there_is_refused(recording):
    with pytest.raises(RecordingError, match="There is no episode 9999"):
        fly_again(f"{recording}#9999")


def test_a_report_and_a_summary_are_left(recording, tmp_path):
    text = replay(f"{recording}#1", tmp_path / "out")
    assert "came out again bit for bit." in text
    assert text in (tmp_path / "out" / "replay.md").read_text()
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["largest_deviation"] == 0.0
    assert summary["replay"] == f"{recording}#1"


def test_the_recorded_scene_is_the_one_that_the_episode_began_in(recording):
    log = RolloutLog(recording)
    for number in range(len(log)):
        goal = log.scene(number)["route_w"][-1]  # where routes are renewed, their goal stays
        assert torch.equal(log.start(number)[keys.ROUTE_W][-1], goal)


@pytest.mark.parametrize("location", ["runs/latest", "runs/latest#", "#3", "runs/latest#best"])
def test_a_location_without_file_or_episode_is_refused(location):
    with pytest.raises(ConfigError, match="expected FILE#EPISODE"):
        parse(location)
