"""One table of groups: what conf/ holds, what the schemas take, and what an evaluation flies."""

from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from resc.envs.terms import Terms
from resc.groups import BOUND, DELTAS, EVALUATE, GROUPS, TASK, TRAIN, names
from resc.schema import BoundSchema, EvaluateSchema, TrainSchema

CONF = Path(__file__).parents[1] / "conf"


def test_every_folder_of_conf_is_in_the_table():
    there = {path.name for path in CONF.iterdir() if path.is_dir()}
    known = {folder for group in GROUPS for folder in group.folders}
    known |= set(names(lambda group: group.own_folder))
    assert there == known | set(DELTAS)


@pytest.mark.parametrize(
    ("schema", "run"),
    [(TrainSchema, TRAIN), (EvaluateSchema, EVALUATE), (BoundSchema, BOUND)],
)
def test_a_run_has_the_groups_of_its_kind_and_no_others(schema, run):
    mappings = {field.name for field in fields(schema) if field.type == dict[str, Any]}
    assert mappings - {"held_out"} == set(names(lambda group: run in group.runs))


def test_every_part_of_a_step_has_a_group():
    filled = {group.stage for group in GROUPS if group.stage}
    assert filled | set(TASK.values()) == set(Terms.__dataclass_fields__)


def test_the_policy_brings_what_it_was_trained_to_move_and_to_see():
    owned = names(lambda group: group.owner == "policy")
    assert owned == (
        "env", "vehicle", "action", "rate_loop", "dynamics", "observation", "reward",
    )  # fmt: skip
