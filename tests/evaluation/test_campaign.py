"""A whole evaluation, small: what it leaves behind, and what it refuses."""

import csv
import json

import numpy as np
import pytest
import torch
from matplotlib import pyplot as plt
from mcap.reader import make_reader
from omegaconf import OmegaConf

from resc.errors import CheckpointError, ConfigError
from resc.evaluation.campaign import Evaluation
from resc.evaluation.compare import write_comparison
from resc.evaluation.courses import drawn
from resc.evaluation.entrants import read_entrants
from resc.evaluation.paired import share
from resc.evaluation.recorded import Recordings
from resc.evaluation.references import Reference, crossings, keep, limits_of
from resc.evaluation.suites import Amount
from resc.flying.pilot import Pilot, PolicyPilot
from resc.flying.pursuit import Pursuit
from resc.planning.trajectory import Trajectory
from resc.policies.stored import StoredPolicy
from resc.recording.reader import RolloutLog
from resc.recording.rollouts import digest

WALL = [2.5, 0.0, 0.5, 1.5]
SCENES = {
    "corridor": {
        "_target_": "resc.scenes.named.NamedScene",
        "boxes": [WALL],
        "start_m": [1.0, 2.2, 1.0],
        "goal_m": [3.0, 2.2, 1.0],
        "origin_m": [0.0, 0.0],
        "size_m": [6.0, 4.0],
        "jitter_m": 0.05,
    },
    "laid_out": {
        "_target_": "resc.scenes.training.TrainingScene",
        "boxes": 3,
        "points": 1,
        "spacing_m": [0.5, 0.8],
    },
}


@pytest.fixture(scope="module")
def run(evaluation, policy, tmp_path_factory):
    """Two flights in each of two scenes: the folder, and what was printed."""
    folder = tmp_path_factory.mktemp("evaluation") / "runs" / "2025-11-22" / "10-00-00_evaluate"
    stored = folder.parents[2] / "references.json"
    small = ["flights=2", "policy=somewhere", "recorder=mcap", "seed=4"]
    config = evaluation(*small, f"references={stored}")
    one = drawn("corridor", SCENES["corridor"], Amount(1), seed=4, planner=None)
    flight = Trajectory(0.5, np.linspace([1.0, 2.2, 1.0], [3.0, 2.2, 1.0], 9) ** 1.5)
    crossing = crossings(one.layout, one.nominal_w, limits_of(config["limits"]))[0]
    keep(Reference("corridor", crossing, 2.0, flight, flight), stored)
    return folder, Evaluation(config, policy, SCENES, ["flights=2", "seed=4"]).fly(folder)


def test_summary_counts_frames_and_scenes(run):
    folder, _ = run
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["episodes"] == 4
    assert list(summary["scenes"]) == ["corridor", "laid_out"]
    with (folder / "flights.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert summary["frames"] == sum(int(row["steps"]) for row in rows)
    assert summary["frames_per_s"] > 0
    assert summary["scenes"]["corridor"]["success_rate"] == 1.0
    assert summary["scenes"]["corridor"]["time_span_s"] == pytest.approx(1.5, abs=0.5)
    assert (summary["seed"], summary["policy"]) == (4, "somewhere")


def test_flights_are_measured_by_the_reference_of_their_scene(run):
    folder, text = run
    scenes = json.loads((folder / "summary.json").read_text())["scenes"]
    corridor = scenes["corridor"]
    assert corridor["time_over_bound"] == pytest.approx(corridor["time_span_s"] / 0.5, rel=1e-4)
    assert corridor["energy_over_smooth"] > 0
    assert scenes["laid_out"]["time_over_bound"] is None
    with (folder / "scenes.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert float(rows[0]["time_over_bound"]) == pytest.approx(corridor["time_over_bound"])
    (row,) = (line for line in text.splitlines() if line.startswith("| time / bound"))
    assert [cell.strip() for cell in row.split("|")[2:4]] == [
        f"{corridor['time_over_bound']:.2f}",
        "-",
    ]


def test_printed_report_is_the_stored_one_and_names_the_files(run):
    folder, text = run
    report = (folder / "report.md").read_text()
    table = [line for line in text.splitlines() if line.startswith("|")]
    assert all(line in report for line in table)
    for name in ("report.md", "scenes.csv", "flights.csv", "summary.json", "flights.png"):
        assert f"{folder / name}" in text
        assert (folder / name).stat().st_size > 0


def test_every_scene_has_a_picture(run):
    folder, _ = run
    for name in ("flights", "flight_corridor", "flight_laid_out"):
        height, width, _ = plt.imread(folder / f"{name}.png").shape
        assert width > 1000
        assert height > 400


def test_both_sets_of_rules_are_recorded(run):
    folder, _ = run
    assert len(RolloutLog(folder / "rollouts").episodes) == 2
    log = RolloutLog(folder / "rollouts_own_routes")
    assert len(log.episodes) == 2
    assert "boxes_w" in log.world


def test_a_recording_names_the_command_and_the_policy(run, policy):
    folder, _ = run
    metadata = RolloutLog(folder / "rollouts").metadata
    assert metadata["overrides"] == "flights=2 seed=4"
    assert metadata["policy_sha256"] == digest(policy.policy)
    assert metadata["seed"] == "4"
    assert len(metadata["git_commit"]) == 40


def test_first_best_and_worst_flights_are_written_as_scenes(run):
    folder, text = run
    found = sorted(path.name for path in (folder / "scenes").iterdir())
    expected = []
    for recording, course in (("rollouts", "corridor"), ("rollouts_own_routes", "laid_out")):
        flights = RolloutLog(folder / recording).episodes.sort("env_id")
        worst, best = (flights.sort("success", "return_")["env_id"][row] for row in (0, -1))
        assert best != worst
        marks = {best: "best", worst: "worst"}
        expected += [f"{course}_flight_0{number}_{marks[number]}.mcap" for number in (0, 1)]
    assert found == expected
    assert f"scenes    {folder / 'scenes'}" in text
    assert text.endswith("4 3-D scenes for Foxglove")


def test_scene_is_that_of_the_flight_it_names(run):
    folder, _ = run
    for number in (0, 1):
        (path,) = (folder / "scenes").glob(f"laid_out_flight_0{number}_*.mcap")
        with path.open("rb") as file:
            facts = {record.name: record.metadata for record in make_reader(file).iter_metadata()}
        assert facts["resc.episode"]["env_id"] == str(number)


@pytest.mark.slow
def test_flights_recorded_in_part_leave_a_sentence_in_place_of_scenes(evaluation, policy, tmp_path):
    config = evaluation("flights=1", "recorder=mcap", "recorder.every_n_batches=2")
    text = Evaluation(config, policy, {"corridor": SCENES["corridor"]}).fly(tmp_path)
    assert text.splitlines()[-1].startswith(
        "No (more) 3-D scenes: Some steps of 1 of these 1 episodes"
    )
    assert (tmp_path / "summary.json").exists()


def test_without_recorder_there_are_no_scenes(evaluation, policy, tmp_path):
    text = Evaluation(evaluation("flights=1"), policy, {"corridor": SCENES["corridor"]}).fly(
        tmp_path
    )
    assert not (tmp_path / "scenes").exists()
    assert "scenes" not in text.splitlines()[-1]


def test_negative_number_of_scenes_is_refused(evaluation, policy, tmp_path):
    with pytest.raises(ConfigError, match="scene_files is -1; expected 0 or more"):
        Evaluation(evaluation("scene_files=-1"), policy, SCENES).fly(tmp_path)


def test_run_stores_its_configuration_and_is_the_latest(run):
    folder, _ = run
    assert OmegaConf.load(folder / "config.yaml")["flights"] == 2
    assert (folder.parents[1] / "latest").resolve() == folder.resolve()


def test_refused_policy_leaves_no_summary(evaluation, policy, stored, tmp_path):
    wrong = StoredPolicy(policy.policy, (("compass", 2), *policy.layout[1:]), stored)
    with pytest.raises(CheckpointError, match="compass"):
        Evaluation(evaluation("flights=1"), wrong, SCENES).fly(tmp_path)
    assert not (tmp_path / "summary.json").exists()


FOREST = {
    "_target_": "resc.scenes.pillar_forest.PillarForest",
    "density_per_m2": 0.2,
    "forest_m": [1.0, -1.5, 2.0, 3.0],
    "origin_m": [-1.0, -2.0],
    "size_m": [6.0, 4.0],
    "keep_clear_m": 0.6,
    "goal_m": [3.0, 0.0, 1.0],
    "jitter_m": 0.1,
}


def test_suite_counts_its_maps_and_draws_the_worst(evaluation, policy, tmp_path):
    config = evaluation("+suite.grove={maps: 3, flights: 2}", "policy=somewhere", "scene_files=0")
    text = Evaluation(config, policy, {"grove": FOREST}).fly(tmp_path)
    with (tmp_path / "flights.csv").open() as file:
        flights = list(csv.DictReader(file))
    assert [row["map"] for row in flights] == ["0", "0", "1", "1", "2", "2"]
    ids = [row["map_id"] for row in flights]
    assert ids[::2] == ids[1::2]
    assert len(set(ids)) == 3
    assert all(0 <= float(row["spl"]) <= 1 for row in flights)
    scene = json.loads((tmp_path / "summary.json").read_text())["scenes"]["grove"]
    assert (scene["maps"], scene["redrawn"], scene["episodes"]) == (3, 0, 6)
    assert "| maps without a route" in text
    height, width, _ = plt.imread(tmp_path / "flight_grove.png").shape
    assert width > 500 < height


@pytest.fixture(scope="module")
def together(evaluation, policy, tmp_path_factory):
    """Two flights each by two pilots: the folder, and what was printed."""
    folder = tmp_path_factory.mktemp("together")
    pilots = [PolicyPilot(policy), Pursuit(speed_mps=1.5).named("pursuit")]
    config = evaluation("flights=2", "recorder=mcap", "scene_files=0")
    return folder, Evaluation(config, policy, SCENES, given_pilots=pilots).fly(folder)


def test_table_of_two_pilots_has_a_row_for_each_and_every_scene(together):
    folder, text = together
    rows = [line.split("|")[1:3] for line in text.splitlines() if line.startswith("|")][2:]
    names = [(scene.strip(), pilot.strip()) for scene, pilot in rows]
    assert names == [(s, p) for s in (*SCENES, "all") for p in ("policy", "pursuit")]
    assert (folder / "together_corridor.png").exists()
    assert text.split("\n\nreport")[0].strip() in (folder / "report.md").read_text()


def test_flights_of_two_pilots_are_told_apart_and_start_alike(together):
    folder, _ = together
    with (folder / "flights.csv").open() as file:
        flights = list(csv.DictReader(file))
    assert [row["pilot"] for row in flights] == ["policy"] * 4 + ["pursuit"] * 4
    with (folder / "scenes.csv").open() as file:
        assert [row["pilot"] for row in csv.DictReader(file)] == ["policy"] * 3 + ["pursuit"] * 3
    worlds = [RolloutLog(folder / name / "rollouts") for name in ("policy", "pursuit")]
    assert [log.metadata["pilot"] for log in worlds] == ["policy", "pursuit"]
    assert worlds[1].metadata["speed_mps"] == "1.5"
    ours, theirs = (log.start(0)[("state", "position_w")] for log in worlds)
    assert torch.equal(ours, theirs)


def test_summary_of_two_pilots_has_that_of_each(together):
    folder, _ = together
    summary = json.loads((folder / "summary.json").read_text())
    assert list(summary["pilots"]) == ["policy", "pursuit"]
    assert summary["pilots"]["pursuit"]["episodes"] == 4
    assert summary["pilots"]["pursuit"]["pilot"]["speed_mps"] == "1.5"


def test_every_pilot_has_its_pictures(together):
    folder, _ = together
    for name in ("policy", "pursuit"):
        assert (folder / name / "flight_corridor.png").exists()


def test_two_pilots_are_compared_and_their_paths_drawn_over_one_another(together, tmp_path):
    folder, _ = together
    entrants = read_entrants([folder])
    shared = share(entrants)
    text = write_comparison(entrants, shared, tmp_path / "out")
    assert text.startswith("# pursuit against policy\n")
    assert "4 flights are compared." in text
    assert "left out" not in text
    for scene in SCENES:
        assert plt.imread(tmp_path / "out" / f"paths_{scene}.png").shape[1] > 600
    recordings = Recordings(entrants[1])
    for key, first in zip(recordings.places, shared.table["counted/1"], strict=True):
        start = recordings.layout(key).start_w[0, :2].numpy()
        assert np.abs(recordings.path(key, first)[0] - start).max() < 0.2


def test_pilot_that_cannot_fly_is_refused_before_anything_is_planned(evaluation, policy, tmp_path):
    class Blind(Pilot):
        def check(self, stages):
            raise ConfigError("pilot.blind needs eyes.")

        def act(self, world, observation):
            return observation

    scenes = {"nowhere": {"_target_": "resc.scenes.nowhere.Nowhere"}}
    with pytest.raises(ConfigError, match="needs eyes"):
        Evaluation(evaluation(), policy, scenes, given_pilots=[Blind()]).fly(tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("changed", ["room.npz", "room.pgm", "room.yaml", "room.ply", "room.npy"])
def test_an_evaluation_on_a_map_file_that_was_edited_is_another(
    changed, evaluation, policy, tmp_path
):
    for suffix in ("npz", "pgm", "ply", "npy"):
        (tmp_path / f"room.{suffix}").write_bytes(b"one")
    needed = "resolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 1\nfree_thresh: 0\n"
    (tmp_path / "room.yaml").write_text(f"image: room.pgm\n{needed}")

    def fingerprint():
        scenes = {name: {"file": str(tmp_path / f"room.{name}")} for name in ("npz", "ply")}
        scenes["grid"] = {"occupancy": str(tmp_path / "room.npy"), "law": "long" * 999}
        scenes["windows"] = {"families": {"map": {"file": str(tmp_path / "room.yaml")}}}
        return Evaluation(evaluation(), policy, scenes).fingerprint

    before = fingerprint()
    assert fingerprint() == before
    with (tmp_path / changed).open("ab") as file:
        file.write(b"# two\n")
    assert fingerprint() != before


def test_two_choices_of_the_dynamics_are_refused(evaluation, policy):
    both = ["simulator=mujoco", "dynamics=lag_and_drag"]
    with pytest.raises(ConfigError, match="simulator=mujoco chooses the dynamics, and so does dyn"):
        Evaluation(evaluation(*both), policy, {}, both).check()
    alone = ["simulator=own", "dynamics=lag_and_drag"]
    Evaluation(evaluation(*alone), policy, {}, alone).check()
