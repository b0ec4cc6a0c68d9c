"""The groups of a configuration, one line each: the only list of them.

A group is a setting filled from the files of its folder in conf/. A new one is a line of `GROUPS`
and its folder.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from resc.term import (
    Action,
    Curriculum,
    Estimator,
    Metric,
    Observation,
    Randomization,
    Replanning,
    Reward,
    Sensing,
    Sensor,
    Term,
    Termination,
)

TRAIN, EVALUATE, BOUND = "train", "evaluate", "bound"
EVERY = (TRAIN, EVALUATE, BOUND)
"""Kinds of runs: `train.py`, `evaluate.py` and `python -m resc.evaluation.bound`."""
Owner = Literal["evaluation", "policy", "scene"]


@dataclass(frozen=True)
class Group:
    """What the program knows of a group.

    Args:
        name: Of the setting and of its folder in conf/.
        kind: What its terms are; None where they are no terms.
        several: Whether a run takes several files of it.
        runs: Kinds of runs that have it.
        owner: Whose settings an evaluation flies with: its own, those of the policy unless the
            command line names others, or the policy's where a scene brings its own routes.
        stage: Field of `resc.envs.stages.Terms` that its terms fill.
        needed: Whether nothing flies without it.
        compared: Whether it says what an episode is: flights are compared where it is the same.
        folders: Further folders of conf/ whose files go into it.
        own_folder: Whether it has a folder of its own name, too.
    """

    name: str
    kind: type[Term] | None = None
    several: bool = False
    runs: tuple[str, ...] = EVERY
    owner: Owner = "evaluation"
    stage: str = ""
    needed: bool = False
    compared: bool = False
    folders: tuple[str, ...] = ()
    own_folder: bool = True


GROUPS = (
    Group("env", owner="policy", needed=True, compared=True),
    Group("vehicle", owner="policy", needed=True, compared=True),
    Group("action", Action, stage="action", owner="policy", needed=True),
    Group("rate_loop", Term, stage="rate_loop", owner="policy", needed=True, compared=True),
    Group("dynamics", Term, stage="dynamics", owner="policy", needed=True, compared=True),
    Group("task", owner="scene", needed=True, compared=True),
    Group("scene", compared=True),
    Group("sensor", Sensor, stage="sensors", several=True),
    Group("estimator", Estimator, stage="estimator", compared=True),
    Group("sensing", Sensing, stage="sensing", compared=True),
    Group("replanning", Replanning, stage="replanning", compared=True),
    Group(
        "observation",
        Observation,
        stage="observations",
        several=True,
        owner="policy",
        needed=True,
        folders=("obstacle_observation",),
    ),
    Group(
        "observation_critic",
        Observation,
        stage="critic_observations",
        several=True,
        runs=(TRAIN,),
        folders=("observation", "obstacle_observation"),
        own_folder=False,
    ),
    Group(
        "termination",
        Termination,
        stage="terminations",
        several=True,
        owner="scene",
        compared=True,
    ),
    Group("reward", Reward, stage="rewards", several=True, owner="policy"),
    Group("randomization", Randomization, stage="randomizations", several=True, compared=True),
    Group("metric", Metric, stage="metrics", several=True),
    Group("recorder"),
    Group("search"),
    Group("curriculum", Curriculum, runs=(TRAIN,)),
    Group("model", runs=(TRAIN,)),
    Group("algorithm", runs=(TRAIN,)),
    Group("logger", runs=(TRAIN,)),
    Group("suite", several=True, runs=(EVALUATE, BOUND)),
    Group("pilot", several=True, runs=(EVALUATE,)),
    Group("limits", runs=(EVALUATE, BOUND)),
)
"""All of them."""
TASK = {"control_points": "task", "initial_state": "initial_state"}
"""The two terms of a task, and the fields of `Terms` that they fill."""
OWN_ENV = ("layout", "history", "observation_frame")
"""Entries of `env` that say what the policy sees, not what it flies."""
DELTAS = ("experiment", "study", "ingredient", "simulator", "condition", "launcher", "hydra")
"""Folders of conf/ that are not groups: they change others, or say how runs are started."""


def names(which: Callable[[Group], object]) -> tuple[str, ...]:
    """Names of those groups for which something holds, in the order of the table."""
    return tuple(group.name for group in GROUPS if which(group))


NEEDED = names(lambda group: group.needed)
"""Groups without which nothing flies."""
