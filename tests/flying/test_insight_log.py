"""Routes and known maps in recordings of flights that see and replan."""

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from omegaconf import OmegaConf
from PIL import Image

from resc import keys
from resc.flying.flights import fly_recorded
from resc.flying.pursuit import Pursuit
from resc.flying.replay import fly_again
from resc.log_command import main
from resc.recording.check import check
from resc.recording.known_cells import FREE, OCCUPIED, UNSEEN, packed, unpacked
from resc.recording.reader import RolloutLog
from resc.recording.rewrite import recover
from resc.recording.rollouts import RecordedRun
from resc.setup import set_up
from resc.viewing.foxglove import write_scene

FLIGHTS = 3
SEEN = ("scene=planned", "sensing=depth", "replanning=in_flight")
LIMIT = ("termination.time_limit.limit_s=3.0", "obstacle_observation=none")


@pytest.fixture(scope="module")
def recording(compose, tmp_path_factory):
    """The file of three flights with a depth camera."""
    config = compose(*SEEN, *LIMIT, f"num_envs={FLIGHTS}")
    env = set_up(config, size=FLIGHTS, seed=1).env(FLIGHTS, compiled=False, in_order=True)
    stored = OmegaConf.to_yaml(config, resolve=True)
    run = RecordedRun(config["recorder"], stored, seed=1, device="cpu")
    folder = tmp_path_factory.mktemp("seen")
    fly_recorded(env, Pursuit(), run, folder)
    return folder / "rollouts_00000.mcap"


def test_each_new_route_is_a_message_and_agrees_with_the_columns(recording):
    log = RolloutLog(recording)
    for number in range(len(log)):
        steps, routes = log.episode(number), log.routes(number)
        assert (routes[0].step, routes[0].planned, routes[0].cause) == (0, 0, "first")
        count = steps[keys.REPLANS][:, 0].numpy()
        for route in routes[1:]:
            assert 0 < route.planned < route.step
            assert count[route.planned] == count[route.planned - 1] + 1
            assert steps[keys.REPLAN_STATUS][route.planned, 0] == 1
            assert route.cause == "blocked"
    assert sum(map(len, map(log.routes, range(len(log))))) > FLIGHTS


def test_the_known_map_grows(recording):
    log = RolloutLog(recording)
    maps = log.known_maps(0)
    assert [known.step for known in maps][:3] == [0, 25, 50]
    assert maps[-1].step == len(log.episode(0))
    seen = [int((known.cells != UNSEEN).sum()) for known in maps]
    assert seen == sorted(seen)
    assert seen[-1] > seen[0] > 0
    assert {FREE, OCCUPIED} <= {*np.unique(maps[-1].cells).tolist()}


def test_what_is_recorded_comes_out_again_and_a_recovered_file_holds_it(recording, tmp_path):
    result = fly_again(f"{recording}#0")
    assert result.largest == 0.0, result.report()
    assert result.deviations.keys() >= {keys.REPLANS, keys.REPLAN_STATUS}
    target = tmp_path / "rollouts_00000.mcap"
    assert not recover(recording, target).lost
    assert not check(target).faults
    for number in range(FLIGHTS):
        one, other = RolloutLog(recording), RolloutLog(target)
        pairs = zip(one.routes(number), other.routes(number), strict=True)
        assert all(np.array_equal(a.points, b.points) for a, b in pairs)
        pairs = zip(one.known_maps(number), other.known_maps(number), strict=True)
        assert all(np.array_equal(a.cells, b.cells) for a, b in pairs)


def test_the_commands_tell_how_often_routes_were_renewed(recording, capsys):
    renewals = RolloutLog(recording).renewals(range(FLIGHTS))
    for command in ("info", "episodes"):
        with pytest.raises(SystemExit):
            main([command, str(recording)])
    text = capsys.readouterr().out
    assert f"at most {max(renewals)}" in text
    assert "replans" in text.splitlines()[-FLIGHTS - 2]


def test_plot_and_video_show_what_was_known(recording, tmp_path):
    for command, name in (("plot", "flight.png"), ("video", "flight.gif")):
        with pytest.raises(SystemExit) as end:
            main([command, str(recording), "--episode", "0", "--out", str(tmp_path / name)])
        assert end.value.code == 0
    seconds = len(RolloutLog(recording).episode(0)) * 0.02
    with Image.open(tmp_path / "flight.gif") as video:
        assert abs(video.n_frames - seconds * 12.5) <= 2
        first, last = [shades(video, frame) for frame in (0, video.n_frames - 1)]
    assert last < first


def test_a_3d_scene_shows_each_known_map_and_each_route(recording, tmp_path):
    log = RolloutLog(recording)
    path = write_scene(log, 0, tmp_path / "scene.mcap")
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = [
            (channel.topic, message.log_time, decoded)
            for _, channel, message, decoded in reader.iter_decoded_messages()
        ]
    grids = [(time, grid) for topic, time, grid in found if topic == "/map/known"]
    maps = log.known_maps(0)
    assert [time for time, _ in grids] == [known.step * 20_000_000 for known in maps]
    numbers = np.frombuffer(grids[-1][1].data, "<f4")[::2].reshape(maps[-1].cells.shape)
    assert np.array_equal(numbers, maps[-1].cells)
    routes = [route for topic, _, route in found if topic == "/plan/route"]
    assert [len(route.poses) - 1 for route in routes] == [len(r.points) for r in log.routes(0)]


def shades(video, frame):
    """How many pixels of a frame have the colour of what was never seen."""
    video.seek(frame)
    pixels = np.asarray(video.convert("RGB")).astype(int)
    return int((np.abs(pixels - [188, 193, 202]).max(-1) < 12).sum())


@pytest.mark.parametrize("shape", [(1, 1), (4, 4), (7, 9)])
def test_packed_cells_come_out_again(shape):
    cells = np.random.default_rng(0).integers(0, 3, (2, *shape)).astype(np.uint8)
    words = packed(cells != UNSEEN, cells == OCCUPIED)
    assert all(np.array_equal(unpacked(w, *shape), c) for w, c in zip(words, cells, strict=True))


def test_a_scene_for_rerun_shows_them_too(recording, tmp_path):
    rr = pytest.importorskip("rerun", reason="the extra 'rerun' is not installed")
    from resc.viewing.rerun_scene import write_rerun

    log = RolloutLog(recording)
    path = write_rerun(log, 0, tmp_path / "scene.rrd")
    rows = {"/map/known": 0, "/plan/route": 0}
    for chunk in rr.chunk.RrdReader(path).stream():
        rows[str(chunk.entity_path)] = rows.get(str(chunk.entity_path), 0) + chunk.num_rows
    assert rows["/map/known"] == len(log.known_maps(0))
    assert rows["/plan/route"] == len(log.routes(0))
