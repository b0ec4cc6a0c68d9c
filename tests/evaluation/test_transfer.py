"""A policy under other conditions: the conditions themselves, the numbers, the command."""

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib import pyplot as plt
from omegaconf import OmegaConf

from resc.build import load_config
from resc.errors import ConfigError
from resc.evaluation.campaign import Evaluation
from resc.evaluation.transfer import as_evaluation, condition_of
from resc.evaluation.transfer_report import Flown, line_of, write_transfer
from resc.places import CONF

ROOT = Path(__file__).parents[2]
CONDITIONS = sorted((CONF / "condition").glob("*.yaml"))
NEEDS = {"simulator=rotorpy": "rotorpy", "simulator=mujoco": "mujoco"}


@pytest.mark.parametrize("path", CONDITIONS, ids=lambda path: path.stem)
def test_every_condition_composes_and_builds(path, evaluation, policy):
    condition = condition_of(path.stem, load_config(path))
    for override in condition.overrides:
        if override in NEEDS:
            pytest.importorskip(NEEDS[override])
    config = evaluation(*condition.overrides)
    Evaluation(config, policy, {}, condition.overrides).check()
    nominal = evaluation()
    assert (config != nominal) == bool(condition.overrides)


def flown(name, success, time, clearance):
    count = len(success)
    columns = {
        "scene": ["a"] * count,
        "flight": range(count),
        "map": [0] * count,
        "success": success,
        "time_within_half_metre": time,
        "bound": [4.0] * (count - 1) + [""],
        "least_clearance": clearance,
        "margin": [0.3] * count,
    }
    return Flown(name, name.title(), {k: np.array([str(x) for x in v]) for k, v in columns.items()})


NOMINAL = flown("nominal", [True] * 4, [5.0, 5.0, 8.0, 10.0], [0.5, 0.4, 0.3, 0.2])
OTHER = flown("other", [True, True, False, True], [6.0, 5.5, 2.0, 9.0], [0.4, 0.1, -0.01, 0.3])


def test_times_are_compared_flight_by_flight_where_both_arrive():
    line = line_of(OTHER, NOMINAL)
    assert line.time_to_nominal == pytest.approx(1.1)  # of 1.2, 1.1 and 0.9
    assert line.time_over_bound == pytest.approx(5.75 / 4)  # of those that arrive and have a bound
    assert (line.flights, line.success, line.to_nominal) == (4, 0.75, -0.25)
    assert line.low < 0.75 < line.high
    assert (line.closer, line.least_clearance_m) == (0.5, -0.01)


def on_maps(flown, *ids):
    numbers = {"map": np.arange(4).astype(str), "map_id": np.array(ids)}
    return Flown(flown.name, flown.title, {**flown.columns, **numbers})


def test_only_flights_on_the_same_map_are_compared(tmp_path):
    nominal = on_maps(NOMINAL, "m1", "m2", "m3", "m4")
    other = on_maps(OTHER, "m1", "m5", "m6", "m4")
    line = line_of(other, nominal)
    assert (line.success, line.to_nominal) == (0.75, 0.0)
    assert line.time_to_nominal == pytest.approx(1.05)  # of 1.2 and 0.9
    text = write_transfer([nominal, other], tmp_path)
    assert "Other: 2 of 4 maps of a are not those of the nominal condition" in text
    strange = on_maps(OTHER, "m7", "m8", "m9", "m0")
    row = next(x for x in write_transfer([nominal, strange], tmp_path).splitlines() if "Other" in x)
    assert [cell.strip() for cell in row.split("|")][5:7] == ["-", "-"]


def test_report_table_and_picture_hold_every_condition(tmp_path):
    text = write_transfer([NOMINAL, OTHER], tmp_path)
    row = next(line for line in text.splitlines() if line.startswith("| Other"))
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert cells[1:3] == ["4", "75.0"]
    assert cells[4:6] == ["-25.0", "1.10"]
    assert (tmp_path / "transfer.md").read_text().endswith(text)
    with (tmp_path / "transfer.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == ["nominal", "other"]
    assert float(rows[1]["success"]) == 0.75
    assert plt.imread(tmp_path / "transfer.png").shape[1] > 1000


def test_a_condition_under_which_none_arrives_has_no_times():
    line = line_of(flown("lost", [False] * 4, ["inf"] * 4, [0.0] * 4), NOMINAL)
    assert line.success == 0
    assert np.isnan([line.time_to_nominal, line.time_over_bound]).all()


@pytest.mark.parametrize(
    "content",
    [{}, {"title": "x"}, {"title": "x", "overrides": "seed=1"}, {"title": "x", "override": []}],
)
def test_a_file_that_is_no_condition_is_one_sentence(content):
    with pytest.raises(ConfigError, match=r"condition/mine holds .*; expected a title and a list"):
        condition_of("mine", OmegaConf.create(content))


def test_the_conditions_are_told_from_the_overrides():
    given = ["policy=latest", "conditions=[mujoco,delay_20_ms]", "suite=paper"]
    assert as_evaluation(given) == (["policy=latest", "suite=paper"], ["mujoco", "delay_20_ms"])
    for wrong in ("pilot=pursuit", "replay=x#1", "-m", "--cfg"):
        with pytest.raises(ConfigError):
            as_evaluation([wrong])


@pytest.fixture(scope="module")
def mine(tmp_path_factory):
    """A folder with a condition of the user's own."""
    folder = tmp_path_factory.mktemp("mine")
    (folder / "condition").mkdir()
    overrides = ["randomization=[mass]", "randomization.mass.spread=0.3"]
    condition = OmegaConf.create({"title": "heavier", "overrides": overrides})
    OmegaConf.save(condition, folder / "condition" / "heavier.yaml")
    return folder


def transfer(tmp_path, *arguments):
    line = [sys.executable, "-m", "resc.evaluation.transfer", *arguments]
    small = ["flights=1", "recorder=none", "scenes=[paper4_map15]", "name=t"]
    return subprocess.run(
        [*line, *small, f"hydra.run.dir={tmp_path / 'out'}"],
        cwd=ROOT, capture_output=True, text=True, timeout=300,
    )  # fmt: skip


@pytest.mark.slow
def test_the_command_flies_conditions_of_ones_own(mine, tmp_path):
    done = transfer(tmp_path, "conditions=[heavier,delay_20_ms]", "--config-dir", str(mine))
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "out"
    with (folder / "transfer.csv").open(newline="") as file:
        assert [row["name"] for row in csv.DictReader(file)] == [
            "nominal",
            "heavier",
            "delay_20_ms",
        ]
    assert (folder / "heavier" / "flights.csv").exists()
    assert "heavier" in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["conditions=muojco"], "condition has no 'muojco'. Did you mean 'mujoco'?"),
        (["conditions=mujoco", "policy=nowhere"], "nowhere holds no policy.pt"),
    ],
)
def test_bad_input_is_one_sentence(tmp_path, arguments, told):
    done = transfer(tmp_path, *arguments)
    assert done.returncode == 1
    assert told in done.stderr
    assert done.stderr.count("\n") == 1
