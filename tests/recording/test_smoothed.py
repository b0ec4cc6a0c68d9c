"""A flight recorded with motion capture: smoothed afterwards, drawn, and flown again."""

import hashlib

import numpy as np
import pytest
import torch
from matplotlib.figure import Figure
from mcap.reader import make_reader
from omegaconf import OmegaConf

from resc import keys
from resc.errors import RecordingError
from resc.flying.flight_log import FlightLog
from resc.flying.loop import flown
from resc.flying.replay import fly_again
from resc.log_command import main
from resc.recording.reader import RolloutLog
from resc.recording.rollouts import RecordedRun
from resc.recording.smoothed import smooth
from resc.setup import set_up
from resc.viewing.colours import ESTIMATED, MEASURED
from resc.viewing.episode_scene import load_scene
from resc.viewing.estimate_picture import draw_tracks, is_estimated
from resc.viewing.foxglove import write_scene
from resc.viewing.plot import draw_episode


@pytest.fixture(scope="module")
def recording(compose, tmp_path_factory):
    """The folder of a recorded flight with an estimator, and one without."""
    folder = tmp_path_factory.mktemp("recorded")
    for name in ("ekf", "none"):
        chosen = ("scene=free", "obstacle_observation=none", f"estimator={name}", "num_envs=2")
        config = compose(*chosen, "termination.time_limit.limit_s=1.0")
        env = set_up(config, size=2, seed=0).env(2, compiled=False)
        env.restart(torch.arange(2))
        run = RecordedRun(
            config["recorder"], OmegaConf.to_yaml(config, resolve=True), seed=0, device="cpu"
        )
        recorder = run.open(env.stages, directory=folder / name, num_envs=2)
        log = FlightLog(recorder, env)
        over = torch.zeros(2, 1, dtype=torch.bool)
        for before, action, out in flown(env, (torch.zeros(2, 4) for _ in range(50))):
            log.step(before, action, out, ~over)
            over = over | out.done
        log.flush()
        recorder.close()
        assert over.all()
    return folder


def test_the_smoothed_track_is_nearer_to_the_truth(recording):
    log = RolloutLog(recording / "ekf")
    track, steps = smooth(log, 0), log.episode(0)
    true = steps[keys.POSITION_W].numpy()[:-1]  # frames are one step old
    frames = np.nan_to_num(track.measured[1:], nan=np.inf)
    usual = np.abs(frames - true).max(-1) < 0.01
    moving = steps[keys.VELOCITY_W].numpy()[:-1]

    def rms(values):
        return float(np.sqrt(np.mean(np.square(values[usual]))))

    assert rms(track.smoothed[1:, :3] - true) < 0.9 * rms(frames - true)
    assert rms(track.smoothed[1:, 3:] - moving) < 0.7 * rms(track.filtered[1:, 3:] - moving)
    assert track.time_s[0] == pytest.approx(-0.02)
    assert np.isfinite(track.smoothed).all()


def test_the_command_leaves_a_table_and_a_picture_and_the_recording_as_it_was(recording, capsys):
    (file,) = (recording / "ekf").glob("*.mcap")
    before = hashlib.sha256(file.read_bytes()).hexdigest()
    with pytest.raises(SystemExit) as ended:
        main(["smooth", str(recording / "ekf"), "--episode", "0"])
    assert ended.value.code == 0
    table, picture = (
        file.with_name(f"{file.stem}_episode_0_smoothed.{end}") for end in ("csv", "png")
    )
    assert table.read_text().startswith("time_s,position_x,")
    assert picture.stat().st_size > 10_000
    assert hashlib.sha256(file.read_bytes()).hexdigest() == before


def test_a_recording_without_frames_cannot_be_smoothed(recording):
    with pytest.raises(RecordingError, match=r"no column sensor\.mocap_position_w, which smooth"):
        smooth(RolloutLog(recording / "none"), 0)


def test_readings_and_estimate_are_recorded_and_drawn(recording, tmp_path):
    log = RolloutLog(recording / "ekf")
    scene = load_scene(log, 0)
    assert scene.path(keys.MOCAP_POSITION_W).shape == scene.path(keys.ESTIMATED_POSITION_W).shape
    path = write_scene(log, 0, tmp_path / "scene.mcap")
    topics = path.read_bytes()
    for topic in (b"/drone/estimate", b"/drone/measured", b"/estimate", b"/mocap"):
        assert topic in topics
    without = write_scene(RolloutLog(recording / "none"), 0, tmp_path / "none.mcap").read_bytes()
    assert b"/drone/estimate" not in without


def documents(path):
    with path.open("rb") as file:
        return {each.name: each.data.decode() for each in make_reader(file).iter_attachments()}


def test_the_layouts_show_the_measured_and_the_estimated_track(recording, tmp_path):
    for estimator, shown in (("ekf", True), ("none", False)):
        path = write_scene(RolloutLog(recording / estimator), 0, tmp_path / f"{estimator}.mcap")
        for name in ("foxglove_layout.json", "lichtblick_layout.json"):
            layout = documents(path)[name]
            for topic in ("/drone/measured", "/drone/estimate", "/estimate.position_error"):
                assert (topic in layout) == shown
            assert (ESTIMATED in layout) == shown


def test_the_picture_of_an_episode_shows_both_tracks(recording):
    steps = RolloutLog(recording / "ekf").episode(0)
    axes = Figure().add_subplot()
    draw_tracks(axes, steps)
    points, line = axes.get_lines()
    assert (points.get_color(), line.get_color()) == (MEASURED, ESTIMATED)
    assert np.array_equal(line.get_xydata(), steps[keys.ESTIMATED_POSITION_W][:, :2].numpy())
    without = RolloutLog(recording / "none").episode(0)
    assert not is_estimated(without)
    draw_tracks(axes, without)
    assert len(axes.get_lines()) == 2


@pytest.mark.parametrize("estimator", ["ekf", "none"])
def test_an_episode_is_drawn_with_and_without_an_estimate(recording, tmp_path, estimator):
    picture = tmp_path / "episode.png"
    draw_episode(RolloutLog(recording / estimator), 0, picture)
    assert picture.stat().st_size > 10_000


def test_a_flight_by_estimate_is_flown_again_bit_for_bit(recording):
    assert fly_again(f"{recording / 'ekf'}#1").largest == 0
