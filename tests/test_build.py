import re
import sys

import pytest
import torch
from omegaconf import OmegaConf

from resc.build import build, build_terms, load_config
from resc.errors import ConfigError
from resc.setup import build_stages, set_up
from resc.term import Reward, Sensor
from resc.terms.rewards.progress import Progress

PROGRESS = {"_target_": "resc.terms.rewards.progress.Progress", "weight": 2.0}


def refused(node, match, path="reward.progress", **options):
    with pytest.raises(ConfigError, match=match):
        build(node, path, **options)


def test_a_node_becomes_the_object_it_names():
    term = build(OmegaConf.create({**PROGRESS, "speed_mps": 4.0}), "reward.progress")
    assert isinstance(term, Progress)
    assert (term.weight, term.speed_mps, term.column_radius_m) == (2.0, 4.0, 0.5)


def test_null_stays_where_null_is_allowed():
    assert build({**PROGRESS, "column_radius_m": None}, "reward.progress").column_radius_m is None


def test_whole_numbers_become_numbers():
    term = build({**PROGRESS, "weight": 2, "column_radius_m": 1}, "reward.progress")
    assert (type(term.weight), type(term.column_radius_m)) == (float, float)


def test_a_misspelt_argument_gets_a_suggestion():
    refused(
        {**PROGRESS, "wieght": 1.0},
        r"reward\.progress\.wieght is not an argument of Progress\. Did you mean 'weight'\?",
    )


def test_a_misspelt_class_gets_a_suggestion():
    node = {**PROGRESS, "_target_": "resc.terms.rewards.progress.Progess"}
    refused(node, r"has no 'Progess'\. Did you mean 'Progress'\? Available: Progress\.$")


def test_a_misspelt_module_is_named():
    node = {**PROGRESS, "_target_": "resc.terms.rewards.progres.Progress"}
    refused(node, r"reward\.progress\._target_ is 'resc\.terms\.rewards\.progres\.Progress', but")


def test_a_missing_argument_is_named():
    refused(
        {"_target_": PROGRESS["_target_"]}, r"reward\.progress lacks weight, which Progress needs"
    )


def test_a_node_without_a_target_is_named():
    refused({"weight": 1.0}, r"reward\.progress has no _target_")


@pytest.mark.parametrize(
    ("value", "fact"),
    [
        ("high", "'high'; expected a number"),
        (None, "None; expected a number"),
        (True, "True; expected a number"),
        ([1.0], r"\[1\.0\]; expected a number"),
        (float("nan"), "nan; expected a finite number"),
        (float("-inf"), "-inf; expected a finite number"),
    ],
)
def test_a_weight_that_is_no_number_is_refused(value, fact):
    refused({**PROGRESS, "weight": value}, rf"reward\.progress\.weight is {fact}")


def test_an_optional_number_may_not_be_a_word_either():
    refused(
        {**PROGRESS, "column_radius_m": "wide"}, r"column_radius_m is 'wide'; expected a number"
    )


ACTION = {
    "_target_": "resc.terms.actions.body_rate_thrust.BodyRateThrust",
    "rate_limit_radps": [2.0, 2.0, 1.0],
    "thrust_range_g": [0.3, 1.7],
}


def test_whole_number_arguments_take_no_fractions():
    refused(
        {**ACTION, "longest_delay_steps": 1.5},
        "longest_delay_steps is 1.5; expected a whole number",
    )


@pytest.mark.parametrize(
    ("value", "fact"),
    [
        (3.0, "rate_limit_radps is 3.0; expected a list"),
        ("fast", "rate_limit_radps is 'fast'; expected a list"),
        ([2.0, "fast", 1.0], r"rate_limit_radps\[1\] is 'fast'; expected a number"),
        ([2.0, 2.0, float("nan")], r"rate_limit_radps\[2\] is nan; expected a finite number"),
        ([2.0, 2.0], r"rate_limit_radps is \[2\.0, 2\.0\]; expected 3 numbers"),
    ],
)
def test_a_list_of_anything_but_the_right_numbers_is_refused(value, fact):
    refused({**ACTION, "rate_limit_radps": value}, fact, path="action")


@pytest.mark.parametrize("thrust_range_g", [[0.3], [0.3, 1.0, 1.7]])
def test_a_range_of_other_than_two_numbers_is_refused(thrust_range_g):
    refused({**ACTION, "thrust_range_g": thrust_range_g}, "thrust_range_g", path="action")


def test_what_an_object_refuses_is_reported_with_its_path(load_part):
    node = {**load_part("vehicle", "imp250"), "mass_kg": -1.0}
    refused(node, r"^vehicle\.mass_kg is -1\.0; expected a number above 0", path="vehicle")


@pytest.mark.parametrize(
    "target",
    ["os.system", "builtins.eval", "subprocess.run", "torch.load", "rescue.Helicopter", "resc"],
)
def test_targets_outside_the_allowed_packages_are_refused(target):
    refused(
        {"_target_": target, "command": "true"},
        rf"'{target}', outside resc\.; opt in with allowed_targets",
    )


def test_who_has_opted_in_to_another_package_is_told_which_prefix_is_missing():
    refused(
        {"_target_": "mine.tilt.Tilt", "weight": 1.0},
        r"'mine\.tilt\.Tilt', outside resc\., yours\.; mine\. is not among them; "
        r"opt in with allowed_targets=\[yours\.,mine\.\]$",
        allowed=["yours."],
    )


def test_a_permitted_package_that_python_does_not_find_is_told_where_it_looks():
    refused(
        {"_target_": "nowhere_at_all.tilt.Tilt", "weight": 1.0},
        r"No module named 'nowhere_at_all' where Python looks for packages; set PYTHONPATH to the "
        r"folder that holds nowhere_at_all/",
        allowed=["nowhere_at_all."],
    )


@pytest.mark.parametrize(
    ("text", "reason"),
    [("def (", "SyntaxError: "), ("import nothing_like_it", "No module named"), ("1 / 0", "ZeroD")],
)
def test_a_module_that_cannot_be_imported_is_named_with_the_reason(
    tmp_path, monkeypatch, text, reason
):
    (tmp_path / "broken_for_build.py").write_text(f"{text}\n")
    monkeypatch.syspath_prepend(tmp_path)
    node = {"_target_": "broken_for_build.Thing"}
    refused(node, rf"broken_for_build.*{reason}", allowed=["broken_for_build."])


def test_a_class_that_raises_is_named_with_the_reason(tmp_path, monkeypatch):
    (tmp_path / "raising_for_build.py").write_text(
        "class Thing:\n    def __init__(self):\n        [][1]\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    node = {"_target_": "raising_for_build.Thing"}
    message = (
        r"^reward\.progress cannot be built: Thing raises IndexError: list index out of range\.$"
    )
    refused(node, message, allowed=["raising_for_build."])


@pytest.mark.parametrize("value", [10**400, 10**30, 1e30], ids=["400", "30", "float"])
def test_a_number_beyond_belief_is_refused_with_its_beginning(value):
    refused({**PROGRESS, "speed_mps": value}, r"speed_mps is -?1.*; expected a number")


@pytest.mark.parametrize("group", [3, "progress", ["progress"]])
def test_a_list_of_terms_that_is_none_is_refused(group):
    with pytest.raises(ConfigError, match=r"reward is .*; expected terms by their names"):
        build_terms(group, "reward", Reward)


def test_settings_that_refer_to_nothing_are_refused():
    node = OmegaConf.create({**PROGRESS, "weight": "${nowhere.weight}"})
    refused(node, r"reward\.progress cannot be resolved \(InterpolationKeyError")


def test_a_refused_target_is_not_even_imported(tmp_path, monkeypatch):
    (tmp_path / "trap_for_build.py").write_text("raise SystemExit('imported')\n")
    monkeypatch.syspath_prepend(tmp_path)
    refused({"_target_": "trap_for_build.Thing"}, "outside resc")
    assert "trap_for_build" not in sys.modules


def test_a_package_that_the_user_opts_in_to_is_built(tmp_path, monkeypatch):
    (tmp_path / "my_terms_for_build.py").write_text(
        "class Thing:\n    def __init__(self, *, size: float):\n        self.size = size\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    node = {"_target_": "my_terms_for_build.Thing", "size": 2.0}
    assert build(node, "thing", allowed=["my_terms_for_build."]).size == 2.0


@pytest.mark.parametrize(
    "node",
    [
        {
            "_target_": "resc.build.build",
            "config": {"_target_": "os.getcwd"},
            "path": "x",
            "allowed": ["os."],
        },
        {"_target_": "resc.build.locate", "target": "os.getcwd", "path": "x", "allowed": ["os."]},
        {"_target_": "resc.planning.route.build", "config": {}, "path": "x"},
        {"_target_": "resc.planning.route.planner_for", "config": {}},
        {"_target_": "resc.build.Path"},
        {"_target_": "resc.build.importlib.import_module", "name": "os"},
    ],
    ids=lambda node: node["_target_"],
)
def test_no_way_around_leads_through_our_own_functions_or_imports(node):
    with pytest.raises(ConfigError):
        build(node, "reward.progress")


def test_a_term_of_another_kind_is_refused():
    with pytest.raises(
        ConfigError, match=r"sensor\.progress builds a Progress, which is not a Sensor"
    ):
        build_terms({"progress": PROGRESS}, "sensor", Sensor)


def test_terms_set_to_null_are_left_out():
    terms = build_terms({"progress": PROGRESS, "time": None}, "reward", Reward)
    assert [term.name for term in terms] == ["progress"]


def test_observations_follow_the_layout_whatever_the_order_of_the_configuration(make_stages):
    usual = make_stages().observation_columns
    turned = make_stages(
        "observation=[planar_distances,body_x,control_points,heights,body_rate,attitude,velocity]"
    )
    assert turned.observation_columns == usual


@pytest.mark.parametrize("override", ["env.dt_s=0.0", "env.dt_s=-0.02", "env.resolution_m=0.0"])
def test_impossible_periods_and_cells_are_refused(compose, override):
    with pytest.raises(ConfigError, match=re.escape(override.split("=")[0])):
        build_stages(compose(override))


def test_the_same_seed_builds_the_same_pool_and_another_another(compose):
    config = compose()
    routes = [set_up(config, size=4, seed=seed).pool.layout.route_w for seed in (1, 1, 2)]
    assert torch.equal(routes[0], routes[1])
    assert not torch.equal(routes[0], routes[2])


def test_a_stored_configuration_that_does_not_exist_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"nothing_here.yaml does not exist"):
        load_config(tmp_path / "nothing_here.yaml")


def test_a_part_within_a_part_is_built_and_its_path_is_named():
    search = {
        "_target_": "resc.planning.route.RoutePlanner",
        "clearance_m": 0.4,
        "max_expansions": 1000,
        "spacing_m": [1.0, 2.0],
        "nominal_m": 1.5,
        "method": {"_target_": "resc.planning.searches.paper.Paper", "range_m": 2.0},
    }
    assert build(search, "search", resolution_m=0.1).search.method.range_m == 2.0
    search["method"]["rang_m"] = 2.0
    with pytest.raises(
        ConfigError, match=r"search\.method\.rang_m is not an argument of Paper\. Did you mean"
    ):
        build(search, "search", resolution_m=0.1)
    search["method"] = {"_target_": "os.getcwd"}
    with pytest.raises(ConfigError, match=r"search\.method\._target_ is 'os\.getcwd', outside"):
        build(search, "search", resolution_m=0.1)
