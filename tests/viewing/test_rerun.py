"""Rerun recordings, where Rerun is installed."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from street import copy_of, fly_street

from resc import keys
from resc.scenes.layout import PARKED_M
from resc.viewing.episode_scene import load_scene
from resc.viewing.foxglove import write_scene

rr = pytest.importorskip("rerun", reason="the extra 'rerun' is not installed")


@pytest.fixture(scope="module")
def log(compose, tmp_path_factory):
    """Two flights along the street, recorded."""
    config = compose("num_envs=2", "recorder=mcap", "task=from_rest")
    return fly_street(config, tmp_path_factory.mktemp("street"))


@pytest.fixture(scope="module")
def path(log, tmp_path_factory):
    from resc.viewing.rerun_scene import write_rerun  # needs Rerun

    return write_rerun(log, 1, tmp_path_factory.mktemp("scenes") / "scene.rrd")


@pytest.fixture(scope="module")
def chunks(path):
    """Chunks by entity, as Rerun reads them back."""
    found: dict[str, list] = {}
    for chunk in rr.chunk.RrdReader(path).stream():
        found.setdefault(str(chunk.entity_path), []).append(chunk)
    return found


def rerun(*arguments):
    program = Path(sys.executable).with_name("rerun")
    return subprocess.run([program, *arguments], capture_output=True, text=True, timeout=60)


def test_rerun_verifies_its_recording_and_the_scene_file(log, path, tmp_path):
    done = rerun("rrd", "verify", path)
    assert done.returncode == 0
    assert "1 file verified without error" in done.stdout + done.stderr
    scene = write_scene(log, 1, tmp_path / "scene.mcap")
    told = rerun("mcap", "info", scene).stdout
    steps = len(log.episode(1))
    assert [line.split()[2] for line in told.splitlines() if "/drone/pose" in line] == [str(steps)]


def times_and_values(chunks, entity, component):
    """Seconds and values of one component, in the order of time."""
    rows = []
    for chunk in chunks[entity]:
        table = chunk.to_record_batch().to_pydict()
        if component in table and "time" in table:
            rows += zip(table["time"], table[component], strict=True)
    rows.sort(key=lambda row: row[0])
    return [time.total_seconds() for time, _ in rows], [value for _, value in rows]


def test_body_moves_as_recorded(log, chunks):
    times, places = times_and_values(chunks, "/drone", "Transform3D:translation")
    flight = log.episode(1)
    np.testing.assert_allclose(times, np.arange(len(flight)) * 0.02, atol=1e-9)
    np.testing.assert_array_equal(np.array(places)[:, 0], flight[keys.POSITION_W].numpy())
    _, turns = times_and_values(chunks, "/drone", "Transform3D:quaternion")
    wxyz = flight[keys.ATTITUDE_WB].numpy()
    np.testing.assert_array_equal(np.array(turns)[:, 0], wxyz[:, [1, 2, 3, 0]])


def test_curves_are_true_and_commanded_numbers(log, chunks):
    flight = log.episode(1)
    _, true = times_and_values(chunks, "/state/body_rate/y", "Scalars:scalars")
    np.testing.assert_array_equal(np.array(true)[:, 0], flight[keys.BODY_RATE_B][:, 1].numpy())
    _, commanded = times_and_values(chunks, "/command/body_rate/y", "Scalars:scalars")
    assert commanded[0][0] == pytest.approx(0.05 * 2.0944)


def test_scene_observation_and_log_are_there(log, chunks):
    steps = len(log.episode(1))
    still = ("/world/obstacles", "/map/esdf", "/plan/path", "/drone/rotors")
    assert all(any(chunk.is_static for chunk in chunks[name]) for name in still)
    sight = "/observation/kgp_esdf/edges_beside_the_velocity"
    times, lines = times_and_values(chunks, sight, "LineStrips3D:strips")
    assert len(times) == steps
    scene = load_scene(log, 1)
    end = scene.sights["kgp_esdf"][0].places[-1, 0].tolist()
    assert lines[-1][0][0] == scene.column(keys.POSITION_W)[-1].tolist()
    assert lines[-1][0][1][:2] == end
    times, texts = times_and_values(chunks, "/log", "TextLog:text")
    assert texts[-1][0].startswith(log.episodes["outcome"][1])
    assert times[-1] == pytest.approx(steps * 0.02)


def test_pillars_are_round(log, tmp_path):
    from resc.viewing.rerun_scene import write_rerun

    pillars = torch.tensor([[2.5, 0.4, 0.25], [PARKED_M, PARKED_M, 0.0]]).expand(2, 2, 3)
    run = copy_of(log, tmp_path / "run", world={**log.world, "pillars_w": pillars})
    path = write_rerun(run, 0, tmp_path / "scene.rrd")
    entities = {str(chunk.entity_path) for chunk in rr.chunk.RrdReader(path).stream()}
    assert "/world/pillars" in entities


def test_movers_are_where_they_are_in_each_step(log, tmp_path):
    from resc.viewing.rerun_scene import write_rerun

    there = [[2.5, 0.4, 0.0, 1.0, 0.25, high, 2.5, 0.4, 2.5, 0.4] for high in (0.0, 0.2)]
    movers = torch.tensor(there).expand(2, 2, 10)
    run = copy_of(log, tmp_path / "run", world={**log.world, "movers_w": movers})
    path = write_rerun(run, 0, tmp_path / "scene.rrd")
    chunks = [*rr.chunk.RrdReader(path).stream()]
    for name in ("/world/moving_pillars", "/world/moving_boxes"):
        assert max(c.num_rows for c in chunks if str(c.entity_path) == name) == 3


def test_scene_without_obstacles_is_a_recording(log, tmp_path):
    from resc.viewing.rerun_scene import write_rerun

    nowhere = torch.tensor([PARKED_M, PARKED_M, 0.0, 0.0]).expand(2, 2, 4)
    free = copy_of(log, tmp_path / "free", world={**log.world, "boxes_w": nowhere})
    path = write_rerun(free, 0, tmp_path / "scene.rrd")
    assert rerun("rrd", "verify", path).returncode == 0
    assert [file.name for file in tmp_path.iterdir() if file.is_file()] == ["scene.rrd"]


def test_blueprint_is_in_the_file(path):
    (blueprint,) = rr.chunk.RrdReader(path).blueprints()
    assert blueprint.application_id == "resc"
