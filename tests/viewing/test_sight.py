"""What observations see, as places on the map."""

import math
from pathlib import Path

import pytest
import torch
from torch.testing import assert_close

from resc import keys
from resc.build import build_terms, load_config
from resc.errors import ConfigError
from resc.maps.observation import MapObservation
from resc.sights import Pose, Shape
from resc.term import Context, Observation
from resc.terms.observations.depth_scan import DepthScan
from resc.terms.observations.esdf_patch import EsdfPatch
from resc.terms.observations.heights import Heights
from resc.terms.observations.kgp_esdf import KgpEsdf
from resc.terms.observations.sdf_gradient import SdfGradient
from resc.viewing.sight import seen_by

CONTEXT = Context(dt_s=0.02, resolution_m=0.1, vehicle=None)
POSE = Pose(
    position=torch.tensor([[1.0, 2.0], [1.0, 2.0]]),
    velocity=torch.tensor([[0.0, 3.0], [0.0, 0.0]]),
    yaw=torch.tensor([0.0, math.pi / 2]),
    control_points=torch.tensor([[5.0, 2.0], [5.0, 6.0]]).expand(2, 2, 2),
)
"""At (1, 2), once flying north and once at rest; control points in the east."""


def seen(term, *rows):
    term.bind(CONTEXT)
    return {shape.label: shape for shape in term.sights(torch.tensor(rows), POSE)}


@pytest.mark.parametrize("measured", ["velocity", "control_point"])
def test_kgp_edges_and_free_distance_are_places_on_the_map(measured):
    row = [0.5, 0.1, 0.5, -0.1, 0.6, 0.2, 0.6, -0.2, 1.5]
    found = seen(KgpEsdf(free_distance=measured), row, row)
    edges = found["edges beside control point 0"]
    assert edges.kind == "edges"
    assert_close(edges.places[0], torch.tensor([[1.6, 2.2], [1.6, 1.8]]))
    assert_close(
        found["edges beside the velocity"].places[0], torch.tensor([[1.5, 2.1], [1.5, 1.9]])
    )
    if measured == "velocity":
        free = found["free distance along the velocity"].places
        # At rest the velocity has no direction; the ray then leads to the control point.
        assert_close(free, torch.tensor([[[1.0, 3.5]], [[2.5, 2.0]]]))
    else:
        free = found["free distance toward control point 0"].places
        assert_close(free, torch.tensor([[[2.5, 2.0]], [[2.5, 2.0]]]))


def test_gradient_without_direction_draws_its_distance_alone():
    found = seen(SdfGradient(), [2.0, 0.0, 1.0], [3.0, 0.0, 0.0])
    arrow = found["direction of the nearest obstacle"].places
    assert_close(arrow[0], torch.tensor([[1.0, 4.0]]))
    assert arrow[1].isnan().all()
    circle = found["distance"].places
    assert_close((circle - torch.tensor([1.0, 2.0])).norm(dim=-1)[1], torch.full((65,), 3.0))


def test_scan_spreads_its_beams_from_left_to_right_of_the_heading():
    scan = DepthScan(beams=3, field_of_view_rad=math.pi / 2, range_m=5.0)
    found = seen(scan, [2.0, 5.0, 0.0], [2.0, 5.0, 0.0])
    root = math.sqrt(2)
    beams = found["beams"].places
    assert_close(beams[0, :2], torch.tensor([[1 + root, 2 + root], [6.0, 2.0]]))
    assert_close(beams[1, :2], torch.tensor([[1 - root, 2 + root], [1.0, 7.0]]))  # facing north
    assert beams[:, 2].isnan().all()
    hits = found["depths"].places
    assert_close(hits[0, 0], beams[0, 0])
    assert hits[:, 1:].isnan().all()  # nothing in range, and a reading that was lost
    lost = found["beams without a reading"].places
    assert lost[:, :2].isnan().all()
    assert_close(lost[0, 2], torch.tensor([1 + 0.3 * root, 2 - 0.3 * root]))


@pytest.mark.parametrize(("alignment", "first"), [("world", (0.9, 2.1)), ("heading", (0.9, 1.9))])
def test_patch_turns_with_the_heading_if_it_is_aligned_with_it(alignment, first):
    numbers = [float(n) for n in range(9)]
    patch = seen(EsdfPatch(alignment=alignment), numbers, numbers)["points looked up"]
    assert_close(patch.places[0, 0], torch.tensor([0.9, 2.1]))
    assert_close(patch.places[1, 0], torch.tensor(first))
    assert_close(patch.values[1], torch.arange(9.0))


def test_term_that_sees_no_obstacles_has_no_shapes():
    assert seen(Heights(ceiling_m=2.0), [1.0, 1.0], [1.0, 1.0]) == {}


def test_every_shipped_observation_of_the_map_is_drawn():
    files = (Path(__file__).parents[2] / "conf/obstacle_observation").glob("*.yaml")
    terms = [
        term
        for file in files
        for term in build_terms(load_config(file), "observation", Observation)
        if isinstance(term, MapObservation)
    ]
    assert len(terms) > 6
    assert all(type(term).sights is not Observation.sights for term in terms)


def test_a_shape_of_unknown_kind_or_role_is_refused():
    places = torch.zeros(1, 1, 2)
    with pytest.raises(ConfigError, match=r"'gate' has the kind 'dot'.*Did you mean 'dots'"):
        Shape("gate", "dot", "point", places)
    with pytest.raises(ConfigError, match=r"'gate' has the role 'points'.*Did you mean 'point'"):
        Shape("gate", "dots", "points", places)


class Blown(Observation):
    """Draws itself from what no recording holds."""

    reads = (("sensor", "wind"),)
    columns = ("x", "y")

    def sights(self, numbers, pose):
        return [Shape("wind", "arrow", "point", pose.at(numbers))]


def test_sights_from_what_is_not_recorded_are_refused():
    with pytest.raises(ConfigError, match=r"observation\.blown reads sensor\.wind, so its sights"):
        seen_by(Blown().named("blown"), CONTEXT, {keys.POSITION_W: torch.zeros(1, 3)}, torch.zeros)
