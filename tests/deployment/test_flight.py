"""Whole flights through a link: two processes, UDP on loopback, real time."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from resc.recording.reader import RolloutLog

pytest.importorskip("pymavlink")
pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]
ROOT = Path(__file__).parents[2]
SCENE = "scenes=[paper4_map15]"
PATIENT = "link.stale_s=0.5"
"""For machines whose processes stand still for a tenth of a second."""
LIGHT = ("dynamics=rigid_body", "dynamics.substeps=1")
"""The same dynamics with the published step of 10 ms, at half the cost."""
LIMIT_S = 200


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as some:
        some.bind(("127.0.0.1", 0))
        return some.getsockname()[1]


def started(module, port, folder, *arguments):
    line = [sys.executable, "-m", f"resc.deployment.{module}", SCENE]
    line += [f"connection=udp:127.0.0.1:{port}", f"hydra.run.dir={folder / module}", *arguments]
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    return subprocess.Popen(line, cwd=ROOT, env=environment, **pipes)


@contextmanager
def alive(process):
    """Leaves no process behind, whatever happens."""
    try:
        yield process
    finally:
        process.kill()  # one that has ended does not mind
        process.communicate(timeout=10)


def flight(folder, peer=(), fly=(), during=None):
    """Exit status and words of a flight, and the words of its peer."""
    port = free_port()
    arguments = ("arm=true", "link.wait_s=90", *(fly or (PATIENT,)))
    with (
        alive(started("peer", port, folder, *LIGHT, *peer)) as other,
        alive(started("fly", port, folder, *arguments)) as own,
    ):
        if during:
            during(own, other)
        told = own.communicate(timeout=LIMIT_S)[0]
        other.send_signal(signal.SIGTERM)
        heard = other.communicate(timeout=LIMIT_S)[0]
    return own.returncode, told, heard


def wait_for(process, text):
    """What a process says, up to a line with the text."""
    for line in process.stdout:
        if text in line:
            return
    raise AssertionError(f"it ended before it said {text!r}")


def in_flight(act):
    def during(own, other):
        wait_for(own, "the policy flies")
        time.sleep(0.5)
        act(own, other)

    return during


@pytest.mark.parametrize(
    "peer",
    [(), ("peer.loss=0.05", "peer.jitter_s=0.01"), ("rate_loop=px4",)],
    ids=["clean", "lossy", "px4"],
)
def test_a_map_is_flown_through_the_link(tmp_path, peer):
    code, told, heard = flight(tmp_path, peer)
    assert code == 0, told + heard
    assert "arrived after" in told
    summary = json.loads((tmp_path / "fly" / "summary.json").read_text())
    assert summary["outcome"] == "arrived"
    log = RolloutLog(tmp_path / "fly" / "rollouts")
    assert log.num_steps == summary["steps"]
    assert log.episodes["outcome"].to_list() == ["success"]
    assert (tmp_path / "fly" / "fly.log").exists()


def test_a_peer_that_dies_is_told_and_nothing_is_commanded_any_more(tmp_path):
    kill = in_flight(lambda own, other: other.kill())
    code, told, _ = flight(tmp_path, during=kill, fly=("link.stale_s=0.09",))
    assert code == 1
    assert "error: Nothing was heard of the vehicle for" in told or "not renewed for" in told
    assert "recording" in told


def test_odometry_that_stops_is_told_and_the_vehicle_asked_to_hold(tmp_path):
    code, told, heard = flight(tmp_path, ("peer.silent_after_s=0.7",), ("link.stale_s=0.3",))
    assert code == 1
    assert "error: The odometry was not renewed for" in told
    assert "0 times without any" in heard  # it was in hold before its own watchdog had to see to it


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """A flight that Ctrl-C stopped: exit status, its words and its peer's, and its folder."""
    folder = tmp_path_factory.mktemp("stopped")
    stop = in_flight(lambda own, other: own.send_signal(signal.SIGINT))
    return *flight(folder, during=stop), folder


def test_ctrl_c_stops_in_order_and_the_recording_is_whole(stopped):
    code, told, heard, folder = stopped
    assert code == 1
    assert "error: Stopped by Ctrl-C." in told
    assert "0 times without any" in heard  # it was in hold before its own watchdog had to see to it
    log = RolloutLog(folder / "fly" / "rollouts")
    assert log.episodes["outcome"].to_list() == ["link"]
    episode = log.episode(0)
    assert len(episode) == log.num_steps > 10
    assert episode["state", "position_w"].isfinite().all()


def test_the_recording_of_a_real_flight_is_not_replayed(stopped):
    recording = stopped[-1] / "fly" / "rollouts"
    line = [sys.executable, "evaluate.py", f"replay={recording}#0", f"hydra.run.dir={stopped[-1]}"]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, timeout=LIMIT_S)
    assert done.returncode == 1
    told = (done.stdout + done.stderr).strip().splitlines()
    assert told[-1].startswith(f"error: replay is {recording}#0, whose dynamics is LinkedVehicle:")
    assert "Traceback" not in done.stderr


def test_a_position_in_another_frame_is_named_before_anything_is_sent(tmp_path):
    code, told, _ = flight(tmp_path, ("peer.frame=enu",))
    assert code == 1
    assert "looks like ENU sent as NED" in told
    assert "streaming" not in told
