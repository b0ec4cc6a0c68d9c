"""The files of a run, damaged one at a time, and everything that reads them."""

import contextlib
import io
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import torch
from omegaconf import DictConfig, OmegaConf
from resumed_by import resumed_by

from resc.build import load_config
from resc.errors import RescError
from resc.flying.replay import fly_again
from resc.learning.beginning import restore
from resc.learning.progress import ProgressTable
from resc.learning.training import train_and_save
from resc.learning.training_run import TrainingRun
from resc.log_command import main as resc_log
from resc.policies.stored import load_policy
from resc.process import prepare_process
from resc.recording.reader import RolloutLog
from resc.run_folder import finish_run, is_finished, succeeded, summary_of
from resc.studies.ablation_analysis import analyse
from resc.studies.study import read_sweep

OVERRIDES = (["seed=0"], ["seed=1"])
TRASH = {
    "empty": b"",
    "trash": b"trash",
    "binary": b"\xff\xfe\x00\x80" * 50,
    "a number": b"3",
    "null": b"null",
    "a list": b"[1, 2]",
    "an empty object": b"{}",
    "other names": b'{"foo": {"bar": 1}}',
    "wrong types": b'{"success_rate": "x", "frames": [], "overrides": 3, "episodes": {}}',
}
CUT = {"cut in half": 0.5, "cut at the end": 0.98}
DAMAGES = ("missing", "a folder", "a link to itself", *TRASH, *CUT)


def make_sweep(config: DictConfig, folder: Path) -> None:
    """A sweep of two runs as train.py leaves it, of a few steps each."""
    for number, overrides in enumerate(OVERRIDES):
        run = folder / str(number)
        run.mkdir(parents=True)
        config = config.copy()
        config["seed"] = number
        OmegaConf.save(config, run / "config.yaml", resolve=True)
        with quiet():
            training = TrainingRun(config, overrides)
            summary = train_and_save(training.trainer(), training, run, training.logger(run))
            flights = training.fly_held_out(run)
        rates = {"success_rate": flights.success_rate, "collision_rate": 0.0}
        finish_run(run, summary | {"episodes": len(flights), **rates}, "train")
        for name in ("job.json", "origin.json"):
            (run / name).write_text(json.dumps({"overrides": overrides}))
    (folder / "origin.json").write_text(json.dumps({"command": "python train.py -m seed=0,1"}))


def readers(config: DictConfig) -> dict[str, Callable[[Path], object]]:
    """Everything that reads a sweep's folder, by what a user calls it."""

    def fly(sweep: Path) -> None:
        policy = load_policy(sweep / "0")
        policy(torch.zeros(1, sum(width for _, width in policy.layout)))

    def resume(sweep: Path) -> None:
        run = sweep / "0"
        again = resumed_by(DictConfig({**config, "resume": str(run)}), ["resume=x"], run)
        summary = summary_of(run)
        if is_finished(run) and summary["frames"] > again["total_frames"]:
            succeeded(summary)
        prepare_process(again["threads"], again["device"])
        trainer = TrainingRun(again).trainer()
        restore(trainer, run, resumes=True, init_from=again["init_from"])
        ProgressTable(run / "progress.csv", trainer.frames)
        trainer.iterate()

    def report(sweep: Path) -> None:
        analyse(read_sweep(sweep))

    def finished(sweep: Path) -> None:
        if is_finished(sweep / "0"):
            succeeded(summary_of(sweep / "0"))

    def log(*words: str) -> Callable[[Path], None]:
        return lambda sweep: run_log([words[0], str(sweep / "0" / "rollouts"), *words[1:]], sweep)

    return {
        "policy": fly,
        "resume": resume,
        "report": report,
        "finished": finished,
        "replay": lambda sweep: fly_again(f"{sweep / '0' / 'held_out'}#0"),
        "RolloutLog": lambda sweep: RolloutLog(sweep / "0" / "rollouts").batch(0),
        "info": log("info"),
        "check": log("check"),
        "episodes": log("episodes"),
    }


READ_BY = {
    "policy.pt": ("policy",),
    "config.yaml": ("policy", "resume", "report"),
    "checkpoint.pt": ("resume",),
    "progress.csv": ("resume", "report"),
    "evaluation.csv": ("report", "finished"),
    "summary.json": ("report", "finished", "resume"),
    "job.json": ("report", "resume"),
    "origin.json": ("resume",),
    "../origin.json": ("report",),
    "held_out/rollouts_00000.mcap": ("replay",),
    "rollouts/rollouts_00000.mcap": ("RolloutLog", "info", "check", "episodes"),
}
"""Which readers meet a file."""


def file_cases() -> Iterator[tuple[str, str, str]]:
    """Every file, damage and reader; also swapped with each other file, and settings gone."""
    for name, called in READ_BY.items():
        for damage in (*DAMAGES, *(f"swapped with {other}" for other in READ_BY if other != name)):
            yield from ((name, damage, reader) for reader in called)
    for group in ("env", "model", "observation", "task", "device", "vehicle", "scene", "seed"):
        for damage in (f"without {group}", f"{group} is null", f"{group} is x"):
            yield from (("config.yaml", damage, reader) for reader in READ_BY["config.yaml"])


@contextlib.contextmanager
def damaged(sweep: Path, name: str, damage: str) -> Iterator[None]:
    """Damages a file of the first run; mends it afterwards."""
    path = sweep / "0" / name
    kept = path.read_bytes()
    try:
        damage_file(path, kept, damage, sweep)
        yield
    finally:
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        path.unlink(missing_ok=True)
        path.write_bytes(kept)


def damage_file(path: Path, kept: bytes, damage: str, sweep: Path) -> None:
    """Does one damage to a file that holds some bytes."""
    first, _, rest = damage.partition(" ")
    path.unlink()
    if damage == "a folder":
        path.mkdir()
    elif damage == "a link to itself":
        path.symlink_to(path.name)
    elif damage in TRASH:
        path.write_bytes(TRASH[damage])
    elif damage in CUT:
        path.write_bytes(kept[: int(len(kept) * CUT[damage])])
    elif damage.startswith("swapped with "):
        path.write_bytes((sweep / "1" / damage.removeprefix("swapped with ")).read_bytes())
    elif damage != "missing":
        path.write_bytes(kept)
        config = load_config(path)
        if first == "without":
            del config[rest]
        else:
            config[first] = None if damage.endswith("null") else "x"
        OmegaConf.save(config, path)


def run_log(arguments: list[str], sweep: Path) -> None:
    """Runs resc-log; what it says on standard error must be one sentence."""
    with quiet() as said:
        try:
            resc_log(arguments)
        except SystemExit as ending:
            if isinstance(ending.code, str):
                raise RescError(ending.code.removeprefix("error: ")) from None
    if "Traceback" in said.getvalue():
        raise AssertionError(said.getvalue())


@contextlib.contextmanager
def quiet() -> Iterator[io.StringIO]:
    """Collects what is said."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        yield said
