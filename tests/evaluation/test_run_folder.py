"""A finished run leaves a summary that any JSON reader takes, and a link that leads to it."""

import json
import math

import pytest

from resc.errors import ConfigError
from resc.evaluation.run_folder import finish_run, link_latest


@pytest.fixture
def folder(tmp_path):
    folder = tmp_path / "runs" / "2025-11-22" / "10-00-00_evaluate"
    folder.mkdir(parents=True)
    return folder


def test_latest_leads_to_the_newest_run(folder, tmp_path):
    link_latest(folder)
    newer = folder.parent / "10-05-00_train"
    newer.mkdir()
    link_latest(newer)
    latest = tmp_path / "runs" / "latest"
    assert latest.resolve() == newer.resolve()
    assert not latest.readlink().is_absolute()  # so that the folder may be moved
    assert sorted(path.name for path in latest.parent.iterdir()) == ["2025-11-22", "latest"]


def test_link_to_a_run_that_was_deleted_is_replaced(folder, tmp_path):
    (tmp_path / "runs" / "latest").symlink_to("gone")
    link_latest(folder)
    assert (tmp_path / "runs" / "latest").resolve() == folder.resolve()


def test_run_outside_runs_gets_no_link(tmp_path):
    link_latest(tmp_path / "elsewhere")
    assert list(tmp_path.iterdir()) == []


def test_folder_named_latest_is_left_alone(folder, tmp_path):
    (tmp_path / "runs" / "latest").mkdir()
    with pytest.raises(ConfigError, match="is no link"):
        link_latest(folder)


def test_summary_has_null_where_a_number_is_not_finite(folder):
    scenes = {"one": {"time_span_s": math.inf, "outcomes": [1, math.nan]}}
    finish_run(folder, {"frames": 10, "success_rate": 0.5, "scenes": scenes})
    text = (folder / "summary.json").read_text()
    assert json.loads(text) == {
        "frames": 10,
        "success_rate": 0.5,
        "scenes": {"one": {"time_span_s": None, "outcomes": [1, None]}},
    }
    assert [path.name for path in folder.iterdir()] == ["summary.json"]
