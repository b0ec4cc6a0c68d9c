"""Hydra's door to `resc.sweeps`: the launcher of `train.py -m`, and a sweeper that tunes.

Hydra takes launchers and sweepers from the package `hydra_plugins` only.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import ChoiceSweep, IntervalSweep, Override
from hydra.core.plugins import Plugins
from hydra.core.utils import JobReturn, JobStatus
from hydra.plugins.launcher import Launcher
from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, OmegaConf

from resc.errors import ConfigError
from resc.jobs import Job, Outcome
from resc.run_folder import summary_of
from resc.sweeps import Backend, needed, report, require_success, run_sweep

OF_THE_SWEEP = ("launcher", "hydra")
"""Overrides of these say how a sweep is run; what a run is does not depend on them."""


class SweepLauncher(Launcher):
    """Runs every job as `train.py <its overrides>` in a process of its own (`resc.sweeps`).

    Args:
        backend: Where and how many at a time.
    """

    def __init__(self, backend: Backend) -> None:
        self.backend = backend

    def setup(
        self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig
    ) -> None:
        """Takes the sweep's folder."""
        del hydra_context, task_function
        self.folder = Path(str(config.hydra.sweep.dir))

    def run(self, jobs: Mapping[int, Sequence[str]]) -> list[Outcome]:
        """What came of the jobs, given by number."""
        wanted = [
            Job(self.folder / str(number), tuple(filter(_of_the_run, overrides)))
            for number, overrides in jobs.items()
        ]
        return run_sweep(wanted, self.backend)

    def launch(
        self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int
    ) -> Sequence[JobReturn]:
        """Runs the jobs; raises SweepError at the end unless all are finished."""
        print(f"{len(job_overrides)} runs go to {self.folder}", flush=True)
        outcomes = self.run(dict(enumerate(job_overrides, initial_job_idx)))
        report(self.folder)
        require_success(outcomes, self.folder)
        return [JobReturn(status=JobStatus.COMPLETED) for _ in outcomes]


class OptunaSweeper(Sweeper):
    """Chooses the next runs by what came of those before, with Optuna's TPE sampler.

    Maximises one number of the runs' summaries. The study is kept in the sweep's folder, so that an
    interrupted one goes on. (hydra-optuna-sweeper 1.3.0 wants optuna below 3.)

    Args:
        objective: The number in summary.json.
        trials: Runs in all.
        batch: Runs begun together, before any of them tells anything.
        seed: Of the sampler.
        params: What is tuned, as overrides: `interval(a, b)`, `tag(log, interval(a, b))` or
            choices.
    """

    def __init__(
        self, objective: str, trials: int, batch: int, seed: int, params: Mapping[str, str]
    ) -> None:
        self.objective, self.trials, self.batch, self.seed = objective, trials, batch, seed
        self.params = params

    def setup(
        self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig
    ) -> None:
        """Takes the launcher."""
        self.config, self.loader = config, hydra_context.config_loader
        launcher = Plugins.instance().instantiate_launcher(
            hydra_context=hydra_context, task_function=task_function, config=config
        )
        if not isinstance(launcher, SweepLauncher):
            raise ConfigError("hydra.launcher is not ours; the sweeper needs launcher=serial etc.")
        self.launcher: SweepLauncher = launcher

    def sweep(self, arguments: list[str]) -> None:
        """Runs the trials; raises SweepError at the end if one failed."""
        optuna = needed("optuna", "optuna")
        folder = self.launcher.folder
        folder.mkdir(parents=True, exist_ok=True)
        OmegaConf.save(self.config, folder / "multirun.yaml")
        parser = OverridesParser.create(config_loader=self.loader)
        parsed = parser.parse_overrides([f"{k}={v}" for k, v in self.params.items()] + arguments)
        tuned = {o.get_key_element(): _distribution(o) for o in parsed if o.is_sweep_override()}
        fixed = [o.input_line for o in parsed if not o.is_sweep_override()]
        if not tuned:
            raise ConfigError("hydra.sweeper.params names nothing to tune; give an interval(a, b).")
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        study = optuna.create_study(
            storage=f"sqlite:///{folder}/optuna.db",
            study_name="study",
            direction="maximize",
            load_if_exists=True,
        )
        begun = [t for t in study.trials if t.state == optuna.trial.TrialState.RUNNING]
        failed: list[Outcome] = []
        while begun or len(study.trials) < self.trials:
            # Seeded by what is known, so that a study that goes on draws what it would have drawn.
            study.sampler = optuna.samplers.TPESampler(seed=self.seed + len(study.trials))
            count = min(self.batch, self.trials - len(study.trials))
            trials = begun or [study.ask(tuned) for _ in range(count)]
            begun = []
            jobs = {t.number: [*fixed, *(f"{k}={v}" for k, v in t.params.items())] for t in trials}
            for trial, outcome in zip(trials, self.launcher.run(jobs), strict=True):
                if outcome.status in ("stopped", "busy"):
                    require_success([outcome], folder)
                value = summary_of(outcome.job.folder).get(self.objective, math.nan)
                if outcome.status == "failed" or not math.isfinite(value):
                    failed.append(outcome)
                    study.tell(trial.number, state=optuna.trial.TrialState.FAIL)
                else:
                    study.tell(trial.number, value)
        self._conclude(study, failed)

    def _conclude(self, study: Any, failed: Sequence[Outcome]) -> None:  # noqa: ANN401 - Optuna's
        folder = self.launcher.folder
        done = [t for t in study.trials if t.value is not None]
        if done:
            best = study.best_trial
            OmegaConf.save({"objective": best.value, "params": best.params}, folder / "best.yaml")
            chosen = " ".join(f"{name}={value}" for name, value in best.params.items())
            print(
                f"Best of {len(done)} is run {best.number}, {self.objective} {best.value}: {chosen}"
            )
        if failed:
            require_success(failed, folder)


def _distribution(override: Override) -> Any:  # noqa: ANN401 - Optuna's
    """What a sweep override may be."""
    distributions = needed("optuna", "optuna").distributions
    value = override.value()
    if isinstance(value, IntervalSweep):
        low, high = value.start, value.end
        if type(low) is int and type(high) is int:
            return distributions.IntDistribution(low, high, log="log" in value.tags)
        return distributions.FloatDistribution(low, high, log="log" in value.tags)
    if isinstance(value, ChoiceSweep) or override.is_choice_sweep():
        return distributions.CategoricalDistribution(list(override.sweep_string_iterator()))
    raise ConfigError(
        f"{override.input_line} cannot be tuned; expected interval(a, b) or choice(a, b, c)."
    )


def _of_the_run(override: str) -> bool:
    """Whether an override says what the run is, rather than how the sweep is run."""
    key = override.lstrip("+~").partition("=")[0].partition(".")[0].partition("/")[0]
    return key not in OF_THE_SWEEP
