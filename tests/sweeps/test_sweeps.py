"""Sweeps: what is finished is kept, what fails says why, what was stopped goes on."""

import fcntl
import importlib.util
import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from resc.build import build
from resc.command_line import shell
from resc.errors import ConfigError, SweepError, UnfinishedError
from resc.starting.arguments import resumed_sweep
from resc.starting.origin import claim, require_own_folder
from resc.sweeps.jobs import Job, Runner
from resc.sweeps.launchers import Local, Ray, Slurm
from resc.sweeps.sweep import require_success, run_sweep

ROOT = Path(__file__).parents[2]
STAND_IN = ROOT / "tests" / "stand_in_run.py"
LOCAL, JOBLIB = "launcher=local", "launcher=joblib"
JOBS, N_JOBS = "hydra.launcher.backend.jobs={}", "hydra.launcher.backend.n_jobs={}"
TINY = (
    "num_envs=16",
    "algorithm.steps=8",
    "algorithm.minibatch=64",
    "total_frames=256",
    "compile=false",
    "evaluation_episodes=8",
    "pool_size=16",
    "renew_scenes=0",
    "recorder=none",
    "logger=csv",
)


def job(folder, number, *overrides):
    return Job(folder / str(number), overrides, STAND_IN)


def starts(folder, number):
    return (folder / f"starts_{number}.txt").read_text().split()


def statuses(outcomes):
    return [outcome.status for outcome in outcomes]


def test_runs_are_made_once_whatever_is_asked_again(tmp_path):
    jobs = [job(tmp_path, number, f"seed={number}") for number in range(2)]
    assert statuses(run_sweep(jobs, Local())) == ["finished", "finished"]
    again = run_sweep(jobs, Local())
    assert statuses(again) == ["finished", "finished"]
    assert again[0].sentence == "50.0% succeed (kept)"
    assert [starts(tmp_path, number) for number in range(2)] == [["fresh"], ["fresh"]]
    require_success(again, tmp_path)


def test_one_failing_run_ends_nothing_but_itself_and_says_why(tmp_path):
    jobs = [job(tmp_path, 0, "weight=high"), job(tmp_path, 1, "killed=1"), job(tmp_path, 2)]
    outcomes = run_sweep(jobs, Local())
    assert statuses(outcomes) == ["failed", "failed", "finished"]
    told = (tmp_path / "0" / "failure.txt").read_text()
    assert told.startswith("reward.progress.weight is 'high'; expected a number.\n")
    assert "a table of terms" in told
    killed = (tmp_path / "1" / "failure.txt").read_text()
    assert killed.startswith("killed by SIGKILL; perhaps the memory ran out\n")
    with pytest.raises(SweepError) as raised:
        require_success(outcomes, tmp_path)
    assert str(raised.value) == (
        f"2 of 3 runs are not finished (failed: 0, 1). Why: {tmp_path}/0/failure.txt. "
        f"Go on with: python train.py resume={tmp_path}"
    )


def test_failed_run_is_tried_again_and_then_shows_no_failure(tmp_path):
    first = job(tmp_path, 0, "seed=0")
    first.folder.mkdir()
    (first.folder / "failure.txt").write_text("no memory\n")
    assert statuses(run_sweep([first], Local())) == ["finished"]
    assert not (first.folder / "failure.txt").exists()


def test_stopped_sweep_goes_on_from_the_checkpoint_and_makes_the_rest(tmp_path):
    jobs = [job(tmp_path, number, "wait=1") for number in range(2)]
    stop_when_ready(signal.SIGTERM, tmp_path / "0")
    outcomes = run_sweep(jobs, Local())
    assert statuses(outcomes) == ["stopped", "stopped"]
    assert not (tmp_path / "starts_1.txt").exists()
    with pytest.raises(UnfinishedError, match=r"finished \(stopped: 0, 1\)\. Go on"):
        require_success(outcomes, tmp_path)
    stop_when_ready(signal.SIGTERM, tmp_path / "1")
    assert statuses(run_sweep(jobs, Local())) == ["finished", "stopped"]
    assert starts(tmp_path, 0) == ["fresh", "resumed"]
    assert statuses(run_sweep(jobs, Local())) == ["finished", "finished"]
    assert starts(tmp_path, 0) == ["fresh", "resumed"]


def stop_when_ready(number, *folders):
    """Sends this process a signal as soon as a run is under way in each of the folders."""

    def stop():
        deadline = time.monotonic() + 60
        while not all((folder / "ready").exists() for folder in folders):
            if time.monotonic() > deadline:
                return
            time.sleep(0.02)
        os.kill(os.getpid(), number)

    threading.Thread(target=stop, daemon=True).start()


@pytest.mark.parametrize(("code", "status"), [(3, "stopped"), (130, "stopped"), (1, "failed")])
def test_what_came_of_a_run_is_its_exit_code_not_what_it_said_last(tmp_path, code, status):
    script = tmp_path / "script.py"
    script.write_text(f"import sys; print('Stopped after 100 frames.'); sys.exit({code})")
    assert Runner()(Job(tmp_path / "0", (), script)).status == status


def test_run_that_another_process_makes_is_left_to_it(tmp_path):
    busy = job(tmp_path, 0)
    busy.folder.mkdir()
    with (busy.folder / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert Runner()(busy).status == "busy"
    assert Runner()(busy).status == "finished"


def test_cut_summary_is_no_finished_run(tmp_path):
    cut = job(tmp_path, 0)
    run_sweep([cut], Local())
    (cut.folder / "summary.json").write_text('{"episodes": 8, "succ')
    assert not cut.finished
    run_sweep([cut], Local())
    assert starts(tmp_path, 0) == ["fresh", "fresh"]


def test_study_that_changed_is_refused_before_anything_runs(tmp_path):
    run_sweep([job(tmp_path, 0, "seed=0")], Local())
    with pytest.raises(ConfigError, match="holds the run 'seed=0', but job 0 of this sweep is 's"):
        run_sweep([job(tmp_path, 0, "seed=5"), job(tmp_path, 1, "seed=6")], Local())
    assert not (tmp_path / "1").exists()


def test_same_overrides_that_now_make_another_run_are_refused(tmp_path):
    before = Job(tmp_path / "0", (), STAND_IN, config={"reward": {"weight": 2.0}})
    run_sweep([before], Local())
    now = Job(tmp_path / "0", (), STAND_IN, config={"reward": {"weight": 3.0}})
    with pytest.raises(ConfigError, match=r"run with reward\.weight: 2\.0, but now .* 3\.0"):
        run_sweep([now], Local())


def test_run_that_was_lengthened_is_refused_by_its_sweep(tmp_path):
    own = Job(tmp_path / "0", (), STAND_IN, config={"total_frames": 100})
    run_sweep([own], Local())
    (own.folder / "config.yaml").write_text("total_frames: 200\n")
    with pytest.raises(ConfigError, match=r"says total_frames: 200, but its sweep began .* 100"):
        run_sweep([own], Local())


def test_new_try_of_a_run_without_a_checkpoint_begins_in_an_empty_folder(tmp_path):
    failing = job(tmp_path, 0, "weight=high")
    run_sweep([failing], Local())
    (failing.folder / "rollouts").mkdir()
    (failing.folder / "rollouts" / "old.mcap").touch()
    (failing.folder / "progress.csv").touch()
    run_sweep([failing], Local())
    left = sorted(path.name for path in failing.folder.iterdir())
    assert left == [".lock", "failure.txt", "job.json", "log.txt", "started.json"]


@pytest.mark.parametrize("what", ["file", "files of one's own"])
def test_what_stands_where_a_run_goes_is_refused_and_left(tmp_path, what):
    place = tmp_path / "0"
    if what == "file":
        place.write_text("mine")
    else:
        place.mkdir()
        (place / "thesis.tex").write_text("mine")
    with pytest.raises(ConfigError, match="move it away"):
        run_sweep([job(tmp_path, 0)], Local())
    assert (place if what == "file" else place / "thesis.tex").read_text() == "mine"


def test_folder_of_another_sweep_or_of_a_run_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["train.py", "-m", "seed=0,1", "launcher=local"])
    begin(tmp_path / "same", "-m", "launcher=serial", "seed=0,1", "hydra.sweep.dir=same")
    require_own_folder(tmp_path / "same")
    begin(tmp_path / "other", "-m", "seed=2,3")
    with pytest.raises(ConfigError, match=r"holds another sweep; .* python train\.py resume="):
        require_own_folder(tmp_path / "other")
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "config.yaml").touch()
    with pytest.raises(ConfigError, match=r"holds a run; .* hydra\.sweep\.dir"):
        require_own_folder(tmp_path / "run")
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="is a file"):
        require_own_folder(tmp_path / "file")


def test_of_two_sweeps_begun_at_once_in_one_folder_the_second_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["train.py", "-m", "seed=0,1"])
    claim(tmp_path)
    first = (tmp_path / "origin.json").read_text()
    monkeypatch.setattr(sys, "argv", ["train.py", "-m", "seed=2,3"])
    with pytest.raises(ConfigError, match="holds another sweep"):
        claim(tmp_path)
    assert (tmp_path / "origin.json").read_text() == first
    assert [path.name for path in tmp_path.iterdir()] == ["origin.json"]


def test_folder_that_cannot_be_written_is_told(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["train.py", "-m", "seed=0,1"])
    with pytest.raises(ConfigError, match="/proc/nope cannot be written"):
        claim(Path("/proc/nope"))


def test_run_that_cannot_be_started_fails_alone(tmp_path, capsys):
    lost = Job(tmp_path / "0", ("seed=0",), STAND_IN, directory=tmp_path / "gone")
    outcomes = run_sweep([lost, job(tmp_path, 1, "seed=1")], Local())
    assert statuses(outcomes) == ["failed", "finished"]
    assert outcomes[0].sentence == f"cannot be run, {tmp_path}/gone: No such file or directory"


def test_runs_are_counted_over_the_whole_sweep(tmp_path, capsys):
    run_sweep([job(tmp_path, 2)], Local(), before=2, total=20)
    assert capsys.readouterr().out.startswith("[3/20] run 2: finished")


def test_parallel_runs_are_under_way_together(tmp_path):
    jobs = [job(tmp_path, number, "wait=1") for number in range(2)]
    stop_when_ready(signal.SIGINT, *(one.folder for one in jobs))
    assert statuses(run_sweep(jobs, Local(jobs=2))) == ["stopped", "stopped"]
    assert statuses(run_sweep(jobs, Local(jobs=2))) == ["finished", "finished"]
    assert [starts(tmp_path, number) for number in range(2)] == [["fresh", "resumed"]] * 2


@pytest.mark.slow
def test_jobs_go_through_submitit_to_processes_of_their_own(tmp_path):
    pytest.importorskip("submitit")
    jobs = [job(tmp_path, 0, "seed=0"), job(tmp_path, 1, "weight=high")]
    backend = Slurm(
        cluster="local",
        folder=str(tmp_path / ".submitit"),
        timeout_min=2,
        cpus_per_task=1,
        mem_gb=1.0,
        array_parallelism=2,
    )
    outcomes = run_sweep(jobs, backend)
    assert statuses(outcomes) == ["finished", "failed"]
    assert outcomes[1].sentence == "reward.progress.weight is 'high'; expected a number."


def test_missing_slurm_is_told(tmp_path, monkeypatch):
    pytest.importorskip("submitit")
    monkeypatch.setenv("PATH", str(tmp_path))
    backend = Slurm(
        cluster="slurm",
        folder=str(tmp_path),
        timeout_min=2,
        cpus_per_task=1,
        mem_gb=1.0,
        array_parallelism=2,
    )
    with pytest.raises(ConfigError, match="is there a SLURM here"):
        run_sweep([job(tmp_path, 0)], backend)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # Ray's own
def test_jobs_go_through_a_ray_cluster_that_is_stopped_afterwards(tmp_path):
    ray = pytest.importorskip("ray")
    jobs = [job(tmp_path, 0, "seed=0"), job(tmp_path, 1, "weight=high")]
    assert statuses(run_sweep(jobs, Ray(cluster_cpus=1))) == ["finished", "failed"]
    assert not ray.is_initialized()


@pytest.mark.parametrize("room", ["resc.sweeps", "resc.sweeps.sweep"])
@pytest.mark.parametrize("name", ["Joblib", "Serial"])
def test_launcher_of_a_stored_configuration_is_found_where_it_is_today(room, name):
    assert isinstance(build({"_target_": f"{room}.{name}"}, "hydra.launcher.backend"), Local)


def test_launcher_that_is_not_installed_names_the_extra(tmp_path):
    if importlib.util.find_spec("ray"):
        pytest.skip("Ray is installed")
    with pytest.raises(ConfigError, match=r"needs ray, .* pip install -e '\.\[ray\]'"):
        run_sweep([job(tmp_path, 0)], Ray())


def begin(folder, *arguments, **facts):
    """Writes down that a sweep was begun with these arguments."""
    folder.mkdir(exist_ok=True)
    origin = {"command": shell("python", "train.py", *arguments), **facts}
    (folder / "origin.json").write_text(json.dumps(origin))


def test_folder_of_a_sweep_resumes_the_command_that_began_it(tmp_path):
    begin(tmp_path, "-m", "+experiment=ablate_history", "launcher=local", "seed=0,1")
    assert resumed_sweep([f"resume={tmp_path}", "launcher=slurm"]) == [
        "-m",
        "+experiment=ablate_history",
        "seed=0,1",
        "launcher=slurm",
        f"hydra.sweep.dir={tmp_path}",
    ]


@pytest.mark.parametrize(
    ("begun", "given", "today"),
    [
        (["launcher=serial"], [], [LOCAL]),
        ([JOBLIB], [], [LOCAL, JOBS.format(2)]),
        ([JOBLIB, N_JOBS.format(3)], [], [LOCAL, JOBS.format(3)]),
        (
            [JOBLIB, N_JOBS.format(3)],
            [JOBS.format(4)],
            [LOCAL, JOBS.format(4)],
        ),
        ([JOBLIB, N_JOBS.format(3)], ["launcher=ray"], ["launcher=ray"]),
    ],
)
def test_sweep_begun_with_a_launcher_of_before_goes_on_with_todays(tmp_path, begun, given, today):
    begin(tmp_path, "-m", *begun, "seed=0,1")
    expected = ["-m", *today, "seed=0,1", f"hydra.sweep.dir={tmp_path}"]
    assert sorted(resumed_sweep([f"resume={tmp_path}", *given])) == sorted(expected)


def test_folder_of_a_run_is_left_to_the_run(tmp_path):
    arguments = [f"resume={tmp_path}", "total_frames=10"]
    assert resumed_sweep(arguments) == arguments


def train(*arguments):
    command = [sys.executable, ROOT / "train.py", *arguments]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=600
    )


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """A sweep of two parts and two seeds, of which one part is out of range, as a user makes it."""
    folder = tmp_path_factory.mktemp("sweep")
    variants = "observation.velocity.noise=0.0,-1.0"
    done = train("-m", *TINY, "seed=0,1", variants, f"hydra.sweep.dir={folder}")
    return folder, done


@pytest.mark.slow
def test_sweep_finishes_what_can_be_and_exits_with_one_sentence(swept):
    folder, done = swept
    assert done.returncode == 1
    assert (
        done.stderr.strip()
        .splitlines()[-1]
        .startswith("error: 2 of 4 runs are not finished (failed: 1, 3).")
    )
    assert "noise is -1.0" in (folder / "1" / "failure.txt").read_text()
    for number in (0, 2):
        assert json.loads((folder / str(number) / "summary.json").read_text())["episodes"] == 8
        assert (folder / str(number) / "evaluation.csv").read_text().count("\n") == 9


@pytest.mark.slow
def test_sweep_leaves_a_report_that_shows_its_failures(swept):
    folder, _ = swept
    report = (folder / "report" / "report.md").read_text()
    assert "2 of 4 runs finished" in report
    assert "| 1 | -1.0 | 0 |" in report
    assert "**failed**: observation.velocity: noise is -1.0" in report


@pytest.mark.slow
def test_sweep_goes_on_by_its_folder_alone_without_training_twice(swept):
    folder, _ = swept
    before = (folder / "0" / "policy.pt").stat().st_mtime_ns
    done = train(f"resume={folder}")
    assert done.returncode == 1
    assert done.stdout.count("(kept)") == 2
    assert (folder / "0" / "policy.pt").stat().st_mtime_ns == before


@pytest.mark.slow
def test_runs_of_a_sweep_fly_the_same_held_out_scenes(swept):
    folder, _ = swept
    texts = [(folder / number / "evaluation.csv").read_text() for number in ("0", "2")]
    columns = [[line.split(",")[:3] for line in text.splitlines()] for text in texts]
    assert columns[0] == columns[1]
    assert columns[0][0] == ["scene", "obstacles", "density"]


@pytest.mark.slow
def test_optuna_tunes_by_what_came_of_the_runs_before(tmp_path):
    pytest.importorskip("optuna")
    done = train(
        "-m",
        "+experiment=tune_reward",
        *TINY[:-2],
        "hydra.sweeper.trials=3",
        "hydra.sweeper.batch=1",
        f"hydra.sweep.dir={tmp_path}",
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "best.yaml").exists()
    weights = {
        text
        for number in range(3)
        for text in json.loads((tmp_path / str(number) / "job.json").read_text())["overrides"]
        if text.startswith("reward.progress.weight=")
    }
    assert len(weights) == 3
    assert all(0.3 <= float(text.partition("=")[2]) <= 10.0 for text in weights)
