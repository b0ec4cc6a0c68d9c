"""An evaluation from beginning to end: lay out, fly, report."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from resc.errors import ConfigError
from resc.evaluation.courses import Course, lay_out
from resc.evaluation.flights import Flights, fly
from resc.evaluation.picture import Flown, draw_overview, draw_scene
from resc.evaluation.run_folder import finish_run
from resc.evaluation.setting import build_flying_env, settings_for
from resc.evaluation.statistics import join, report_scenes, tabulate
from resc.evaluation.table import failures, markdown, summary, write_flights, write_scenes
from resc.learning.checkpoint import Policy
from resc.planning.route import planner_for
from resc.recording.rollouts import open_recorder, provenance


def evaluate(
    config: DictConfig, policy: Policy, scenes: Mapping[str, Mapping[str, Any]], folder: Path
) -> str:
    """Flies every scene, leaves tables, pictures, recording and summary in the folder; returns the report.

    Raises:
        PlanningError: A flight has no path.
        CheckpointError: The policy expects another observation.
    """
    began = time.perf_counter()
    folder.mkdir(parents=True, exist_ok=True)
    stored = policy.config
    planner = planner_for({**config, "env": config["env"] or stored["env"]})
    if planner is None:
        raise ConfigError("search is empty; choose one, e.g. search=visibility.")
    courses = lay_out(
        scenes,
        config["flights"],
        seed=config["seed"],
        planner=planner,
        allowed=config["allowed_targets"],
    )
    OmegaConf.save(config, folder / "config.yaml", resolve=True)
    flown = fly_courses(courses, policy, config, folder)
    frames = sum(flights.frames for flights in flown.values())
    flying_s = sum(flights.wall_s for flights in flown.values())
    ...
