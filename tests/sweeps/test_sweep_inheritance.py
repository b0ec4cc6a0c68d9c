"""What the runs of a sweep inherit from its command; what is refused before any of them runs."""

import json
import shlex
import shutil
import sys
from pathlib import Path

import pytest
from omegaconf import OmegaConf

import resc.schema
from hydra_plugins.resc_sweeps import refuse_what_runs_cannot_follow, require_different
from resc.build import build
from resc.errors import ConfigError
from resc.starting.arguments import resumed_sweep
from resc.sweeps.jobs import Job

ROOT = Path(__file__).parents[2]


def started(folder):
    """What the stand-in was started with."""
    return json.loads((folder / "started.json").read_text())


@pytest.fixture
def own(tmp_path):
    """A folder with a primary configuration and a reward of one's own."""
    folder = tmp_path / "my conf"
    (folder / "reward").mkdir(parents=True)
    (folder / "mine.yaml").write_text(
        "defaults: [train, _self_]\nname: mine\nreward: {progress: {weight: 7.0}}\n"
        "model: {hidden: [16]}\n"
    )
    (folder / "reward" / "level.yaml").write_text(
        "level: {_target_: resc.terms.rewards.time.Time, weight: 1.5}\n"
    )
    return folder


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (
            ("--config-dir", "my conf", "-cn", "mine", "~reward.time", "hydra.verbose=[resc]"),
            {"reward.progress.weight": 7.0, "model.hidden": [16], "reward.time": None},
        ),
        (
            (
                "hydra.searchpath=['file://my conf']",
                "reward=[progress,level]",
                "+experiment=ablate_network",
                "model.hidden=[8]",
                "model.activation=elu",
                "name='a, b'",
            ),
            {"reward.level.weight": 1.5, "model.hidden": [8], "name": "a, b"},
        ),
    ],
)
def test_run_of_a_sweep_composes_what_the_command_says(start, own, tmp_path, arguments, expected):
    start("-m", *arguments, "seed=0", "hydra.sweep.dir=swept")
    folder = tmp_path / "swept" / "0"
    (child,) = start(*started(folder)["argv"][1:])
    assert {key: OmegaConf.select(child, key) for key in expected} == expected
    begun = json.loads((folder / "job.json").read_text())["config"]
    assert begun == json.loads(json.dumps(OmegaConf.to_container(child)))


@pytest.mark.slow
def test_run_of_a_sweep_gets_flags_variables_and_directory_of_its_command(
    start, own, tmp_path, monkeypatch
):
    monkeypatch.setenv("PYTHONPATH", "mine:/other")
    (own / "mine.yaml").write_text(
        "defaults: [train, _self_]\nhydra: {mode: MULTIRUN, job: {env_set: {FLOWN_BY: me}}}\n"
    )
    start("-cd", "my conf", "-cn", "mine", "seed=0", "hydra.sweep.dir=swept")
    run = started(tmp_path / "swept" / "0")
    assert run["environment"]["FLOWN_BY"] == "me"
    assert run["environment"]["PYTHONPATH"] == f"{tmp_path}/mine:/other"
    assert run["directory"] == str(tmp_path)
    assert run["optimize"] == sys.flags.optimize
    assert "hydra.mode=RUN" in run["argv"]


@pytest.mark.slow
def test_sweep_goes_on_in_the_directory_where_it_began(start, own, tmp_path, monkeypatch):
    command = ("-m", "-cd", "my conf", "-cn", "mine", "seed=0,1", "hydra.sweep.dir=swept")
    start(*command)
    first = started(tmp_path / "swept" / "1")
    shutil.rmtree(tmp_path / "swept" / "1")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    start("resume=../swept")
    assert started(tmp_path / "swept" / "1")["argv"] == first["argv"]
    origin = json.loads((tmp_path / "swept" / "origin.json").read_text())
    assert shlex.split(origin["command"])[2:] == [*command, *shlex.split(origin["command"])[-2:]]
    assert not list(elsewhere.iterdir())


def test_sweep_whose_modules_or_directory_are_gone_is_refused(tmp_path, monkeypatch):
    facts = {"command": "python train.py -m seed=0,1", "PYTHONPATH": "/gone/modules"}
    (tmp_path / "origin.json").write_text(json.dumps(facts))
    with pytest.raises(ConfigError, match="set it again: PYTHONPATH=/gone"):
        resumed_sweep([f"resume={tmp_path}"])
    facts = {"command": "python train.py -m seed=0,1", "directory": "/gone"}
    (tmp_path / "origin.json").write_text(json.dumps(facts))
    with pytest.raises(ConfigError, match="was begun in /gone, where its command"):
        resumed_sweep([f"resume={tmp_path}"])


@pytest.mark.parametrize(
    ("given", "refused"),
    [("seed=3", "seed=3"), ("total_frames=9", "total_frames=9"), ("-cn=mine", "-cn=mine")],
)
def test_sweep_goes_on_as_it_was_begun_or_is_refused(tmp_path, given, refused):
    (tmp_path / "origin.json").write_text(json.dumps({"command": "python train.py -m seed=0,1"}))
    with pytest.raises(ConfigError, match=f"leave out {refused}; only how it is run may change"):
        resumed_sweep([f"resume={tmp_path}", given])


def test_folder_does_not_permit_foreign_targets_for_those_who_go_on(tmp_path):
    command = "python train.py -m 'allowed_targets=[mine.]' seed=0,1"
    (tmp_path / "origin.json").write_text(json.dumps({"command": command}))
    resume = f"resume={tmp_path}"
    with pytest.raises(ConfigError, match="a folder cannot permit for you") as raised:
        resumed_sweep([resume])
    line = str(raised.value).partition("go on with: ")[2]
    assert resumed_sweep(shlex.split(line)[2:])[:3] == ["-m", "allowed_targets=[mine.]", "seed=0,1"]
    with pytest.raises(ConfigError, match="a folder cannot permit for you"):
        resumed_sweep([resume, "allowed_targets=[other.]"])


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("seed=range(0,0)",), "The overrides name no run at all"),
        (("seed=0,00",), "Jobs 0 and 1 are the same run ('seed=0' and 'seed=00')"),
        (("hydra.launcher.backend.jobs=0",), "hydra.launcher.backend.jobs is 0; expected a number"),
    ],
)
def test_what_no_sweep_can_be_is_refused_before_anything_runs(refusal, tmp_path, arguments, told):
    assert told in refusal("-m", *arguments, "hydra.sweep.dir=swept")
    assert not (tmp_path / "swept" / "origin.json").exists()
    assert not (tmp_path / "swept" / "0").exists()


def test_jobs_that_are_one_run_are_refused_however_they_are_written(tmp_path):
    def job(number, *overrides, **config):
        return Job(tmp_path / str(number), overrides, config=config)

    require_different([job(0, "w=1", w=1), job(1, "w=2", w=2)])
    with pytest.raises(ConfigError, match=r"Jobs 0 and 2 are the same run \('w=1' and 'w=1\.0'\)"):
        require_different([job(0, "w=1", w=1), job(1, "w=2", w=2), job(2, "w=1.0", w=1.0)])
    with pytest.raises(ConfigError, match="Jobs 0 and 1 are the same run, which a report would"):
        require_different([job(0, "w=1", w=1), job(1, "w=1", w=1)])


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"sweep": {"subdir": "x"}}, r"hydra\.sweep\.subdir is set"),
        ({"sweeper": {"max_batch_size": 1}}, r"hydra\.sweeper\.max_batch_size is set"),
        ({"overrides": {"hydra": ["hydra.mode=RUN"]}}, r"hydra\.mode=RUN is of a single run"),
        ({"overrides": {"hydra": ["hydra.run.dir=x"]}}, r"hydra\.run\.dir=x is of a single run"),
    ],
)
def test_setting_of_hydra_that_runs_could_not_follow_is_refused(changes, told):
    usual = {"sweep": {"subdir": "${hydra.job.num}"}, "sweeper": {}, "overrides": {"hydra": []}}
    refuse_what_runs_cannot_follow(OmegaConf.create({"hydra": usual}))
    with pytest.raises(ConfigError, match=told):
        refuse_what_runs_cannot_follow(OmegaConf.create({"hydra": {**usual, **changes}}))


def test_one_run_is_not_resumed_many_times(refusal, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "config.yaml").touch()
    assert "resume is 'mine', which is one run" in refusal("-m", "resume=mine", "seed=0,1")


def test_rerun_of_hydra_is_refused(refusal):
    told = refusal("--experimental-rerun", "x.pickle")
    assert told.startswith("error: --experimental-rerun does not know the folders of runs")


@pytest.mark.parametrize(
    ("name", "changes", "told"),
    [
        ("local", {"jobs": "two"}, "backend.jobs is 'two'; expected"),
        ("local", {"jobs": -1}, "backend.jobs is -1; expected a number from 1"),
        ("local", {"n_jobs": 2}, "backend.n_jobs is not an argument of Local. Did you mean 'jobs'"),
        ("local", {"_target_": "os.system"}, "opt in with allowed_targets"),
        ("slurm", {"cluster": "foo", "folder": "x"}, "cluster is 'foo'; expected slurm or local"),
        ("slurm", {"mem_gb": 0, "folder": "x"}, "mem_gb is 0.* expected a number above 0"),
        ("slurm", {"timeout_min": -1, "folder": "x"}, "timeout_min is -1"),
        ("ray", {"num_cpus": 999}, "num_cpus is 999.*, but the cluster has .*; ask for fewer"),
        ("ray", {"cluster_cpus": 0}, "cluster_cpus is 0"),
    ],
)
def test_settings_that_no_launcher_has_are_refused(name, changes, told):
    settings = OmegaConf.load(ROOT / "conf" / "launcher" / f"{name}.yaml")
    with pytest.raises(ConfigError, match=told):
        build(OmegaConf.merge(settings, changes), "hydra.launcher.backend")


@pytest.mark.parametrize("mode", [(), ("-m", "seed=0")])
def test_name_that_leaves_the_runs_folder_is_refused_before_it_is_made(refusal, tmp_path, mode):
    assert "expected part of a folder's name" in refusal(*mode, "name=../up")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["a..", "lr=0.1, b", "ünï 'x' \"y\" #"])
def test_name_may_hold_what_a_folder_can(name):
    assert resc.schema.folder_name(name) == name


@pytest.mark.parametrize("name", ["..", "", "a/b", "${seed}", "n" * 201, "ü" * 101, "a\nb"])
def test_name_that_no_folder_can_have_is_refused(name):
    with pytest.raises(ConfigError, match="expected part of a folder's name"):
        resc.schema.folder_name(name)


def test_folder_that_cannot_be_made_is_told(refusal):
    assert "/proc/nope cannot be used" in refusal("hydra.run.dir=/proc/nope")
    assert "/proc/nope" in refusal("-m", "seed=0", "hydra.sweep.dir=/proc/nope")


def test_unknown_interpolation_is_told(refusal):
    assert "Interpolation key 'b' not found" in refusal("hydra.run.dir=x${b}")
