"""The environment of an evaluation: the policy's vehicle and senses, the evaluation's rules."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from omegaconf import OmegaConf

from resc.build import ALLOWED, locate, plain
from resc.envs.quadrotor import QuadrotorEnv
from resc.envs.stages import Stages
from resc.evaluation.courses import Course
from resc.groups import EVALUATE, names
from resc.places import CONF
from resc.recording.rollouts import RecordedRun
from resc.scenes.layout import concatenate
from resc.setup import among, build_stages

POLICYS = names(lambda group: group.owner == "policy")
"""Groups taken from the policy's configuration, unless the command line names one."""
SCENES = names(lambda group: group.owner == "scene")
"""Groups taken from it where a scene brings its own routes, too."""
OWN = names(lambda g: g.owner == "evaluation" and g.stage and EVALUATE in g.runs)
"""Terms that are the evaluation's, whatever flies; the policy's sensors join its own."""
RUN = ("allowed_targets", "device", "compile", "seed", "recorder")
Settings = Mapping[str, Any]


@dataclass(frozen=True)
class Rules:
    """What flights are flown under.

    What the policy sees and moves comes from its training; what is asked of it and measured, from
    the evaluation. Scenes with routes of their own are flown under the task and the terminations of
    the training.

    Args:
        asked: The evaluation's configuration.
        trained: The policy's.
        own_routes: Whether the scenes bring their own routes.
        overrides: Of the command, which the recordings name.
        replaced: Nodes by their groups that take the place of all others: what a pilot needs.
    """

    asked: Settings
    trained: Settings
    own_routes: bool
    overrides: Sequence[str] = ()
    replaced: Settings = field(default_factory=dict)

    @cached_property
    def settings(self) -> dict[str, Any]:
        """The configuration that the environment is built from."""
        asked, trained = self.asked, self.trained
        settings = {key: asked[key] for key in RUN}
        settings |= {group: asked.get(group) or trained.get(group, {}) for group in POLICYS}
        if asked.get("rate_loop"):
            settings["vehicle"] = with_controllers(settings["vehicle"])
        settings["env"] = {**trained["env"], **(asked.get("env") or {})}  # numbers, each for itself
        rules = trained if self.own_routes else asked
        settings |= {group: rules[group] for group in SCENES}
        settings |= {group: asked[group] for group in OWN}
        allowed = (*ALLOWED, *asked["allowed_targets"])
        judging = {n: node for n, node in asked["sensor"].items() if _judges(n, node, allowed)}
        settings["sensor"] = {**asked["sensor"], **(trained["sensor"] or {}), **judging}
        return settings | dict(self.replaced)

    @cached_property
    def stages(self) -> Stages:
        """The step and the reset.

        Raises:
            ConfigError: A name, a number or a combination is wrong.
        """
        return build_stages(self.settings)

    @property
    def arrival_m(self) -> float:
        """How near to a control point a flight reaches it [m]."""
        return float(self.settings["task"]["control_points"].get("radius_m", 0.5))

    @property
    def recorded(self) -> RecordedRun:
        """How flights are recorded."""
        settings = self.settings
        return RecordedRun(
            settings["recorder"],
            OmegaConf.to_yaml(OmegaConf.create(settings), resolve=True),
            seed=settings["seed"],
            device=str(settings["device"]),
            overrides=self.overrides,
            allowed=settings["allowed_targets"],
        )

    def env(self, courses: Sequence[Course]) -> QuadrotorEnv:
        """An environment with one row for every flight of the courses, in their order."""
        run = self.settings
        layout = concatenate([course.layout for course in courses])
        setup = among(layout, self.stages, run["device"])
        return setup.env(len(layout), compiled=run["compile"], seed=run["seed"], in_order=True)


def with_controllers(vehicle: Settings) -> Settings:
    """A vehicle with what flight controllers are told of it.

    One that was stored before it said so has what the file with its numbers says today, if any.
    """
    if "controllers" in vehicle:
        return vehicle
    for path in sorted((CONF / "vehicle").glob("*.yaml")):
        file = plain(OmegaConf.load(path))
        controllers = file.pop("controllers", None)
        if controllers and file == dict(plain(vehicle)):
            return {**vehicle, "controllers": controllers}
    return vehicle


def _judges(name: object, node: object, allowed: Sequence[str]) -> bool:
    """Whether a sensor is the evaluation's, not the training's."""
    if not isinstance(node, Mapping) or "_target_" not in node:
        return False  # `build` refuses it with its reason
    return bool(getattr(locate(str(node["_target_"]), f"sensor.{name}", allowed), "judges", False))
