"""Stored references: feasible by their own numbers, found by all that they depend on."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf

from resc.errors import ConfigError
from resc.evaluation.by_pilot import references_of
from resc.evaluation.courses import lay_out
from resc.evaluation.references import (
    STORED,
    Reference,
    crossings,
    digest,
    files_of,
    keep,
    limits_of,
    outdone,
    read_references,
)
from resc.math.geometry import box_distance, pillar_distance
from resc.planning.time_optimal import ARRIVAL_M, Limits
from resc.planning.trajectory import Trajectory

LIMITS = Limits(speed_mps=3.0, acceleration_mps2=6.0, jerk_mps3=20.0, margin_m=0.3)
KEPT = read_references()
PAPER = ("paper1_map11", "paper2_map12", "paper3_map13", "paper4_map15")
POINTS = 2_000
"""At which a flight is checked: every 5 ms of ten seconds."""
KINDS = ("fastest", "smooth")


@pytest.fixture
def made_up(corridor):
    """A reference of the corridor; nobody could fly it."""
    crossing = crossings(corridor(1).layout, corridor(1).nominal_w, LIMITS)[0]
    flight = Trajectory(2.0, np.linspace([1, 1, 1], [4, 1, 1], 8) + 1e-9)
    return Reference("corridor", crossing, 4.0, flight, flight)


def stored_flights(kind):
    """Where and how each reference of a kind flies."""
    for reference in KEPT.values():
        yield reference.crossing, getattr(reference, kind)


@pytest.mark.parametrize("kind", KINDS)
def test_stored_flights_keep_to_their_limits(kind):
    for crossing, flight in stored_flights(kind):
        limits, said = crossing.limits, digest(crossing)
        _, velocity, acceleration = flight.at(np.linspace(0, flight.duration_s, POINTS))
        assert np.linalg.norm(velocity, axis=1).max() <= limits.speed_mps * 1.002, said
        assert np.linalg.norm(acceleration, axis=1).max() <= limits.acceleration_mps2 * 1.001, said
        assert np.linalg.norm(flight.jerk_mps3, axis=1).max() <= limits.jerk_mps3 * 1.005, said


@pytest.mark.parametrize("kind", KINDS)
def test_stored_flights_keep_clear_of_every_obstacle_and_in_the_map(kind):
    for crossing, flight in stored_flights(kind):
        keeps_clear(crossing, flight)


def keeps_clear(crossing, flight):
    points = flight.line(POINTS)
    for width, distance in ((4, box_distance), (3, pillar_distance)):
        kind_of = [shape for shape in crossing.boxes if len(shape) == width]
        if kind_of:
            shapes = torch.tensor(kind_of, dtype=torch.float64).expand(len(points), -1, -1)
            assert distance(torch.tensor(points), shapes).min() >= crossing.limits.margin_m
    low = np.array(crossing.origin_m)
    assert (points >= low).all()
    assert (points <= low + crossing.size_m).all()


@pytest.mark.parametrize("kind", KINDS)
def test_stored_flights_lead_without_a_jump_from_rest_at_the_start_to_the_goal(kind):
    for crossing, flight in stored_flights(kind):
        leads_there(crossing, flight)


def leads_there(crossing, flight):
    times = np.linspace(0, flight.duration_s, 20_000)  # acceleration has kinks
    position, velocity, acceleration = flight.at(times)
    np.testing.assert_allclose(position[0], crossing.start_m, atol=1e-9)
    np.testing.assert_allclose(velocity[0], 0, atol=1e-9)
    np.testing.assert_allclose(acceleration[0], 0, atol=1e-9)
    assert np.linalg.norm(position[-1] - crossing.goal_m) <= ARRIVAL_M + 1e-5
    for of, rate in ((position, velocity), (velocity, acceleration)):
        mean = (rate[1:] + rate[:-1]) / 2
        np.testing.assert_allclose(np.diff(of, axis=0) / times[1], mean, atol=2e-3)


def test_stored_keys_are_the_digests_of_what_is_stored_with_them():
    for key, reference in KEPT.items():
        assert digest(reference.crossing) == key
        assert reference.fastest.duration_s <= reference.smooth.duration_s, key


def test_stored_file_is_small():
    assert STORED.stat().st_size < 1_000_000


@pytest.mark.parametrize("name", PAPER)
def test_every_flight_of_the_papers_maps_has_a_reference_whatever_its_jitter(
    name, load_part, planner, evaluation
):
    scenes = {name: OmegaConf.to_container(load_part("scene", name))}
    course = lay_out(scenes, 3, seed=5, planner=planner)[0]
    found = references_of(course, limits_of(evaluation()["limits"]), KEPT)
    assert [reference.scene for reference in found] == [name] * 3


@pytest.mark.parametrize(
    "change",
    [
        {"boxes": ((0.0, 3.0, 6.0, 0.5), (2.5, 0.0, 0.5, 1.6))},
        {"start_m": (1.0, 1.1, 1.0)},
        {"goal_m": (4.5, 1.1, 1.0)},
        {"size_m": (6.0, 5.0)},
        {"limits": replace(LIMITS, margin_m=0.2)},
        {"limits": replace(LIMITS, jerk_mps3=30.0)},
    ],
    ids=lambda change: next(iter(change)),
)
def test_changed_scene_or_limit_finds_no_stale_reference(made_up, change):
    assert digest(replace(made_up.crossing, **change)) != made_up.digest


def test_order_of_boxes_and_boxes_that_do_not_exist_change_no_reference(corridor):
    course = corridor(1)
    layout = course.layout
    parked = layout.boxes_w.new_tensor([[[1e6, 1e6, 0.0, 0.0]]])
    boxes = torch.cat((parked, layout.boxes_w.flip(1)), 1)
    same = crossings(replace(layout, boxes_w=boxes), course.nominal_w, LIMITS)
    assert same == crossings(layout, course.nominal_w, LIMITS)


def test_a_pillar_makes_it_another_scene(corridor):
    course = corridor(1)
    pillars = torch.tensor([[[3.0, 1.0, 0.25], [1e6, 1e6, 0.0]]])
    (with_it,) = crossings(replace(course.layout, pillars_w=pillars), course.nominal_w, LIMITS)
    (without,) = crossings(course.layout, course.nominal_w, LIMITS)
    assert set(with_it.boxes) == {*without.boxes, (3.0, 1.0, 0.25)}
    assert digest(with_it) != digest(without)


def test_reference_is_read_as_it_was_kept_beside_the_others(made_up, tmp_path):
    path = tmp_path / "mine" / "references.json"
    other = replace(made_up, crossing=replace(made_up.crossing, goal_m=(5.0, 1.0, 1.0)))
    kept = [keep(reference, path) for reference in (made_up, other, made_up)]
    found = read_references(path)
    assert set(found) == {made_up.digest, other.digest}
    assert found[made_up.digest].crossing == made_up.crossing
    np.testing.assert_array_equal(
        found[made_up.digest].fastest.control_m, kept[0].fastest.control_m
    )


def test_an_installed_resc_keeps_references_beside_those_that_came_with_it(
    made_up, tmp_path, monkeypatch
):
    """Of a scene that both have, the better flight of each kind counts, and is stored."""
    shipped, own = tmp_path / "shipped.json", tmp_path / "references.json"
    elsewhere = replace(made_up, crossing=replace(made_up.crossing, goal_m=(5.0, 1.0, 1.0)))
    for reference in (made_up, elsewhere):
        keep(reference, shipped)
    before = shipped.read_bytes()
    monkeypatch.setattr("resc.evaluation.references.STORED", shipped)
    monkeypatch.setattr("resc.evaluation.references.OWN", own)
    slower = replace(made_up.fastest, duration_s=2 * made_up.fastest.duration_s)
    mine = replace(made_up, crossing=replace(made_up.crossing, goal_m=(6.0, 1.0, 1.0)))
    assert keep(mine).digest == mine.digest
    assert keep(replace(made_up, fastest=slower)).fastest.duration_s == made_up.fastest.duration_s
    assert shipped.read_bytes() == before
    assert set(read_references(own)) == {mine.digest, made_up.digest}
    assert set(read_references()) == {mine.digest, made_up.digest, elsewhere.digest}
    assert files_of() == (shipped, own)
    assert files_of(own) == (own,)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": 9}', '{"format": 1}'])
def test_damaged_file_is_one_sentence(text, tmp_path):
    path = tmp_path / "references.json"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"references.json is cut or damaged \(.*restore it"):
        read_references(path)


def test_missing_file_of_ones_own_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"references is '.*mine.json', which does not exist"):
        read_references(tmp_path / "mine.json")


def test_limits_follow_what_a_flight_is_measured_by(evaluation):
    slower = evaluation("sensor.limit_violations.speed_mps=2.0", "limits.margin_m=0.2")
    assert limits_of(slower["limits"]) == replace(LIMITS, speed_mps=2.0, margin_m=0.2)


def test_limits_without_the_sensor_say_what_to_give():
    speed = "${sensor.limit_violations.speed_mps}"
    node = {"_target_": "resc.planning.time_optimal.Limits", "speed_mps": speed}
    with pytest.raises(ConfigError, match=r"follow sensor.limit_violations, which is left out"):
        limits_of(OmegaConf.create({"limits": node, "sensor": {}})["limits"])


def test_the_better_of_two_flights_of_a_scene_is_kept_of_each_kind(made_up, tmp_path):
    def with_(fastest_s, smooth_s):
        flights = {"fastest": fastest_s, "smooth": smooth_s}
        return replace(
            made_up,
            **{k: Trajectory(t, made_up.fastest.control_m) for k, t in flights.items()},
        )

    keep(with_(2.0, 3.0), tmp_path / "mine.json")
    stored = keep(found := with_(2.5, 2.9), tmp_path / "mine.json")
    assert (stored.fastest.duration_s, stored.smooth.duration_s) == (2.0, 2.9)
    (said,) = outdone(found, stored)
    assert said.startswith("fastest of before kept, 2.00 s")
    assert outdone(stored, stored) == []
