"""What test_mutations.py runs in a process of its own: mutated configurations, built and flown.

python mutated_runs.py ONE_IN    prints what went wrong, a line each, of one case in so many

A process of its own, because the type checker of the tests would answer before the code does, and
because a case may eat up time or memory: both are limited here.
"""

import contextlib
import faulthandler
import math
import re
import resource
import signal
import sys
import tempfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import torch
from hydra import compose, initialize_config_dir
from mutated import CONF, LISTS, MISSING, PACKAGES, Case, cases, cases_of, load, mutated
from mutated_files import damaged, file_cases, make_sweep, readers
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException

import resc.schema
from resc.build import build
from resc.envs.terms_table import describe
from resc.errors import RescError
from resc.evaluation.courses import lay_out
from resc.evaluation.setting import Rules
from resc.evaluation.suites import amounts_of
from resc.learning.training_run import TrainingRun
from resc.planning.route import planner_for
from resc.policies.stored import load_policy
from resc.process import prepare_process
from resc.schema import EvaluateSchema, TrainSchema
from resc.settings import check_settings, listed

SMALL = (
    "compile=false",
    "num_envs=2",
    "pool_size=16",
    "env.resolution_m=0.25",
    "renew_scenes=1",
    "algorithm.steps=2",
    "algorithm.minibatch=4",
    "algorithm.epochs=1",
    "model.hidden=[8]",
    "logger=csv",
    "recorder=none",
    "obstacle_observation=none",
    "sensor=[euler,limit_violations,clearance,surface_clearance]",
)
CASE_S = 20.0
"""How much time of the processor a case may take."""
MEMORY = 4 << 30
"""How much a case may take beyond what the process has."""
ELSEWHERE = ("resume", "replay", "policy", "scenes", "suite", "compile")
"""Settings that only the whole scripts read, or that only cost time."""
CONSEQUENCE = "Every episode ends in its first step"
"""How a sentence begins that names what ends the episodes, whatever setting makes them end."""
LONGEST = 500
"""Characters of a sentence."""


class Hang(BaseException):
    """A case took too long; no Exception, so that nobody takes it for one."""


class Rest:
    """What a wrong setting is put into: the small default configurations."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.train = compose("train", [*SMALL])
        self.evaluate = compose("evaluate", ["recorder=none", "scenes=[paper1_map11]", "flights=2"])
        self.policy = load_policy(CONF.parent / "policies" / "free")

    def for_files(self) -> DictConfig:
        """A configuration of a run that is over soon, with a recording."""
        config = self.train.copy()
        config["recorder"] = load("recorder", "mcap")
        config["total_frames"], config["evaluation_episodes"] = 12, 2
        config["termination"]["time_limit"]["limit_s"] = 0.1
        return config

    def settings(self, script: str) -> dict[str, Any]:
        """The run-level settings of a script."""
        whole = OmegaConf.to_container(getattr(self, script))
        return {name: value for name, value in whole.items() if name not in ELSEWHERE}

    def run(self, case: Case) -> None:
        """Builds and flies what a case describes."""
        if case.script == "evaluate":
            self.run_evaluation(with_setting(self.evaluate, case))
        elif case.part.startswith("launcher/"):
            node = load(*case.part.split("/"))
            node = {k: "x" if "${" in str(v) else v for k, v in node.items()}
            build(mutated(node, case.path, case.value), "hydra.launcher.backend")
        else:
            self.run_training(
                with_part(self.train, case) if case.part else with_setting(self.train, case)
            )

    def run_training(self, config: DictConfig) -> None:
        """Two steps of every environment and an update; all numbers must be finite."""
        check_settings(config, TrainSchema)
        prepare_process(config["threads"], config["device"])
        trainer = TrainingRun(config).trainer()
        env = trainer.env
        describe(env.stages)
        with tempfile.TemporaryDirectory(dir=self.folder) as folder:
            build(config["logger"], "logger", folder=Path(folder)).close()
            recorder = TrainingRun(config).recorded.open(
                env.stages,
                directory=Path(folder) / "rollouts",
                outcomes=env.stages.outcomes,
                num_envs=config["num_envs"],
            )
            if recorder is not None:
                recorder.close()
        figures = trainer.iterate()
        unknown = [n for n, value in figures.items() if "loss" in n and not math.isfinite(value)]
        if unknown or not env.observation.isfinite().all():
            raise FloatingPointError(f"{unknown or 'observation'} not finite")

    def run_evaluation(self, config: DictConfig) -> None:
        """A step of every flight."""
        prepare_process(config["threads"], config["device"])
        check_settings(config, EvaluateSchema)
        stored = OmegaConf.to_container(self.policy.config, resolve=True)
        nodes = {"search": config["search"], "task": config["task"]}
        planner = planner_for(**nodes, env=config["env"] or stored["env"])
        scenes = {name: load("scene", name) for name in listed(config["scenes"])}
        suite = config["suite"] if config["scenes"] is None else None
        amounts = amounts_of(scenes, suite, maps=config["maps"], flights=config["flights"])
        courses = lay_out(scenes, amounts, seed=config["seed"], planner=planner)
        settings = Rules(config, stored, own_routes=courses[0].own_routes)
        env = settings.env(courses)
        env.restart(torch.arange(env.num_envs))
        out = env.advance(torch.zeros(env.num_envs, env.action_spec.shape[-1]))
        if not all(part.isfinite().all() for part in (out.observation, out.reward)):
            raise FloatingPointError("observation or reward is not finite")


def with_setting(config: DictConfig, case: Case) -> DictConfig:
    """A configuration with one run-level setting changed."""
    config = config.copy()
    (name,) = case.path
    if case.value is not MISSING:
        OmegaConf.update(config, name, case.value)
    return config


def with_part(config: DictConfig, case: Case) -> DictConfig:
    """A configuration with one part in a changed form."""
    group, name = case.part.split("/")
    node = mutated(load(group, name), case.path, case.value)
    config = config.copy()
    where = PACKAGES.get(group, group)
    with open_dict(config):
        if where in LISTS and isinstance(node, dict) and node:
            for term, content in node.items():
                config[where][term] = content
            return config
        # What conf/train.yaml adds.
        if group == "scene" and isinstance(node, dict):
            node["difficulty"] = "obstacles"
        if group == "task" and isinstance(node, dict):
            start = node.get("initial_state")
            if isinstance(start, dict) and start:
                start["difficulty"] = "initial_state"
        config[where] = node
    return config


def complaint(run: Callable[[], object], names: Sequence[str] = (), *, meant: bool = True) -> str:
    """What is wrong with how a case ends; nothing if nothing is.

    Args:
        run: The case.
        names: Of which a sentence must contain one.
        meant: Whether it may run to its end.
    """
    try:
        with limited():
            run()
    except RescError as error:
        return flaw(str(error), names)
    except OmegaConfBaseException as error:
        return "" if "mutated_runs" in raised_in(error) else f"traceback: {error!r}"[:300]
    except Hang:
        return "hangs"
    except BaseException as error:
        return f"traceback in {raised_in(error)}: {error!r}"[:300].replace("\n", " ")
    return "" if meant else "accepted"


def raised_in(error: BaseException) -> str:
    """The last of our own files that an error passed through."""
    files, trace = [], error.__traceback__
    while trace:
        name = trace.tb_frame.f_code.co_filename
        if name.startswith(str(CONF.parent)) and "/.venv/" not in name:
            files.append(f"{Path(name).relative_to(CONF.parent)}:{trace.tb_lineno}")
        trace = trace.tb_next
    return files[-1]


def flaw(text: str, names: Sequence[str]) -> str:
    """What is wrong with a sentence."""
    if "\n" in text or "Traceback" in text or len(text) > LONGEST:
        return f"not one sentence: {text[:200]!r}"
    if (
        names
        and not text.startswith(CONSEQUENCE)
        and not any(re.search(rf"\b{re.escape(name)}\b", text) for name in names)
    ):
        return f"names no setting: {text}"
    return ""


@contextlib.contextmanager
def limited() -> Iterator[None]:
    """Ends what takes too long."""

    def stop(*_: Any) -> None:
        raise Hang

    signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, CASE_S)
    faulthandler.dump_traceback_later(10 * CASE_S, exit=True)  # where no signal arrives
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        faulthandler.cancel_dump_traceback_later()


def main(one_in: int) -> None:
    """Runs the cases; prints what went wrong, and their number."""
    torch.set_num_threads(1)
    resc.schema.register()
    with (
        tempfile.TemporaryDirectory() as folder,
        initialize_config_dir(str(CONF), version_base="1.3"),
    ):
        rest = Rest(Path(folder))
        rest.run_training(rest.train)
        rest.run_evaluation(rest.evaluate)
        size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY, resource.RLIM_INFINITY))
        every = list(cases())
        every += [c for s in ("train", "evaluate") for c in cases_of(s, rest.settings(s))]
        chosen = [case for case in every if case.number % one_in == 0]
        for case in chosen:
            group = case.part.split("/")[0]
            names = [n for n in (*case.path[-1:], group, PACKAGES.get(group)) if n]
            if wrong := complaint(partial(rest.run, case), names, meant=case.meant):
                print(f"{case}: {wrong}", flush=True)
        count = len(chosen)
        sweep = Path(folder) / "sweep"
        make_sweep(rest.for_files(), sweep)
        known = readers(rest.for_files())
        every = list(file_cases())
        chosen = [case for case in every if zlib.crc32(repr(case).encode()) % one_in == 0]
        for name, damage, reader in chosen:
            with damaged(sweep, name, damage):
                if wrong := complaint(partial(known[reader], sweep)):
                    print(f"{name} {damage}, {reader}: {wrong}", flush=True)
        print(f"{count + len(chosen)} cases", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]))
