"""The environment of an evaluation: the policy's vehicle and senses, the evaluation's rules."""

from collections.abc import Mapping, Sequence
from typing import Any

from resc.envs.quadrotor import QuadrotorEnv
from resc.evaluation.courses import Course
from resc.groups import EVALUATE, names
from resc.scenes.laid_out import LaidOut
from resc.scenes.layout import concatenate
from resc.setup import set_up

POLICYS = names(lambda group: group.owner == "policy")
"""Groups taken from the policy's configuration, unless the command line names one."""
SCENES = names(lambda group: group.owner == "scene")
"""Groups taken from it where a scene brings its own routes, too."""
OWN = names(lambda g: g.owner == "evaluation" and g.stage and EVALUATE in g.runs)
"""Terms that are the evaluation's, whatever flies; the policy's sensors join its own."""
MEASURING = ("limit_violations", "surface_clearance")
"""Sensors that metrics and terminations read: the evaluation's, not those of the training."""
RUN = ("allowed_targets", "device", "compile", "seed", "recorder")


def settings_for(
    config: Mapping[str, Any], stored: Mapping[str, Any], *, own_routes: bool
) -> dict[str, Any]:
    """The configuration that an environment is built from.

    What the policy sees and moves comes from `stored`; what is asked of it and measured from
    `config`. Scenes with routes of their own are flown under the stored task and terminations.
    """
    settings = {key: config[key] for key in RUN}
    settings |= {group: config.get(group) or stored.get(group, {}) for group in POLICYS}
    settings["env"] = {**stored["env"], **(config.get("env") or {})}  # numbers, each for itself
    rules = stored if own_routes else config
    settings |= {group: rules[group] for group in SCENES}
    settings |= {group: config[group] for group in OWN}
    measuring = {name: config["sensor"][name] for name in MEASURING if name in config["sensor"]}
    settings["sensor"] = {**config["sensor"], **(stored["sensor"] or {}), **measuring}
    return settings


def build_flying_env(courses: Sequence[Course], settings: Mapping[str, Any]) -> QuadrotorEnv:
    """An environment with one row for every flight of the courses, in their order."""
    seed = settings["seed"]
    layout = concatenate([course.layout for course in courses])
    setup = set_up(settings, size=len(layout), seed=seed, scene=LaidOut(layout))
    return setup.env(len(layout), compiled=settings["compile"], seed=seed, in_order=True)
