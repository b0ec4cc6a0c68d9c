"""Flies all policies of a sweep through suites: which variant flies them best, and how fast.

python -m resc.studies.scores runs/latest_sweep suite=forest maps=30
python -m resc.studies.scores runs/latest_sweep 'suite=[paper,forest,field]' maps=30

Any override of evaluate.py is taken but policy, pilot, replay and the folder. An evaluation of
every finished run is left in <run>/scores/<suite>; one that is there already, of the same policy,
settings and references, is not flown again. The report is in <sweep>/report, over the maps that
are the same for all runs.
"""

import shutil
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from omegaconf import DictConfig, OmegaConf

from resc import schema
from resc.command_line import override
from resc.console import logged
from resc.errors import ConfigError
from resc.evaluation.campaign import Evaluation
from resc.evaluation.suites import amounts_of, scenes_to_fly
from resc.policies.stored import load_policy
from resc.process import prepare_process
from resc.run_folder import LATEST, latest, summary_of
from resc.settings import check_settings
from resc.starting.answers import answering
from resc.starting.composed import compose_scenes, given, suites
from resc.starting.launch import SHOWING, launch_here
from resc.studies.score_report import Score, read_score, write_scores
from resc.studies.shared_scores import on_same_maps
from resc.studies.study import Run, Sweep, read_sweep

SCORES, REPORT = "scores", "report"
SINGLE = "scenes"
"""What a list of scenes is called beside suites."""
OWN = ("policy", "pilot", "replay", "hydra.run.dir")
"""Settings of an evaluation that are not the user's here."""
USAGE = "python -m resc.studies.scores runs/latest_sweep suite=forest maps=30"

Settings = dict[str, Any]
Flown = tuple[str, Settings, Mapping[str, Settings]]


@dataclass(frozen=True)
class Scoring:
    """The runs of a sweep, flown through suites.

    Args:
        config: Of an evaluation whose policy is the sweep's folder.
        folder: Where the report goes.
    """

    config: DictConfig
    folder: Path

    def __call__(self) -> None:
        """Flies what is not there yet, and writes the report."""
        check_settings(self.config, schema.EvaluateSchema)
        OmegaConf.resolve(self.config)
        prepare_process(self.config["threads"], self.config["device"])
        sweep = read_sweep(Path(self.config["policy"]))
        chosen = list(self.evaluations())
        with logged(self.folder / "scores.log"):
            scores = list(fly_sweep(sweep, chosen, given()))
            folders = {(s.run.number, s.suite): folder_of(sweep, s.run, s.suite) for s in scores}
            scores = on_same_maps(scores, folders)
            print(write_scores(sweep, scores, self.folder))

    def evaluations(self) -> Iterator[Flown]:
        """Each suite: its name, its settings and its scenes."""
        names = scenes_to_fly(self.config["scenes"], self.config["suite"], given())
        scenes = compose_scenes(names, self.config["scene"])
        settings = cast(Settings, OmegaConf.to_container(self.config, resolve=True))
        often = {name: settings[name] for name in ("maps", "flights")}
        if settings["scenes"] is not None:
            yield SINGLE, settings, scenes
            return
        amounts = amounts_of(scenes, settings["suite"], **often)
        named = suites()
        rest = [name for name in scenes if not any(name in own for own in named.values())]
        for suite, own in {**named, **({SINGLE: rest} if rest else {})}.items():
            there = [name for name in own if name in scenes]
            of_suite = {name: settings["suite"][name] for name in there}
            draws = any(amounts[name].maps for name in there)
            maps = settings["maps"] if draws else None  # of a suite of fixed maps it is refused
            own_settings = {**settings, "suite": of_suite, "maps": maps}
            yield suite, own_settings, {name: scenes[name] for name in there}


def fly_sweep(sweep: Sweep, chosen: Sequence[Flown], overrides: Sequence[str]) -> Iterator[Score]:
    """The score of every finished run in every suite, flown unless it is there already."""
    runs = sweep.finished()
    total = len(runs) * len(chosen)
    for number, run in enumerate(runs):
        for place, (suite, settings, scenes) in enumerate(chosen, start=1):
            folder = folder_of(sweep, run, suite)
            own = {**settings, "policy": str(sweep.folder / str(run.number))}
            policy = load_policy(Path(own["policy"]), own["device"], own["allowed_targets"])
            there = _fly(Evaluation(own, policy, scenes, overrides), folder)
            score = read_score(folder, run, suite)
            told = "was there already" if there else f"{score.flights} flights"
            done = f"{number * len(chosen) + place} of {total}"
            print(
                f"{done}: run {run.number} ({run.variant}, seed {run.seed}), {suite}: "
                f"{score.values['success_rate']:.1%} succeed, {told}"
            )
            yield score


def folder_of(sweep: Sweep, run: Run, suite: str) -> Path:
    """Where the evaluation of a run in a suite is left."""
    return sweep.folder / str(run.number) / SCORES / suite


def _fly(evaluation: Evaluation, folder: Path) -> bool:
    """Flies an evaluation into the folder; whether that was done before."""
    if summary_of(folder).get("fingerprint") == evaluation.fingerprint:
        return True
    if folder.exists():  # of other settings, or cut short
        shutil.rmtree(folder)
    evaluation.fly(folder)
    return False


def as_evaluation(arguments: Sequence[str]) -> list[str]:
    """The arguments of evaluate.py for those of this command.

    Raises:
        ConfigError: No sweep is named, or a setting is not the user's.
    """
    folders = [text for text in arguments if "=" not in text and not text.startswith(("-", "~"))]
    if any(text in ("-m", "--multirun") for text in arguments):
        raise ConfigError("All runs of the sweep are flown anyway; leave out -m.")
    if any(text in ("-h", "--help") for text in arguments):
        print(__doc__)
        sys.exit()
    if shown := [text for text in arguments if text in SHOWING]:
        raise ConfigError(
            f"{shown[0]} shows settings, and this flies; leave it out, or give it to evaluate.py."
        )
    if len(folders) != 1:
        raise ConfigError(f"Name one folder of a sweep, {len(folders)} are named: {USAGE}")
    rest = [text for text in arguments if text not in folders]
    if own := [text for text in rest if text.lstrip("+").partition("=")[0] in OWN]:
        raise ConfigError(f"The policies are those of the sweep's runs; leave out {own[0]}.")
    named = latest("sweep", "sweep") if folders[0] == LATEST else Path(folders[0])
    folder = named.resolve()
    if not folder.is_dir():
        raise ConfigError(
            f"{folders[0]} does not exist; give the folder of a sweep: runs/<date>/<name>."
        )
    into = override("hydra.run.dir", folder / REPORT)
    return [*rest, override("policy", folder), into]


if __name__ == "__main__":
    with answering():
        sys.argv[1:] = as_evaluation(sys.argv[1:])
    schema.register()
    launch_here(Scoring, "evaluate")
