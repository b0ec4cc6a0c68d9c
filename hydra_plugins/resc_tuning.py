"""Hydra's door to Optuna: a sweeper that tunes.

hydra-optuna-sweeper 1.3.0 wants optuna below 3.
"""

import fcntl
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeGuard

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import ChoiceSweep, IntervalSweep, Override
from hydra.core.plugins import Plugins
from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, OmegaConf

from hydra_plugins.resc_sweeps import SweepLauncher
from resc.command_line import override, split_override
from resc.errors import ConfigError, SweepError, nearest, needed
from resc.run_folder import SUMMARY, summary_of
from resc.studies.tuning_study import best_trials, open_study, read_tuning
from resc.sweep_folder import go_on
from resc.sweeps.jobs import Outcome
from resc.sweeps.sweep import require_success

UNTUNED = "untuned"
"""What the runs are named that are trained beside the best: without any choice of the trials."""
ASKING = ".asking"
"""Locked while trials are chosen."""


class OptunaSweeper(Sweeper):
    """Chooses the next runs by what came of those before, with Optuna's TPE sampler.

    Maximises one number of the runs' summaries. The study is kept in the sweep's folder, so that an
    interrupted one goes on, and several processes may tune it at a time. With `best_of`, the best
    trials of such a study are trained again.

    Args:
        objective: The number in summary.json.
        trials: Runs in all.
        batch: Runs begun together, before any of them tells anything.
        seed: Of the sampler.
        params: What is tuned, as overrides: `interval(a, b)`, `tag(log, interval(a, b))` or
            choices.
        best_of: Folder of a finished sweep whose best trials are trained instead of tuning.
        best: How many of them.
        seeds: With how many seeds, none of them that of the tuning.
    """

    def __init__(
        self,
        objective: str,
        trials: int,
        batch: int,
        seed: int,
        params: Mapping[str, str],
        best_of: str | None,
        best: int,
        seeds: int,
    ) -> None:
        self.best_of, self.best, self.seeds = best_of, best, seeds
        self.objective, self.trials, self.batch, self.seed = objective, trials, batch, seed
        self.params = params

    def setup(
        self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig
    ) -> None:
        """Takes the launcher.

        Raises:
            ConfigError: A setting is out of range, or the launcher is not ours.
        """
        _require_whole("trials", self.trials, 1)
        _require_whole("batch", self.batch, 1)
        _require_whole("seed", self.seed, 0)
        _require_whole("best", self.best, 1)
        _require_whole("seeds", self.seeds, 1)
        if not isinstance(self.params, Mapping):
            raise ConfigError(f"hydra.sweeper.params is {self.params!r}; expected key: interval.")
        self.config, self.loader = config, hydra_context.config_loader
        launcher = Plugins.instance().instantiate_launcher(
            hydra_context=hydra_context, task_function=task_function, config=config
        )
        if not isinstance(launcher, SweepLauncher):
            raise ConfigError("hydra.launcher is not ours; the sweeper needs launcher=local etc.")
        self.launcher: SweepLauncher = launcher

    def sweep(self, arguments: list[str]) -> None:
        """Runs the trials; raises SweepError at the end if one failed."""
        optuna = needed("optuna", "optuna")
        tuned, fixed = self._space(arguments)
        if self.best_of is not None:
            self._train_best(tuned, fixed)
            return
        folder = _made(self.launcher.folder)
        OmegaConf.save(self.config, folder / "multirun.yaml")
        study = open_study(folder, begin=True)
        told = study.user_attrs.get("objective", self.objective)
        if told != self.objective:
            raise ConfigError(
                f"hydra.sweeper.objective is '{self.objective}', but the study in {folder} tunes "
                f"{told}; leave it out, or start a new sweep."
            )
        states = optuna.trial.TrialState
        begun = [t for t in study.trials if t.state == states.RUNNING]
        failed: list[Outcome] = []
        elsewhere: list[Outcome] = []
        while begun or len(study.trials) < self.trials:
            before = len(study.trials) - len(begun)
            trials, begun = begun or self._asked(study, tuned), []
            if not trials:  # another process asked for the last
                break
            jobs = [
                self.launcher.job(t.number, [*fixed, *(f"{k}={v}" for k, v in t.params.items())])
                for t in trials
            ]
            total = max(self.trials, before + len(jobs))
            outcomes = self.launcher.run(jobs, before=before, total=total)
            for trial, outcome in zip(trials, outcomes, strict=True):
                if outcome.status == "busy":  # another process that tunes the study makes it
                    elsewhere.append(outcome)
                    continue
                if outcome.status == "stopped":
                    require_success([outcome], folder)
                value = self._value_of(outcome)
                if math.isfinite(value):
                    study.set_user_attr("objective", self.objective)
                    study.tell(trial.number, value, skip_if_finished=True)
                else:
                    failed.append(outcome)
                    study.tell(trial.number, state=states.FAIL, skip_if_finished=True)
        open_ones = [o for o in elsewhere if not o.job.finished]
        self._conclude(study, [*failed, *open_ones])

    def _asked(self, study: Any, tuned: Mapping[str, Any]) -> list[Any]:  # noqa: ANN401 - Optuna's
        """The next trials, by one process at a time of those that tune the study.

        Seeded by what is known, so that a study that goes on draws what it would have drawn, and no
        two processes draw the same.
        """
        optuna = needed("optuna", "optuna")
        with (self.launcher.folder / ASKING).open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            count = min(self.batch, self.trials - len(study.trials))
            study.sampler = optuna.samplers.TPESampler(seed=self.seed + len(study.trials))
            return [study.ask(tuned) for _ in range(count)]

    def _train_best(self, tuned: Mapping[str, Any], fixed: Sequence[str]) -> None:
        """Trains the best trials of another sweep, and what was not tuned, with several seeds.

        Seeds and held-out scenes are others than those by which they were chosen.

        Raises:
            ConfigError: The sweep tuned something else, or holds no finished trial.
        """
        from resc.studies.tuning_text import shown  # Hydra imports this file for every command

        folder = Path(str(self.best_of)).resolve()
        chosen = best_trials(folder, self.best)
        if tuned.keys() != chosen[0].params.keys():
            raise ConfigError(
                f"hydra.sweeper.best_of={self.best_of} tuned {', '.join(chosen[0].params)}, but "
                f"here {', '.join(tuned)} are tuned; use the command in its report."
            )
        assert self.config is not None
        given: dict[str, Any] = dict(map(split_override, fixed))
        seed, scenes = (
            int(given.get(key, self.config[key])) + 1 for key in ("seed", "evaluation_seed")
        )
        own = ("seed", "evaluation_seed", "name")
        rest = [text for text in fixed if split_override(text)[0] not in own]
        variants = {UNTUNED: list[str]()} | {
            f"trial_{trial.number}": [f"{k}={shown(v)}" for k, v in trial.params.items()]
            for trial in chosen
        }
        OmegaConf.save(self.config, _made(self.launcher.folder) / "multirun.yaml")
        self.launcher.launch(
            [
                [*rest, *params, f"name={name}", f"seed={s}", f"evaluation_seed={scenes}"]
                for s in range(seed, seed + self.seeds)
                for name, params in variants.items()
            ],
            initial_job_idx=0,
        )

    def _space(self, arguments: Sequence[str]) -> tuple[dict[str, Any], list[str]]:
        """What is tuned, by key, and the overrides that all trials share.

        Raises:
            ConfigError: Nothing is tuned, a range is none, or a key names no setting.
        """
        parser = OverridesParser.create(config_loader=self.loader)
        given = {text.partition("=")[0]: text for text in arguments}
        params = [f"{key}={value}" for key, value in self.params.items() if key not in given]
        parsed = parser.parse_overrides([*params, *arguments])
        tuned = {o.get_key_element(): distribution_of(o) for o in parsed if o.is_sweep_override()}
        fixed = [str(o.input_line) for o in parsed if not o.is_sweep_override()]
        if not tuned:
            raise ConfigError("hydra.sweeper.params names nothing to tune; give an interval(a, b).")
        assert self.config is not None
        first = [f"{key}={_some(distribution)}" for key, distribution in tuned.items()]
        self.loader.load_sweep_config(
            self.config, [*fixed, *first]
        )  # refuses what is not a setting
        return tuned, fixed

    def _value_of(self, outcome: Outcome) -> float:
        """The objective of a run that is over; NaN if it failed or the number is not finite.

        Raises:
            SweepError: Summaries have no such number.
        """
        if outcome.status == "failed":
            return math.nan
        summary = summary_of(outcome.job.folder)
        numbers = [key for key, value in summary.items() if type(value) in (int, float)]
        value = summary.get(self.objective, self.objective)
        if value is not None and self.objective not in numbers:
            folder = self.launcher.folder
            raise SweepError(
                f"hydra.sweeper.objective is '{self.objective}', which is not a number in "
                f"{SUMMARY} of run {outcome.job.name}.{nearest(self.objective, numbers)} Go on "
                f"with one of these: {go_on(folder)} "
                f"{override('hydra.sweeper.objective', 'success_rate')}"
            )
        return math.nan if value is None else float(value)

    def _conclude(self, study: Any, unfinished: Sequence[Outcome]) -> None:  # noqa: ANN401 - Optuna's
        from resc.studies.tuning import write_report
        from resc.studies.tuning_text import command_for_best

        folder = self.launcher.folder
        done = [t for t in study.trials if t.value is not None]
        if done:
            best = study.best_trial
            OmegaConf.save({"objective": best.value, "params": best.params}, folder / "best.yaml")
            chosen = " ".join(f"{name}={value}" for name, value in best.params.items())
            print(
                f"Best of {len(done)} is run {best.number}, {self.objective} {best.value}: {chosen}"
            )
            print(f"Report: {write_report(folder)}")
            print(f"Train the best again: {command_for_best(read_tuning(folder))}")
        if unfinished:
            require_success(unfinished, folder)


def _made(folder: Path) -> Path:
    """The folder, which is there now."""
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _require_whole(name: str, value: Any, least: int) -> None:  # noqa: ANN401 - as configured
    if type(value) is not int or value < least:
        raise ConfigError(
            f"hydra.sweeper.{name} is {value!r}; expected a whole number of at least {least}."
        )


def distribution_of(given: Override) -> Any:  # noqa: ANN401 - Optuna's
    """What a sweep override may be.

    Raises:
        ConfigError: It is not a range or list of choices that a number could be drawn from.
    """
    distributions = needed("optuna", "optuna").distributions
    value = given.value()
    if isinstance(value, IntervalSweep):
        low, high, log = value.start, value.end, "log" in value.tags
        if not (_is_finite(low) and _is_finite(high)) or low >= high or (log and low <= 0):
            above = " above zero" if log else ""
            raise ConfigError(
                f"{given.input_line} is not a range; expected two numbers{above}, the lower first."
            )
        if type(low) is int and type(high) is int:
            return distributions.IntDistribution(low, high, log=log)
        return distributions.FloatDistribution(low, high, log=log)
    if isinstance(value, ChoiceSweep) or given.is_choice_sweep():
        choices = list(given.sweep_string_iterator())
        if len(choices) != len(set(choices)) or not choices:
            what = "a choice twice" if choices else "no choice"
            raise ConfigError(f"{given.input_line} names {what}; list each choice once.")
        return distributions.CategoricalDistribution(choices)
    raise ConfigError(
        f"{given.input_line} cannot be tuned; expected interval(a, b) or choice(a, b, c)."
    )


def _is_finite(value: Any) -> TypeGuard[float]:  # noqa: ANN401 - what an interval holds
    return type(value) in (int, float) and math.isfinite(value)


def _some(distribution: Any) -> Any:  # noqa: ANN401 - Optuna's
    """One value of a distribution, as an override says it."""
    return distribution.choices[0] if hasattr(distribution, "choices") else distribution.low
