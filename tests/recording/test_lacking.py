"""Recordings that lack what a tool needs: a sentence that names it and says what to do."""

from unittest.mock import Mock

import polars as pl
import pytest
from small_run import record, rollout

from resc.envs.quadrotor import QuadrotorEnv
from resc.errors import RecordingError
from resc.evaluation.scene_files import _chosen
from resc.flying.replay import compare, fly_again
from resc.flying.transitions import transitions
from resc.recording import RolloutLog
from resc.viewing.episode_scene import load_scene
from resc.viewing.plot import draw_episode


@pytest.fixture
def log(tmp_path):
    """Recorded with the columns that the configuration file gives as an example."""
    return RolloutLog(record(tmp_path / "run", fields=["state", "action", "terminated"]))


def test_a_missing_column_is_named_with_who_needs_it(log, tmp_path):
    with pytest.raises(RecordingError, match=r"no column reward, which a picture needs; record"):
        draw_episode(log, 0, tmp_path / "episode.png")
    with pytest.raises(RecordingError, match=r"no column reward, which a scene needs"):
        load_scene(log, 0)
    with pytest.raises(RecordingError, match=r"no column sampled_action, which a dataset needs"):
        transitions(log.where())


def test_actions_alone_are_not_compared():
    env, steps = Mock(spec=QuadrotorEnv), rollout()[:, 0]
    with pytest.raises(RecordingError, match="holds only the actions"):
        compare(env, steps.select("action", "sampled_action"), 0, cut=False)
    with pytest.raises(RecordingError, match="no column sampled_action, which a replay needs"):
        compare(env, steps.exclude("sampled_action"), 0, cut=False)


def test_a_missing_or_foreign_configuration_is_named(tmp_path):
    without = record(tmp_path / "without", attachments={})
    with pytest.raises(RecordingError, match=r"has no attachment 'config.yaml'"):
        load_scene(RolloutLog(without), 0)
    other = record(tmp_path / "other")
    with pytest.raises(RecordingError, match="has no 'env', so it is not that of a run"):
        load_scene(RolloutLog(other), 0)
    with pytest.raises(RecordingError, match="has no 'device', so it is not that of a run"):
        fly_again(f"{other}#0")


def test_no_scene_is_chosen_of_flights_that_were_not_recorded():
    assert list(_chosen(pl.DataFrame({"success": [], "return_": [], "index": []}), 3)) == []
