"""The folder of a sweep: whose a run is, how it goes on, whether it is still what it was."""

import json
import shlex

import pytest
from omegaconf import OmegaConf

from resc.errors import ConfigError
from resc.sweep_folder import (
    arguments_of,
    begun_as,
    difference,
    go_on,
    origin_of,
    require_as_begun,
    sweep_of,
)

CONFIG = {"seed": 0, "total_frames": 512, "resume": None, "model": {"hidden": [16], "k": "${seed}"}}


@pytest.fixture
def run(tmp_path):
    """A run of a sweep, as it was begun."""
    folder = tmp_path / "sweep" / "1"
    folder.mkdir(parents=True)
    command = "python train.py -m 'allowed_targets=[mine.]' seed=0,1"
    (folder.parent / "origin.json").write_text(json.dumps({"command": command}))
    (folder / "job.json").write_text(json.dumps({"overrides": ["seed=0"], "config": CONFIG}))
    return folder


def test_run_of_a_sweep_goes_on_with_the_sweep(run, tmp_path):
    assert sweep_of(run) == run.parent
    assert shlex.split(go_on(run)) == [
        "python",
        "train.py",
        f"resume={run.parent}",
        "allowed_targets=[mine.]",
    ]
    assert go_on(run) == go_on(run.parent)


def test_run_that_stands_alone_goes_on_itself_with_what_it_was_permitted(run, tmp_path):
    alone = run.rename(tmp_path / "alone")
    assert sweep_of(alone) is None
    assert sweep_of(tmp_path / "none") is None
    assert shlex.split(go_on(alone, ["mine."]))[2:] == [
        f"resume={alone}",
        'allowed_targets=["mine."]',
    ]


def test_run_that_is_as_it_was_begun_passes(run):
    require_as_begun(run)  # it has no configuration yet
    changes = {"resume": str(run), "model": {"hidden": [16], "k": 0}}
    OmegaConf.save(OmegaConf.create({**CONFIG, **changes}), run / "config.yaml")
    require_as_begun(run)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"total_frames": 1024}, "says total_frames: 1024, but its sweep began the run with 512"),
        ({"model": {"hidden": [8], "k": 0}}, r"says model\.hidden: \[8\]"),
        ({"threads": 2}, "says threads: 2, but its sweep began the run with nothing"),
    ],
)
def test_run_that_went_on_as_something_else_is_refused(run, changes, told):
    OmegaConf.save(OmegaConf.create({**CONFIG, **changes}), run / "config.yaml")
    with pytest.raises(ConfigError, match=told):
        require_as_begun(run)


def test_numbers_are_the_same_however_they_are_written():
    assert difference({"a": 1, "b": {"c": [2.0]}}, {"a": 1.0, "b": {"c": [2]}}) is None
    assert difference({"a": 1}, {"b": 1}) == ("a", 1, "nothing")


@pytest.mark.parametrize(
    "content", [b"trash", b"\xff\xfe", b"[1]", b"{", b'{"overrides": "a"}', b"null"]
)
def test_damaged_description_of_a_run_is_named(run, content):
    (run / "job.json").write_bytes(content)
    with pytest.raises(ConfigError, match=r"job\.json .*; delete the folder and go on"):
        begun_as(run)


@pytest.mark.parametrize("content", [b"trash", b"\xff\xfe", b"[1]", b"{", b'{"command": "a \'"}'])
def test_damaged_origin_is_named(run, content):
    (run.parent / "origin.json").write_bytes(content)
    with pytest.raises(ConfigError, match=r"origin\.json .* start a new"):
        arguments_of(run.parent)


def test_sweep_without_an_origin_has_none(tmp_path):
    assert origin_of(tmp_path) == {}
    assert arguments_of(tmp_path) == []


def test_class_that_has_moved_since_is_no_difference():
    old, new = (
        {"_target_": f"resc.{room}.networks.build_networks"} for room in ("learning", "policies")
    )
    assert difference({"model": old}, {"model": new}) is None
    other = {"_target_": "resc.policies.networks.Other"}
    assert difference({"model": old}, {"model": other}) is not None


def test_weights_that_a_run_begins_with_are_the_same_however_far_their_path_is_written(run):
    job = json.loads((run / "job.json").read_text())
    config = {**job["config"], "init_from": "../policies/obstacles"}
    (run / "job.json").write_text(json.dumps({**job, "config": config}))
    OmegaConf.save({**config, "init_from": "/x/policies/obstacles"}, run / "config.yaml")
    require_as_begun(run)
    OmegaConf.save({**config, "init_from": "/x/policies/dial"}, run / "config.yaml")
    with pytest.raises(ConfigError, match="says init_from: /x/policies/dial, but"):
        require_as_begun(run)
