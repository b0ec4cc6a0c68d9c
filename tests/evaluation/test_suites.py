"""Suites: what is flown, how often, and what is refused before anything is flown."""

from pathlib import Path

import pytest
import yaml

from resc.errors import ConfigError
from resc.evaluation.suites import Amount, amounts_of, scenes_to_fly

CONF = Path(__file__).parents[2] / "conf"
PAPER = ["paper1_map11", "paper2_map12", "paper3_map13", "paper4_map15"]
FORESTS = ["forest_low", "forest_medium", "forest_dense"]


def amounts(config):
    named, suite = config["scenes"], config["suite"]
    often = {name: config[name] for name in ("maps", "flights")}
    return amounts_of(scenes_to_fly(named, suite), suite if named is None else None, **often)


@pytest.mark.parametrize("path", sorted((CONF / "suite").glob("*.yaml")), ids=lambda p: p.stem)
def test_every_suite_names_scenes_that_are_there(path, evaluation):
    config = evaluation(f"suite={path.stem}")
    found = amounts(config)
    assert list(found) == list(yaml.safe_load(path.read_text()))
    assert all((CONF / "scene" / f"{name}.yaml").exists() for name in found)


def test_papers_maps_are_flown_unless_something_else_is_named(evaluation):
    assert amounts(evaluation()) == dict.fromkeys(PAPER, Amount(20))
    assert amounts(evaluation("scenes=[gaps]")) == {"gaps": Amount(20)}
    assert amounts(evaluation("scenes=gaps", "maps=3", "flights=2")) == {"gaps": Amount(2, 3)}


def test_several_suites_are_one(evaluation):
    found = amounts(evaluation("suite=[paper,forest]", "flights=3", "maps=7"))
    assert list(found) == [*PAPER, *FORESTS]
    assert (found[PAPER[0]], found["forest_low"]) == (Amount(3), Amount(3, 7))


def test_single_numbers_of_a_suite_can_be_given(evaluation):
    found = amounts(evaluation("suite=forest", "suite.forest_low.maps=9", "~suite.forest_dense"))
    assert found == {"forest_low": Amount(5, 9), "forest_medium": Amount(5, 100)}


def test_flight_of_its_own_for_every_map_where_no_maps_are_given():
    assert (Amount(8).drawn, Amount(8).flights_a_map) == (8, 1)
    assert (Amount(8, 3).drawn, Amount(8, 3).flights_a_map) == (3, 8)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["suite=[]"], "scenes is null and suite is empty; name a suite"),
        (["suite=paper", "maps=3"], "maps is 3, but paper1_map11, .* have fixed maps"),
        (["suite=forest", "suite.forest_low.maps=0"], "suite.forest_low.maps is 0; expected a"),
        (["suite=forest", "suite.forest_low.flights=x"], "flights is 'x'; expected a whole"),
        (["suite=forest", "+suite.forest_low.map=3"], "has no 'map'. Did you mean 'maps'"),
        (["suite=forest", "suite.forest_low=5"], "suite.forest_low is 5; expected numbers such as"),
    ],
)
def test_impossible_suites_are_refused(evaluation, overrides, message):
    with pytest.raises(ConfigError, match=message):
        amounts(evaluation(*overrides))


def test_scenes_beside_a_suite_are_refused(evaluation):
    with pytest.raises(ConfigError, match="Both suite and scenes say what to fly"):
        scenes_to_fly(["gaps"], {}, ["scenes=[gaps]", "suite.gaps.maps=3"])
