"""Writing: nothing dropped, files rotated within a budget, crashes and full disks survived."""

import errno
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

import resc
from resc.errors import ConfigError, RecordingError
from resc.learning.training_run import TrainingRun
from resc.recording import Column, RolloutLog, RolloutRecorder

COLUMNS = (
    Column(("state", "position_w"), ("x", "y", "z"), torch.float32, "m", "w"),
    Column(("next", "done"), (), torch.bool),
)
EPISODE_NAMES = ("env_id", "episode", "start_step", "end_step", "length", "scene", "outcome")


def recorder(directory, num_envs=4, **options):
    fixed = {"columns": COLUMNS, "dt_s": 0.02, "metadata": {}, "attachments": {}}
    names = ("success", "collision")
    return RolloutRecorder(
        directory=directory, num_envs=num_envs, outcomes=names, **(fixed | options)
    )


def rollout(number, steps=10, num_envs=4):
    generator = torch.Generator().manual_seed(number)
    position = torch.randn(steps, num_envs, 3, generator=generator)
    done = torch.rand(steps, num_envs, 1, generator=generator) < 0.1
    data = {"state": {"position_w": position}, "next": {"done": done}}
    return TensorDict(data, [steps, num_envs])


def put_many(target, count, num_envs=4):
    for number in range(count):
        target.put(rollout(number, 10, num_envs), number * 10)


def put_and_fail(target, count, num_envs=4):
    with target:
        put_many(target, count, num_envs)
        raise ZeroDivisionError


def episodes(count, **values):
    data = {name: torch.zeros(count, dtype=torch.int64) for name in EPISODE_NAMES}
    data |= {"return_": torch.zeros(count), "difficulty": torch.ones(count)}
    data |= {"success": torch.zeros(count, dtype=torch.bool)}
    return TensorDict(data | values, [count])


def assert_holds(log, count, steps=10, num_envs=4):
    assert log.num_batches == count
    for number in range(count):
        expected, found = rollout(number, steps, num_envs), log.batch(number)
        assert torch.equal(found["state", "position_w"], expected["state", "position_w"])
        assert torch.equal(found["next", "done"], expected["next", "done"])


def test_every_batch_put_in_a_hurry_is_on_the_disk(tmp_path):
    with recorder(tmp_path) as target:
        put_many(target, 200)
    assert target.batches_written == 200
    assert_holds(RolloutLog(tmp_path), 200)


def test_the_collector_may_reuse_its_tensors_at_once(tmp_path):
    batch = rollout(0)
    with recorder(tmp_path) as target:
        for number in range(20):
            batch.update_(rollout(number))
            target.put(batch, number * 10)
            batch["state", "position_w"].fill_(-1)
    assert_holds(RolloutLog(tmp_path), 20)


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_gpu_tensors_may_be_reused_at_once(tmp_path):
    batch = rollout(0, 64, 1024).to("cuda")
    with recorder(tmp_path, 1024) as target:
        for number in range(8):
            batch.update_(rollout(number, 64, 1024).to("cuda"))
            target.put(batch, number * 64)
            batch["state", "position_w"].fill_(-1)
    assert_holds(RolloutLog(tmp_path), 8, 64, 1024)


def test_an_exception_in_training_loses_no_batch(tmp_path):
    with pytest.raises(ZeroDivisionError):
        put_and_fail(recorder(tmp_path), 30)
    assert [path.name for path in tmp_path.iterdir()] == ["rollouts_00000.mcap"]
    assert_holds(RolloutLog(tmp_path), 30)


def test_a_closed_recorder_leaves_no_thread_and_no_open_file(tmp_path):
    before = set(os.listdir("/proc/self/fd")) if Path("/proc/self/fd").exists() else None
    for number in range(5):
        recorder(tmp_path / str(number)).close()
    assert not [t for t in threading.enumerate() if t.name == "rollout-recorder"]
    if before is not None:
        assert len(os.listdir("/proc/self/fd")) <= len(before)


def test_a_forked_child_is_refused_instead_of_waiting_for_a_thread_it_lacks(tmp_path, monkeypatch):
    with recorder(tmp_path) as target:
        with monkeypatch.context() as child:
            child.setattr(os, "getpid", lambda: -1)
            with pytest.raises(RecordingError, match="belongs to another process; open one"):
                put_many(target, 3)
            with pytest.raises(RecordingError, match="belongs to another process"):
                target.flush()
        put_many(target, 1)
    assert_holds(RolloutLog(tmp_path), 1)


def test_files_rotate_by_size_and_each_is_complete(tmp_path):
    with recorder(tmp_path, rotate_mb=0.01, compression="none") as target:
        put_many(target, 40)
    files = sorted(tmp_path.iterdir())
    assert len(files) > 3
    assert [path.name for path in files] == [f"rollouts_{i:05d}.mcap" for i in range(len(files))]
    assert all(path.stat().st_size < 0.016e6 for path in files)
    assert_holds(RolloutLog(tmp_path), 40)


def test_a_full_budget_stops_the_run_at_the_next_batch(tmp_path):
    target = recorder(tmp_path, rotate_mb=0.01, max_gb=30e-6, compression="none")
    with pytest.raises(RecordingError, match=r"reached recorder\.max_gb = 3e-05"):
        put_many(target, 100)
    target.close()
    total = sum(path.stat().st_size for path in tmp_path.iterdir())
    assert 30_000 <= total < 34_000
    assert_holds(RolloutLog(tmp_path), target.batches_written)
    with pytest.raises(RecordingError, match="Raise it, set"):
        recorder(tmp_path, rotate_mb=0.01, max_gb=30e-6)
    assert not list(tmp_path.glob("*.active"))


def test_a_full_budget_that_loses_nothing_raises_nothing(tmp_path):
    with recorder(tmp_path, max_gb=1e-6) as target:
        target.put(rollout(0), 0)
    assert_holds(RolloutLog(tmp_path), 1)


def test_the_oldest_files_make_room_loudly(tmp_path, caplog):
    options = {"rotate_mb": 0.01, "max_gb": 35e-6, "when_full": "delete_oldest"}
    kept = tmp_path / "rollouts_best.mcap"
    kept.write_bytes(b"renamed by hand")
    with recorder(tmp_path, compression="none", **options) as target:
        for number in range(100):
            target.put(rollout(number), number * 10)
    total = sum(path.stat().st_size for path in tmp_path.glob("rollouts_0*"))
    assert total < 38_000
    log = RolloutLog(str(tmp_path / "rollouts_0*.mcap"))
    assert log.start_steps[-1] == 990
    assert log.start_steps == list(range(log.start_steps[0], 1000, 10))
    assert kept.exists()
    deleted = [line for line in caplog.messages if line.startswith("Deleted")]
    assert "rollouts_00000.mcap" in deleted[0]
    assert log.files[0].name == f"rollouts_{len(deleted):05d}.mcap"


class FullDisk:
    """`os.write` on a disk with little space left: a part is written, the rest is refused."""

    def __init__(self, space, number=errno.ENOSPC):
        self.space, self.number, self.write = space, number, os.write

    def __call__(self, descriptor, data):
        if self.space == 0:
            raise OSError(self.number, os.strerror(self.number))
        written = self.write(descriptor, data[: self.space])
        self.space -= written
        return written


def test_a_full_disk_raises_once_and_leaves_what_was_written(tmp_path, monkeypatch):
    target = recorder(tmp_path, 64, compression="none")
    monkeypatch.setattr(os, "write", FullDisk(250_000))
    complaint = r"disk .* is full; the \d+ batches before stay .* Free"
    with pytest.raises(RecordingError, match=complaint):
        put_many(target, 1000, 64)
    with pytest.raises(RecordingError, match="is full"):
        target.put(rollout(0, 10, 64), 100_000)
    target.close()
    target.close()
    assert [path.name for path in tmp_path.iterdir()] == ["rollouts_00000.mcap.active"]
    assert target.batches_written > 5
    assert_holds(RolloutLog(tmp_path), target.batches_written, 10, 64)


def test_a_disk_that_fills_up_at_the_end_is_reported_by_close(tmp_path, monkeypatch):
    target = recorder(tmp_path)
    target.put(rollout(0), 0)
    target.flush()
    monkeypatch.setattr(os, "write", FullDisk(20))
    with pytest.raises(RecordingError, match="is full"):
        target.close()
    target.close()
    assert_holds(RolloutLog(tmp_path), 1)


def test_flush_reports_a_full_disk_instead_of_waiting_for_ever(tmp_path, monkeypatch):
    target = recorder(tmp_path)
    monkeypatch.setattr(os, "write", FullDisk(20))
    target.put(rollout(0), 0)
    with pytest.raises(RecordingError, match="is full"):
        target.flush()
    target.close()


def test_the_first_error_is_the_one_that_is_raised(tmp_path, monkeypatch):
    target = recorder(tmp_path, 64)
    monkeypatch.setattr(os, "write", FullDisk(4000))
    with pytest.raises(ZeroDivisionError) as caught:
        put_and_fail(target, 1, 64)
    assert "is full" in caught.value.__notes__[0]


def test_a_directory_that_cannot_be_written_is_an_error_at_once(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match=r"file failed: File exists; .* Check the folder"):
        recorder(tmp_path / "file")
    with pytest.raises(RecordingError, match="folder failed: Not a directory"):
        recorder(tmp_path / "file" / "folder")
    monkeypatch.setattr(os, "write", FullDisk(100))
    with pytest.raises(RecordingError, match="is full"):
        recorder(tmp_path / "new")
    assert not list((tmp_path / "new").iterdir())


@pytest.fixture
def small_disk(tmp_path):
    """A disk of 256 kB, where one may be mounted."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", folder]
    if not shutil.which("mount"):
        pytest.skip("no disk can be mounted here")
    if subprocess.run(command, capture_output=True, timeout=10).returncode != 0:
        pytest.skip("no disk can be mounted here")
    yield folder
    subprocess.run(["umount", folder], check=True, timeout=10)


def test_a_really_full_disk_leaves_what_was_written(small_disk):
    target = recorder(small_disk / "rollouts", 64, compression="none")
    with pytest.raises(RecordingError, match=r"full; the \d+ batches before stay .* Free"):
        put_many(target, 100, 64)
    target.close()
    assert target.batches_written > 5
    assert_holds(RolloutLog(small_disk / "rollouts"), target.batches_written, 10, 64)


def test_a_really_read_only_folder_is_an_error_at_once(small_disk):
    subprocess.run(["mount", "-o", "remount,ro", small_disk], check=True, timeout=10)
    with pytest.raises(RecordingError, match="failed: Read-only file system; the 0 batches"):
        recorder(small_disk / "rollouts")


def test_a_second_recorder_in_a_folder_is_refused_until_the_first_has_ended(tmp_path):
    with recorder(tmp_path) as first:
        first.put(rollout(0), 0)
        with pytest.raises(RecordingError, match=r"Another recorder writes to .* of its own"):
            recorder(tmp_path)
        first.put(rollout(1), 10)
    with recorder(tmp_path):
        pass
    assert [path.name for path in RolloutLog(tmp_path).files] == [
        "rollouts_00000.mcap",
        "rollouts_00001.mcap",
    ]
    assert_holds(RolloutLog(tmp_path / "rollouts_00000.mcap"), 2)


def test_a_recorder_that_failed_lets_go_of_its_folder(tmp_path, monkeypatch):
    target = recorder(tmp_path, 64)
    with monkeypatch.context() as full:
        full.setattr(os, "write", FullDisk(4000))
        with pytest.raises(RecordingError, match="is full"):
            put_and_fail_to_close(target)
        with pytest.raises(RecordingError, match="is full"):
            recorder(tmp_path)
    recorder(tmp_path).close()


def put_and_fail_to_close(target):
    target.put(rollout(0, 10, 64), 0)
    target.close()


def test_the_first_environments_alone_are_recorded(tmp_path):
    ended = episodes(4, env_id=torch.tensor([3, 0, 2, 1]))
    starts = {"env_id": torch.tensor([2, 1]), "step": torch.tensor([5, 6])}
    with recorder(tmp_path, envs=2) as target:
        target.put(rollout(0), 0, ended, starts)
        target.put(rollout(1), 10, episodes(1, env_id=torch.tensor([3])), starts)
        with pytest.raises(RecordingError, match=r"shape \[10, 2\]; expected \[T, 4\]"):
            target.put(rollout(2, num_envs=2), 20)
    log = RolloutLog(tmp_path)
    assert log.num_envs == 2
    assert log.episodes["env_id"].to_list() == [0, 1]
    for number in range(2):
        expected = rollout(number)[:, :2]["state", "position_w"]
        assert torch.equal(log.batch(number)["state", "position_w"], expected)


def test_chosen_columns_alone_are_recorded(tmp_path):
    with recorder(tmp_path / "a", fields=["state.position_w"]) as target:
        put_many(target, 2)
    log = RolloutLog(tmp_path / "a")
    assert [column.key for column in log.columns] == [("state", "position_w")]
    assert torch.equal(log.batch(1)["state", "position_w"], rollout(1)["state", "position_w"])
    with recorder(tmp_path / "b", fields=["next", "state"]) as target:
        put_many(target, 2)
    assert_holds(RolloutLog(tmp_path / "b"), 2)
    for name in ("stat", "state.position", "done"):
        with pytest.raises(ConfigError, match=f"recorder.fields has no '{name}'. Did you mean"):
            recorder(tmp_path / "c", fields=[name])


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"envs": 5}, "envs"),
        ({"envs": 0}, "envs"),
        ({"fields": []}, "fields"),
        ({"compression": "gzip"}, "compression"),
        ({"when_full": "panic"}, "when_full"),
        ({"rotate_mb": 0}, "rotate_mb"),
        ({"round_bits": 23}, "round_bits"),
        ({"every_n_batches": 0}, "every_n_batches"),
        ({"dt_s": 1e-9}, "num_envs"),
        ({"metadata": {"seed": 7}}, "metadata"),
        ({"max_gb": 0.5, "rotate_mb": 512, "when_full": "delete_oldest"}, "max_gb"),
    ],
)
def test_an_argument_out_of_range_is_named(tmp_path, options, name):
    # The test run may check the annotations first (TypeError); both name the argument.
    with pytest.raises((ConfigError, TypeError), match=name):
        recorder(tmp_path / "new", **options)
    assert not (tmp_path / "new").exists()


def test_a_batch_that_does_not_fit_is_refused_before_it_is_queued(tmp_path):
    wrong_type = rollout(1)
    wrong_type["next", "done"] = wrong_type["next", "done"].float()
    wrong_shape = rollout(1)
    wrong_shape["state", "position_w"] = wrong_shape["state", "position_w"][..., :2]
    with recorder(tmp_path) as target:
        target.put(rollout(0), 0)
        for batch, step, complaint in (
            (rollout(1, num_envs=5), 10, r"expected \[T, 4\]"),
            (rollout(1)[:0], 10, "not empty"),
            (rollout(1).exclude(("next", "done")), 10, r"has no \('next', 'done'\)"),
            (wrong_type, 10, r"is torch.float32 \(1,\) in the batch and torch.bool"),
            (wrong_shape, 10, r"\(2,\) in the batch"),
            (rollout(1), 9, "starts at step 9, before step 10"),
        ):
            with pytest.raises(RecordingError, match=complaint):
                target.put(batch, step)
        with pytest.raises(RecordingError, match="no 'scene'"):
            target.put(rollout(1), 10, episodes(1).exclude("scene"))
        with pytest.raises(RecordingError, match="'boxes' has dtype"):
            target.put_world({"boxes": torch.zeros(2, dtype=torch.float64)}, 10)
        target.put(rollout(1), 10)
    with pytest.raises(RecordingError, match="is closed"):
        target.put(rollout(2), 20)
    assert_holds(RolloutLog(tmp_path), 2)


@pytest.mark.parametrize("values", [{"outcome": torch.tensor([2])}, {"env_id": torch.tensor([-1])}])
def test_an_episode_out_of_range_is_an_error(tmp_path, values):
    target = recorder(tmp_path)
    target.put(rollout(0), 0, episodes(1, **values))
    with pytest.raises(RecordingError, match=f"The '{next(iter(values))}' of an episode"):
        target.close()


def test_recording_costs_little(tmp_path):
    batch = rollout(0, 64, 1024)
    with recorder(tmp_path, 1024, compression="lz4") as target:
        before = time.process_time()
        for number in range(8):
            target.put(batch, number * 64)
    seconds = time.process_time() - before
    assert seconds / (8 * 64 * 1024) * 100_000 < 0.3


CHILD = """
import os, resource, signal, sys
import test_recorder as t

def say(*words):
    # One write a line: of two, such as print's without a buffer, a kill may leave the first alone.
    os.write(1, (" ".join(map(str, words)) + "\\n").encode())

def write(directory, **options):
    with t.recorder(directory, 64, **options) as target:
        for number in range(100_000):
            target.put(t.rollout(number, 64, 64), number * 64)
            say(target.batches_written)

def rotate(directory):
    write(directory, rotate_mb=0.2)

def terminate(directory):
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    number = 0
    try:
        with t.recorder(directory, 64) as target:
            while True:
                target.put(t.rollout(number, 64, 64), number * 64)
                number += 1
                say(number)
    except SystemExit:
        os._exit(0)

def leave(directory):
    target = t.recorder(directory, 64)
    for number in range(5):
        target.put(t.rollout(number, 64, 64), number * 64)
    sys.exit(0)  # without close

def limit(directory):
    resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))
    target = t.recorder(directory, 64)
    try:
        for number in range(1000):
            target.put(t.rollout(number, 64, 64), number * 64)
    except t.RecordingError as error:
        say(target.batches_written, error)
    target.close()
    os._exit(0)

# One process pays for the imports and forks the writers.
for line in sys.stdin:
    mode, _, directory = line.rstrip().partition(" ")
    pid = os.fork()
    if pid == 0:
        globals()[mode](t.Path(directory))
        os._exit(0)
    say("pid", pid)
    say("end", os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))
os._exit(0)
"""


class Children:
    """Writers in processes of their own."""

    def __init__(self, errors):
        paths = [str(Path(__file__).parent), str(Path(resc.__file__).parents[1])]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths), "OMP_NUM_THREADS": "1"}
        self.errors = errors
        with errors.open("w") as file:
            self.process = subprocess.Popen(
                [sys.executable, "-c", CHILD],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=file,
                env=environment,
                text=True,
                start_new_session=True,  # so that the writers can be ended with it
            )

    def start(self, mode, directory):
        """Start a writer; its process number."""
        self.process.stdin.write(f"{mode} {directory}\n")
        self.process.stdin.flush()
        self.lines = []
        while True:
            line = self.read()
            if line.startswith("pid"):
                return int(line.split()[1])
            self.lines.append(line)

    def line(self):
        """Wait for what the writer says next; its end is an error."""
        line = self.read()
        assert not line.startswith("end"), f"it ended early ({line}): {self.errors.read_text()}"
        self.lines.append(line)

    def finish(self, code=0):
        """Everything the writer said until it ended, as expected."""
        while not (line := self.read()).startswith("end"):
            self.lines.append(line)
        assert line == f"end {code}", self.errors.read_text()
        return self.lines

    def read(self):
        line = self.process.stdout.readline()
        assert line.endswith("\n"), f"it ended early: {self.errors.read_text()}"
        return line.strip()

    def close(self):
        """End the process, and any writer that a failed test has left."""
        os.killpg(self.process.pid, signal.SIGKILL)
        self.process.communicate(timeout=10)


@pytest.fixture(scope="module")
def children(tmp_path_factory):
    started = Children(tmp_path_factory.mktemp("children") / "errors.txt")
    yield started
    started.close()


@pytest.mark.slow
def test_a_writer_that_ends_early_is_an_error_with_its_last_words(tmp_path, children):
    children.start("misspelt", tmp_path)
    with pytest.raises(AssertionError, match=r"(?s)ended early .end 1.: .*KeyError: 'misspelt'"):
        children.line()


def kill_and_read(directory, children, seed):
    """A writer killed at a random moment; every batch that it knew to be written is there."""
    rng = random.Random(seed)
    pid = children.start(rng.choice(("write", "rotate")), directory)
    for _ in range(rng.randrange(1, 40)):
        children.line()
    time.sleep(rng.uniform(0, 0.01))
    os.kill(pid, signal.SIGKILL)
    flushed = int(children.finish(-signal.SIGKILL)[-1])
    log = RolloutLog(directory)
    assert flushed <= log.num_batches <= flushed + 4
    assert_holds(log, log.num_batches, 64, 64)
    recorder(directory, 64).close()  # no lock is left behind


@pytest.mark.parametrize("seed", [0])
def test_a_killed_process_leaves_every_flushed_batch_readable(tmp_path, children, seed):
    kill_and_read(tmp_path, children, seed)


@pytest.mark.slow
def test_fifty_killed_processes_leave_every_flushed_batch_readable(tmp_path, children):
    for seed in range(1, 51):
        kill_and_read(tmp_path / str(seed), children, seed)


def test_a_termination_that_unwinds_loses_no_batch(tmp_path, children):
    pid = children.start("terminate", tmp_path)
    while len(children.lines) < 10:
        children.line()
    os.kill(pid, signal.SIGTERM)
    put = int(children.finish()[-1])
    log = RolloutLog(tmp_path)
    assert log.files == [tmp_path / "rollouts_00000.mcap"]
    assert put <= log.num_batches <= put + 1
    assert_holds(log, log.num_batches, 64, 64)


def test_an_interpreter_that_exits_completes_the_file(tmp_path, children):
    children.start("leave", tmp_path)
    children.finish()
    assert [path.name for path in tmp_path.iterdir()] == ["rollouts_00000.mcap"]
    assert_holds(RolloutLog(tmp_path), 5, 64, 64)


def test_a_real_write_failure_leaves_what_was_written(tmp_path, children):
    children.start("limit", tmp_path)
    count, message = children.finish()[-1].split(maxsplit=1)
    assert message.startswith(f"Recording to {tmp_path} failed: File too large; the {count} batch")
    assert int(count) > 1
    assert_holds(RolloutLog(tmp_path), int(count), 64, 64)


def test_the_configuration_chooses_environments_and_columns(tmp_path, compose, make_stages):
    overrides = ("recorder.fields=[state.position_w,action]", "recorder.envs=2")
    with TrainingRun(compose(*overrides)).recorded.open(
        make_stages(), directory=tmp_path, outcomes=("success",), num_envs=4
    ) as target:
        shape = (3, 4)
        data = {"state": {"position_w": torch.ones(*shape, 3)}, "action": torch.zeros(*shape, 4)}
        target.put(TensorDict(data, shape), 0)
    log = RolloutLog(tmp_path)
    assert [column.key for column in log.columns] == [("state", "position_w"), ("action",)]
    assert log.batch(0)["state", "position_w"].shape == (3, 2, 3)
    with pytest.raises(ConfigError, match=r"recorder.fields has no 'acton'. Did you mean 'action'"):
        TrainingRun(compose("recorder.fields=[acton]")).recorded.open(
            make_stages(), directory=tmp_path, outcomes=("success",), num_envs=4
        )
