"""The folder of a run: one process owns it, its summary is JSON, links lead to the newest."""

import json
import math
import multiprocessing

import pytest

from resc.errors import ConfigError
from resc.run_folder import claimed, finish_run, latest, link_latest, new_folder, unfinished


@pytest.fixture
def folder(tmp_path):
    folder = tmp_path / "runs" / "2025-11-22" / "10-00-00_evaluate"
    folder.mkdir(parents=True)
    return folder


def test_latest_leads_to_the_newest_run(folder, tmp_path):
    link_latest(folder, "train")
    newer = folder.parent / "10-05-00_train"
    newer.mkdir()
    link_latest(newer, "train")
    latest = tmp_path / "runs" / "latest"
    assert latest.resolve() == newer.resolve()
    assert not latest.readlink().is_absolute()  # so that the folder may be moved
    assert sorted(path.name for path in latest.parent.iterdir()) == [
        "2025-11-22",
        "latest",
        "latest_train",
    ]


def test_link_to_a_run_that_was_deleted_is_replaced(folder, tmp_path):
    (tmp_path / "runs" / "latest").symlink_to("gone")
    link_latest(folder, "train")
    assert (tmp_path / "runs" / "latest").resolve() == folder.resolve()


def test_run_outside_runs_gets_no_link(tmp_path):
    link_latest(tmp_path / "elsewhere", "train")
    assert list(tmp_path.iterdir()) == []


def test_folder_named_latest_is_left_alone(folder, tmp_path):
    (tmp_path / "runs" / "latest").mkdir()
    with pytest.raises(ConfigError, match="is a file or folder, not a link"):
        link_latest(folder, "train")


def test_summary_has_null_where_a_number_is_not_finite(folder):
    scenes = {"one": {"time_span_s": math.inf, "outcomes": [1, math.nan]}}
    finish_run(folder, {"frames": 10, "success_rate": 0.5, "scenes": scenes}, "train")
    text = (folder / "summary.json").read_text()
    assert json.loads(text) == {
        "frames": 10,
        "success_rate": 0.5,
        "scenes": {"one": {"time_span_s": None, "outcomes": [1, None]}},
    }
    assert [path.name for path in folder.iterdir()] == ["summary.json"]


def test_each_kind_of_run_has_a_link_that_others_leave_alone(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folders = {}
    for kind in ("train", "sweep", "evaluation", "replay"):
        folders[kind] = tmp_path / "runs" / "2025-11-22" / kind
        folders[kind].mkdir(parents=True)
        link_latest(folders[kind], kind)
    for kind, folder in folders.items():
        assert latest("policy", kind) == folder
    assert (tmp_path / "runs" / "latest").resolve() == folders["replay"]
    assert latest("resume", "train", "sweep") == folders["sweep"]


def test_latest_without_a_run_is_one_sentence(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match="policy=latest, but there is no runs/latest_train"):
        latest("policy", "train")


def ask_for(wanted, answers):
    answers.put(new_folder(wanted))


def test_runs_of_the_same_second_get_a_folder_each(tmp_path):
    wanted = str(tmp_path / "runs" / "10-00-00_train")
    context = multiprocessing.get_context("fork")
    answers = context.Queue()
    children = [context.Process(target=ask_for, args=(wanted, answers)) for _ in range(4)]
    for child in children:
        child.start()
    found = {answers.get(timeout=30) for _ in children}
    for child in children:
        child.join(30)
    assert found == {wanted, f"{wanted}_2", f"{wanted}_3", f"{wanted}_4"}


def test_one_process_gets_the_same_folder_whenever_it_asks(tmp_path):
    wanted = str(tmp_path / "10-00-00_train")
    assert new_folder(wanted) == new_folder(wanted)


def test_folder_that_holds_a_run_is_refused_and_left_as_it_is(tmp_path):
    (tmp_path / "config.yaml").write_text("seed: 3")
    with pytest.raises(ConfigError, match="holds a run already"), claimed(tmp_path):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["config.yaml"]


def test_folder_that_is_being_written_to_is_refused(tmp_path):
    again = claimed(tmp_path, resumes=True)
    with claimed(tmp_path), pytest.raises(ConfigError, match="by another process"), again:
        pass


def test_run_that_fails_before_it_writes_leaves_no_folder(tmp_path):
    folder = tmp_path / "runs" / "one"
    with pytest.raises(ConfigError, match="wrong"), claimed(folder):
        raise ConfigError("wrong")
    assert not folder.exists()


def test_folder_that_cannot_be_made_is_one_sentence(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot be written to"), claimed(tmp_path / "file"):
        pass
    with pytest.raises(ConfigError, match="cannot be written to"):
        new_folder("/proc/nope/run")


def test_a_training_is_unfinished_from_its_first_checkpoint_to_its_summary(tmp_path):
    assert not unfinished(tmp_path)
    (tmp_path / "checkpoint.pt").touch()
    assert unfinished(tmp_path)
    (tmp_path / "summary.json").touch()
    assert not unfinished(tmp_path)
