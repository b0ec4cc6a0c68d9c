"""Topics and fields: the tables cover the schema and are in the documentation; what is chosen."""

from pathlib import Path

import pytest
import torch

from resc import keys
from resc.errors import ConfigError
from resc.recording.description import MEANINGS, START_KEYS, TOPICS, WORLD_KEYS, describe
from resc.recording.schema import FIELDS, SCHEMA_NAMES, Column
from resc.recording.specification import chosen_columns

PAGE = Path(__file__).parents[2] / "docs" / "recording.md"
BEGIN, END = "<!-- resc-log schema -->", "<!-- end -->"


def test_every_field_of_every_topic_has_a_meaning():
    assert TOPICS.keys() == SCHEMA_NAMES.keys() == MEANINGS.keys()
    for topic, fields in FIELDS.items():
        assert MEANINGS[topic].keys() == fields.keys()


def test_the_arrays_of_scenes_and_starts_are_those_of_the_environment(make_env):
    env = make_env()
    env.restart(torch.arange(env.num_envs))
    scenes = {**env.pool.shared, **env.pool.tasks}.keys() - {keys.ESDF}
    assert set(WORLD_KEYS) == scenes
    world = env.world_of(torch.arange(1))
    assert set(START_KEYS) == {key for key in world if key in keys.DECLARED}


def test_the_documentation_holds_the_tables():
    page = PAGE.read_text()
    held = page.partition(BEGIN)[2].partition(END)[0].strip()
    assert held == describe(), "run resc-log schema and put its output there"


@pytest.mark.parametrize("fields", [[3], ["action", None], "state", [], {}, 3])
def test_fields_that_are_no_list_of_names_are_refused_with_an_example(fields):
    columns = [Column(keys.ACTION, ("x", "y", "z", "thrust"), torch.float32)]
    complaint = (
        r"recorder\.fields is .*; expected a non-empty list of names such as \[state, action"
    )
    with pytest.raises(ConfigError, match=complaint):
        chosen_columns(columns, fields)
    assert chosen_columns(columns, ["action"]) == tuple(columns)
