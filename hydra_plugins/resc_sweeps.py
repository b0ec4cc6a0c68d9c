"""Hydra's door to `resc.sweeps.sweep`: the launcher of `train.py -m`.

Hydra takes launchers and sweepers from the package `hydra_plugins` only.
"""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra.core.utils import JobReturn, JobStatus
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, OmegaConf

from resc.build import build
from resc.command_line import differing
from resc.errors import ConfigError
from resc.starting.origin import key_of, python_path, require_own_folder, says_how
from resc.sweep_folder import difference, plain
from resc.sweeps.jobs import Job, Outcome
from resc.sweeps.launchers import Backend
from resc.sweeps.sweep import report, require_success, run_sweep

SUBDIR = "${hydra.job.num}"


class SweepLauncher(Launcher):
    """Runs every job as a process of its own (`resc.sweeps.sweep`).

    Args:
        backend: Configuration of where and how many at a time.
    """

    def __init__(self, backend: Mapping[str, Any] | None) -> None:
        self.wanted = backend

    def setup(
        self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig
    ) -> None:
        """Takes the sweep's configuration and folder.

        Raises:
            ConfigError: A setting of Hydra's that runs of their own could not follow; a backend
                that is none; the folder of something else.
        """
        del task_function
        self.config, self.loader = config, hydra_context.config_loader
        refuse_what_runs_cannot_follow(config)
        self.backend: Backend = build(
            self.wanted or {}, "hydra.launcher.backend", allowed=config["allowed_targets"]
        )
        if not isinstance(self.backend, Backend):
            raise ConfigError("hydra.launcher.backend has no run(); choose launcher=local.")
        self.folder = Path(str(config.hydra.sweep.dir)).resolve()
        self.options = (*_configuration_flags(config), *_handed_on(config), "hydra.mode=RUN")
        require_own_folder(self.folder)

    def job(self, number: int, overrides: Sequence[str]) -> Job:
        """The job of these overrides, with all that its process inherits."""
        own = tuple(text for text in overrides if not says_how(text))
        composed = self.loader.load_sweep_config(self.config, list(overrides))
        config = plain(composed)
        environment = {str(name): str(value) for name, value in composed.hydra.job.env_set.items()}
        if path := python_path():
            environment["PYTHONPATH"] = path
        return Job(
            folder=self.folder / str(number),
            overrides=own,
            script=Path(sys.argv[0]).resolve(),
            options=self.options,
            config={name: config[name] for name in config if name != "hydra"},
            environment=environment,
        )

    def run(
        self, jobs: Sequence[Job], *, before: int = 0, total: int | None = None
    ) -> list[Outcome]:
        """What came of the jobs."""
        return run_sweep(jobs, self.backend, before=before, total=total)

    def launch(
        self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int
    ) -> Sequence[JobReturn]:
        """Runs the jobs; raises SweepError at the end unless all are finished."""
        jobs = [self.job(n, own) for n, own in enumerate(job_overrides, initial_job_idx)]
        if not jobs:
            raise ConfigError(
                "The overrides name no run at all; give a range that holds something."
            )
        require_different(jobs)
        print(f"{len(jobs)} runs go to {self.folder}, each with its log.txt", flush=True)
        outcomes = self.run(jobs)
        report(self.folder)
        require_success(outcomes, self.folder)
        return [JobReturn(status=JobStatus.COMPLETED) for _ in outcomes]


def require_different(jobs: Sequence[Job]) -> None:
    """Refuses jobs that are one and the same run, however they are written.

    Raises:
        ConfigError: It names two of them.
    """
    texts = differing([job.overrides for job in jobs])
    for index, job in enumerate(jobs):
        for other in range(index):
            if difference(jobs[other].config, job.config) is None:
                both = f" ('{' '.join(texts[other])}' and '{' '.join(texts[index])}')"
                raise ConfigError(
                    f"Jobs {other} and {index} are the same run{both if texts[index] else ''}, "
                    "which a report would count twice; leave one out."
                )


def refuse_what_runs_cannot_follow(config: DictConfig) -> None:
    """Refuses settings of Hydra's that a sweep whose runs are processes has no use for.

    Raises:
        ConfigError: It names the setting, and the one to use.
    """
    raw = OmegaConf.to_container(config.hydra.sweep)
    if not isinstance(raw, dict) or raw["subdir"] != SUBDIR:
        raise ConfigError("hydra.sweep.subdir is set, but runs are named by number; leave it out.")
    if config.hydra.sweeper.get("max_batch_size") is not None:
        raise ConfigError(
            "hydra.sweeper.max_batch_size is set, but the launcher says how many runs go at a "
            "time; use hydra.launcher.backend.jobs=..."
        )
    if "hydra.mode=RUN" in config.hydra.overrides.hydra:
        raise ConfigError("hydra.mode=RUN is of a single run; leave out it or -m.")
    if given := [text for text in config.hydra.overrides.hydra if key_of(text) == "hydra.run.dir"]:
        raise ConfigError(f"{given[0]} is of a single run; with -m, set hydra.sweep.dir.")


def _configuration_flags(config: DictConfig) -> list[str]:
    """Flags with which a run reads the same files: directories in full, primary configuration."""
    flags = [f"--config-name={config.hydra.job.config_name}"]
    for source in config.hydra.runtime.config_sources:
        path = f"pkg://{source.path}" if source.schema == "pkg" else source.path
        if source.provider == "main":
            flags.append(f"--config-path={path}")
        elif source.provider == "command-line":
            flags.append(f"--config-dir={path}")
    return flags


def _handed_on(config: DictConfig) -> list[str]:
    """Overrides of Hydra's own settings, but for those of the sweep."""
    sweeper = ("hydra.sweeper", "hydra/sweeper")
    given = [text for text in config.hydra.overrides.hydra if not says_how(text)]
    return [text for text in given if not key_of(text).startswith(sweeper)]
