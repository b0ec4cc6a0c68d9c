"""Scenes and suites as a command composes them, from folders of a user's own, too."""

import re
import sys

import pytest
from shared import QUIET, start_here

import resc
import train
from resc.errors import ConfigError
from resc.starting.answers import answering
from resc.starting.composed import compose_scenes, refuse_doubles

OWN = """\
_target_: resc.scenes.random_boxes.RandomBoxes
side_m: [0.3, 0.8]
keep_clear_m: {keep_clear_m}
"""


@pytest.fixture
def folder(tmp_path):
    """A folder of configuration of a user's own."""
    for group in ("scene", "suite"):
        (tmp_path / "mine" / group).mkdir(parents=True)
    return tmp_path / "mine"


@pytest.fixture
def composed(folder, monkeypatch, tmp_path):
    """`composed(names, *overrides)`: the scenes of these names, as evaluate.py composes them.

    Without names, they are those of the suite.
    """
    monkeypatch.chdir(tmp_path)

    def compose(names, *overrides):
        found = []
        search = f"hydra.searchpath=[file://{folder}]"
        monkeypatch.setattr(sys, "argv", ["evaluate.py", search, *overrides, *QUIET])

        def run(config):
            with answering():
                refuse_doubles()
                found.append(compose_scenes(names or list(config["suite"]), config["scene"]))

        start_here(run, "evaluate")
        return found[0]

    return compose


def test_scenes_are_composed_as_each_alone(composed):
    both = composed(["planned_walls", "paper1_map11"])
    assert list(both) == ["planned_walls", "paper1_map11"]
    assert {**composed(["paper1_map11"]), **composed(["planned_walls"])} == both


def test_a_scene_may_say_a_number_by_another_of_its_own(composed, folder):
    text = OWN.format(keep_clear_m="${scene.side_m[1]}")
    (folder / "scene" / "related.yaml").write_text(text)
    found = composed(["free", "related"], "+scene.jitter_m=0.2")
    assert (found["related"]["keep_clear_m"], found["related"]["jitter_m"]) == (0.8, 0.2)


def test_a_scene_does_not_read_another_by_its_name(composed, folder):
    """Together, `scene.side_m` would be the other scene."""
    text = OWN.format(keep_clear_m="${scene.side_m}")
    (folder / "scene" / "related.yaml").write_text(text)
    (folder / "scene" / "side_m.yaml").write_text(OWN.format(keep_clear_m=0.5))
    assert composed(["side_m", "related"])["related"]["keep_clear_m"] == [0.3, 0.8]


@pytest.mark.parametrize("name", ["maze.v2", "13", "my-maze", "null", "a maze"])
def test_a_scene_may_have_any_name_that_a_file_may_have(composed, folder, name):
    (folder / "scene" / f"{name}.yaml").write_text(OWN.format(keep_clear_m=0.5))
    assert composed(["free", name])[name]["keep_clear_m"] == 0.5


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (OWN.format(keep_clear_m="${scene.sides}"), "Interpolation key 'scene.sides' not found"),
        (f"defaults: [plan]\n{OWN.format(keep_clear_m=0.5)}", "In 'scene/wrong': Could not load"),
    ],
    ids=["number", "file"],
)
def test_a_scene_that_cannot_be_composed_is_named_in_one_sentence(
    composed, folder, capsys, text, told
):
    (folder / "scene" / "wrong.yaml").write_text(text)
    with pytest.raises(SystemExit):
        composed(["free", "wrong"])
    said = capsys.readouterr().err
    assert said.startswith(f"error: scene/wrong cannot be composed: {told}")
    assert said.endswith("; mend this file.\n")
    assert said.count("\n") == 1


MINE = "paper1_map11: {flights: 1}\ngaps: {maps: 100, flights: 5}\n"


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (
            ["suite=[mine,paper]"],
            "suite.paper1_map11.flights is 1 in suite/mine and 20 in suite/paper; leave one of "
            "the suites out, or say which counts: suite.paper1_map11.flights=1.",
        ),
        (["suite=[paper,mine]"], "suite.paper1_map11.flights is 20 in suite/paper and 1 in suite/"),
        (["suite=[paper,mine]", "maps=3"], "suite.paper1_map11.flights is 20 in suite/paper and 1"),
        (["suite=[paper,mine]", "flights=null"], "suite.paper1_map11.flights is 20 in suite/paper"),
        (["suite=[gaps,drawn]"], "suite.gaps.maps is 100 in suite/gaps and null in suite/drawn"),
        (
            ["suite=[gaps,drawn]", "maps=7", "flights=3"],
            "suite.gaps.maps is 100 in suite/gaps and null in suite/drawn",
        ),
    ],
)
def test_suites_that_fly_a_scene_in_other_numbers_are_named(
    composed, folder, capsys, overrides, told
):
    (folder / "suite" / "mine.yaml").write_text(MINE)
    (folder / "suite" / "drawn.yaml").write_text("gaps: {flights: 5}\n")
    with pytest.raises(SystemExit):
        composed([], *overrides)
    said = capsys.readouterr().err
    assert said.startswith(f"error: {told}")
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    "overrides",
    [
        ["suite=[gaps,mine]"],  # the same numbers twice
        ["suite=[mine,paper]", "suite.paper1_map11.flights=3"],
        ["suite=[mine,paper]", "flights=3"],
        ["suite=[mine,paper]", "~suite.paper1_map11"],
        ["suite=short"],  # it begins with suite/paper
    ],
)
def test_suites_with_one_answer_are_flown(composed, folder, overrides):
    (folder / "suite" / "mine.yaml").write_text(MINE)
    (folder / "suite" / "short.yaml").write_text(f"defaults: [paper, _self_]\n{MINE}")
    assert composed([], *overrides)


KEPT = "search.clearance_m would change nothing: "


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["planned"], "planned says itself what the routes keep"),
        (["planned", "planned_map"], "planned, planned_map say themselves what the routes keep"),
    ],
)
def test_a_clearance_that_no_scene_of_an_evaluation_takes_from_the_search_is_refused(
    composed, capsys, names, said
):
    with pytest.raises(SystemExit):
        composed(names, "search.clearance_m=0.9")
    told = f"{KEPT}{said}; leave it out, or give '+scene.clearance_m=[0.9,0.9]'."
    assert capsys.readouterr().err == f"error: {told}\n"


def test_a_clearance_that_some_scenes_take_from_the_search_is_heeded(composed):
    assert len(composed(["planned", "forest_low"], "search.clearance_m=0.3")) == 2
    assert (
        composed(["planned"], "+scene.clearance_m=[0.9,0.9]")["planned"]["clearance_m"] == [0.9] * 2
    )


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (
            ["search.clearance_m=0.9"],
            f"{KEPT}scene=planned says itself what the routes keep; leave it out, or give "
            "scene.clearance_m=[0.9,0.9].",
        ),
        (["++search.clearance_m=0.9", "scene=planned_walls"], f"{KEPT}scene=planned_walls says"),
        (["+experiment=dial", "search.clearance_m=0.9"], f"{KEPT}scene=planned says itself"),
        (
            ["+scene@held_out.scene=planned_map", "search.clearance_m=0.9"],
            f"{KEPT}scene=planned, held_out.scene=planned_map say themselves",
        ),
        (
            ["+experiment=ablate_search", "held_out.search.clearance_m=0.9"],
            f"held_out.{KEPT}scene=planned says itself",
        ),
        (
            [
                "+scene@held_out.scene=forest_low",
                "+experiment=ablate_search",
                "search.clearance_m=1",
            ],
            f"{KEPT}scene=planned says itself",  # held-out flights have a search of their own
        ),
    ],
)
def test_a_clearance_that_no_scene_of_a_training_takes_from_the_search_is_refused(overrides, told):
    with pytest.raises(ConfigError, match=f"^{re.escape(told)}"):
        resc.load(*overrides)


@pytest.mark.parametrize(
    "overrides",
    [
        ["scene=forest_low", "search.clearance_m=0.3"],
        ["+scene@held_out.scene=forest_low", "search.clearance_m=0.3"],
        ["+experiment=ablate_search"],
        ["+experiment=mine"],
    ],
)
def test_a_clearance_that_is_kept_or_that_no_command_gives_stays(overrides, folder):
    (folder / "experiment").mkdir()
    (folder / "experiment" / "mine.yaml").write_text(
        "# @package _global_\nsearch:\n  clearance_m: 0.3\n"
    )
    resc.load(f"hydra.searchpath=[file://{folder}]", *overrides)


def test_train_refuses_a_clearance_that_changes_nothing_before_it_lays_out_scenes(
    call_script, capsys
):
    with pytest.raises(SystemExit, match="1"):
        call_script(train, "search.clearance_m=0.9", "hydra.run.dir=run")
    assert f"error: {KEPT}scene=planned says itself" in capsys.readouterr().err
