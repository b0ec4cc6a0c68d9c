"""PX4's logs as recordings: frames, time base, episodes, other firmware, damage, other vehicles."""

from pathlib import Path

import numpy as np
import pytest
import torch
from synthetic import QUADROTOR, START_US, flight, ulog

from resc import keys
from resc.recording import RolloutLog
from resc.recording.check import check

pytest.importorskip("pyulog")
DATA = Path(__file__).parents[1] / "data"


@pytest.fixture
def converted(call, tmp_path):
    """A log converted: the recording and what was printed."""

    def convert(topics, parameters=QUADROTOR, code=0, **settings):
        (tmp_path / "flight.ulg").write_bytes(ulog(topics, parameters, **settings))
        found, out, errors = call("from-ulog", "flight.ulg", "--force")
        assert found == code, errors
        return RolloutLog(tmp_path / "flight.mcap"), out

    return convert


def test_an_armed_stretch_is_an_episode_in_our_frames(converted):
    log, _ = converted(flight())
    assert log.episodes.select("start_step", "end_step", "outcome").rows() == [
        (50, 149, "disarmed")
    ]
    steps = log.episode(0)
    assert len(steps) == 100
    torch.testing.assert_close(steps[keys.POSITION_W][0], torch.tensor([0.0, 2.0, 1.0]))
    torch.testing.assert_close(steps[keys.VELOCITY_W][7], torch.tensor([0.0, 2.0, 1.0]))
    rate = torch.tensor([0.1, -0.2, -0.5])
    torch.testing.assert_close(steps[keys.BODY_RATE_B][3], rate)
    torch.testing.assert_close(steps[keys.BODY_RATE_COMMAND_B][3], rate)
    # North is yaw 90 deg; half a second in, it has turned right by 0.75 rad since the start.
    half = (np.pi / 2 - 0.75) / 2
    expected = torch.tensor([np.cos(half), 0, 0, np.sin(half)], dtype=torch.float32)
    torch.testing.assert_close(steps[keys.ATTITUDE_WB][25], expected)
    torch.testing.assert_close(steps[keys.THROTTLE_COMMAND][9], torch.tensor([0.4]))
    torch.testing.assert_close(steps[keys.MOTOR_OUTPUT][9], torch.full((4,), 0.4))
    torch.testing.assert_close(steps[keys.SPECIFIC_FORCE_B][9], torch.tensor([0, 0, 9.8]))


def test_a_recording_of_a_flight_passes_its_check(converted, tmp_path):
    converted(flight(armed=((0.5, 1.0), (2.0, 3.0), (3.5, 9.0))))
    found = check(tmp_path / "flight.mcap")
    assert (found.faults, found.episodes) == ([], 3)


def test_a_flight_that_the_log_ends_in_is_told_from_one_that_landed(converted):
    log, _ = converted(flight(armed=((0.5, 1.0), (2.0, 9.0))))
    assert log.episodes["outcome"].to_list() == ["disarmed", "log_ended"]


def test_older_firmware_is_read_by_its_own_topics(converted):
    log, out = converted(flight(modern=False), parameters={})
    assert "body rate        sensor_combined" in out
    assert "motor outputs    actuator_outputs[1]" in out
    steps = log.episode(0)
    torch.testing.assert_close(steps[keys.BODY_RATE_B][3], torch.tensor([0.1, -0.2, -0.5]))
    torch.testing.assert_close(steps[keys.MOTOR_OUTPUT][0], torch.full((4,), 1501.0))
    assert log.metadata["vehicle"] == "quadrotor"


@pytest.mark.parametrize("rate_hz", [50.0, 400.0, 1000.0])
def test_sensors_of_any_rate_come_to_one_time_base(converted, rate_hz):
    log, _ = converted(flight(rate_hz=rate_hz))
    assert log.num_steps in (199, 200)
    assert check(log.files[0]).faults == []


def test_what_a_log_lacks_is_said_and_the_rest_recorded(converted):
    topics = flight()
    del topics["vehicle_local_position", 0], topics["actuator_motors", 0]
    log, out = converted(topics)
    assert "note: No position: no vehicle_local_position" in out
    assert "note: No motor outputs: no actuator_motors, no actuator_outputs." in out
    assert keys.POSITION_W not in [column.key for column in log.columns]


def test_a_position_that_is_never_valid_is_not_recorded(converted):
    topics = flight()
    topics["vehicle_local_position", 0]["xy_valid"][:] = False
    log, out = converted(topics)
    assert "No position: vehicle_local_position is never valid (xy_valid and z_valid)" in out
    assert keys.VELOCITY_W in [column.key for column in log.columns]


def by_odometry(frame=1):
    """A flight whose position is told by vehicle_odometry alone."""
    topics = flight()
    local = topics.pop(("vehicle_local_position", 0))
    count = len(local["time_s"])
    topics["vehicle_odometry", 0] = {
        "time_s": local["time_s"],
        "pose_frame": np.full(count, frame, np.uint8),
        "position": np.stack([local[name] for name in ("x", "y", "z")], 1),
        "velocity_frame": np.full(count, frame, np.uint8),
        "velocity": np.stack([local[name] for name in ("vx", "vy", "vz")], 1),
    }
    return topics


def test_odometry_tells_the_position_where_nothing_else_does(converted):
    log, out = converted(by_odometry())
    assert "position         vehicle_odometry" in out
    steps = log.episode(0)
    expected = converted(flight())[0].episode(0)
    for key in (keys.POSITION_W, keys.VELOCITY_W):
        torch.testing.assert_close(steps[key], expected[key])


def test_odometry_of_another_frame_is_not_recorded(converted):
    log, out = converted(by_odometry(frame=2))
    assert "vehicle_odometry is not in NED (pose_frame)" in out
    assert "vehicle_odometry is not in NED (velocity_frame)" in out
    assert keys.POSITION_W not in [column.key for column in log.columns]


def test_of_several_instances_of_a_topic_the_first_is_read(converted):
    topics = flight()
    other = topics["vehicle_local_position", 0]
    topics["vehicle_local_position", 1] = {**other, "x": other["x"] + 100}
    position = converted(topics)[0].episode(0)[keys.POSITION_W]
    expected = converted(flight())[0].episode(0)[keys.POSITION_W]
    torch.testing.assert_close(position, expected)


def test_a_log_that_was_never_armed_is_one_episode(converted):
    log, out = converted(flight(armed=()))
    assert log.episodes["outcome"].to_list() == ["never_armed"]
    assert "never armed" in out


def test_a_log_that_does_not_tell_of_arming_is_one_episode(converted):
    topics = flight()
    del topics["actuator_armed", 0]
    assert converted(topics)[0].episodes["outcome"].to_list() == ["arming_unknown"]


def test_bad_times_and_dropouts_are_left_out_and_told(converted):
    topics = flight()
    rates = topics["vehicle_angular_velocity", 0]
    rates["time_s"] = rates["time_s"].copy()
    rates["time_s"][100:103] = (-START_US / 1e6, 0.1, 3e6)
    log, out = converted(topics, dropouts=((2.0, 300),))
    assert "3 messages were left out: their times do not rise." in out
    assert "lost messages 1 times, 0.30 s in all" in out
    assert len(log.episode(0)) == 100


def test_set_points_that_are_not_numbers_hold_what_is_measured(converted):
    topics = flight()
    topics["vehicle_rates_setpoint", 0]["yaw"] = np.full_like(
        topics["vehicle_rates_setpoint", 0]["yaw"], np.nan
    )
    log, _ = converted(topics)
    assert log.episode(0)[keys.BODY_RATE_COMMAND_B][5, 2] == -0.5


def test_a_log_of_the_firmware_itself_is_read(call, tmp_path):
    code, out, _ = call("from-ulog", DATA / "px4_sitl_iris.ulg")
    assert code == 0
    assert "position         vehicle_local_position_groundtruth" in out
    assert "never armed" in out
    log = RolloutLog(tmp_path / "px4_sitl_iris.mcap")
    steps = log.episode(0)
    torch.testing.assert_close(
        steps[keys.SPECIFIC_FORCE_B].mean(0)[2].item(), 9.8, atol=0.1, rtol=0
    )
    assert steps[keys.POSITION_W].abs().max() < 1.0
    assert check(log.files[0]).faults == []


def refused(call, tmp_path, content, *words):
    """One sentence or two, exit code 1, and nothing left behind but the log."""
    (tmp_path / "flight.ulg").write_bytes(content)
    code, out, errors = call("from-ulog", "flight.ulg")
    assert (code, out) == (1, "")
    assert all(word in errors for word in words), errors
    assert [path.name for path in tmp_path.iterdir()] == ["flight.ulg"]


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"MAV_TYPE": 1}, ("fixed-wing aircraft", "MAV_TYPE is 1")),
        ({"MAV_TYPE": 10}, ("rover",)),
        ({"MAV_TYPE": 22}, ("VTOL",)),
    ],
)
def test_other_vehicles_are_refused_by_their_type(call, tmp_path, parameters, words):
    refused(call, tmp_path, ulog(flight(), parameters), *words)


def test_another_vehicle_is_known_by_its_topics(call, tmp_path):
    topics = flight() | {("tecs_status", 0): {"time_s": np.zeros(1), "mode": np.zeros(1, np.uint8)}}
    refused(call, tmp_path, ulog(topics), "fixed-wing aircraft", "tecs_status")


def test_files_that_are_no_logs_are_refused(call, tmp_path):
    refused(call, tmp_path, b"", "empty")
    refused(call, tmp_path, b"\x89MCAP0\r\n" * 40, "no ULog")
    refused(call, tmp_path, ulog({}), "before the first message")
    code, _, errors = call("from-ulog", "other.ulg")
    assert code == 1
    assert "does not exist" in errors


def test_a_log_without_attitude_or_rates_is_refused(call, tmp_path):
    topics = flight()
    del topics["vehicle_attitude", 0]
    refused(call, tmp_path, ulog(topics, QUADROTOR), "tells no attitude", "no vehicle_attitude")


def test_a_log_cut_anywhere_is_read_as_far_as_it_goes_or_refused(call, tmp_path):
    whole = ulog(flight(seconds=1.0, armed=((0.2, 0.6),)), QUADROTOR)
    codes = set()
    for size in [*range(0, 1500, 37), *range(1500, len(whole), 1201), len(whole) - 1]:
        (tmp_path / "flight.ulg").write_bytes(whole[:size])
        code, out, errors = call("from-ulog", "flight.ulg")
        codes.add(code)
        there = (tmp_path / "flight.mcap").exists()
        assert there == (code in (0, 3)), (size, errors)
        assert ("is cut or damaged" in out) == (code == 3)
        if there:
            assert check(tmp_path / "flight.mcap").faults == []
            (tmp_path / "flight.mcap").unlink()
        assert [path.name for path in tmp_path.iterdir()] == ["flight.ulg"]
    assert codes >= {1, 3}


def test_damaged_bytes_never_end_in_a_traceback(call, tmp_path):
    whole = ulog(flight(seconds=0.5, armed=()), QUADROTOR)
    generator = np.random.default_rng(0)
    for _ in range(60):
        data = bytearray(whole)
        for place in generator.integers(7, len(data), 4):
            data[place] = generator.integers(256)
        data[generator.integers(7, 900)] ^= 0xFF
        (tmp_path / "flight.ulg").write_bytes(data)
        assert call("from-ulog", "flight.ulg", "--force")[0] in (0, 1, 3)


def test_a_real_flight_is_drawn_tabled_and_has_no_scene(converted, call, tmp_path):
    converted(flight())
    assert call("plot", "flight.mcap", "--episode", 0)[0] == 0
    assert (tmp_path / "episode_0.png").stat().st_size > 20_000
    assert call("parquet", "flight.mcap")[0] == 0
    code, _, errors = call("scene", "flight.mcap", "--episode", 0)
    assert code == 1
    assert "real flight, which has no scene and no rewards" in errors


def test_a_flight_without_position_is_drawn_too(converted, call, tmp_path):
    topics = flight()
    for name in ("vehicle_local_position", "actuator_motors", "vehicle_rates_setpoint"):
        del topics[name, 0]
    converted(topics)
    assert call("plot", "flight.mcap", "--episode", 0)[0] == 0
    assert (tmp_path / "episode_0.png").exists()
