"""Each number of the policy's input, by its index in the released order (facts 3), at one pose."""

import math

import pytest
import torch
from torch.testing import assert_close

from resc import keys
from resc.maps.distance_field import select
from resc.maps.distance_transform import distance_transform
from resc.maps.ray_casting import free_distance, guided
from resc.math.rotation import quaternion_from_euler

X, Y, Z = 5.23, 6.07, 0.9
VELOCITY = (0.5, -1.2, 0.3)
EULER = (0.1, -0.2, 0.7)
RATE = (0.4, -0.6, 0.8)
FIRST, SECOND = (7.23, 7.07, 1.1), (8.23, 5.07, 0.8)
BOX = (60, 56, 4, 5)  # rows, columns: x 5.6..6.1, y 6.0..6.4


@pytest.fixture(scope="module")
def pose():
    """The tensors of one environment at the pose above."""
    row, column, height, width = BOX
    occupied = torch.zeros(1, 120, 120, dtype=torch.bool)
    occupied[0, row : row + height, column : column + width] = True
    euler = torch.tensor([EULER])
    return {
        keys.POSITION_W: torch.tensor([[X, Y, Z]]),
        keys.VELOCITY_W: torch.tensor([VELOCITY]),
        keys.ATTITUDE_WB: quaternion_from_euler(euler),
        keys.BODY_RATE_B: torch.tensor([RATE]),
        keys.EULER: euler,
        keys.CONTROL_POINTS_W: torch.tensor([[FIRST, SECOND]]),
        keys.SCENE_INDEX: torch.zeros(1, 1, dtype=torch.int64),
        keys.ESDF: distance_transform(occupied, 0.1, 3.0),
        keys.MAP_ORIGIN_W: torch.zeros(1, 2),
        keys.MAP_SIZE: torch.full((1, 2), 12.0),
    }


def observe(stages, tensors):
    blocks = [
        term.compute(*(tensors[key] for key in term.reads)) * term.scale
        for term in stages.terms.observations
    ]
    return torch.cat(blocks, -1)[0]


def body_x():
    _, pitch, yaw = EULER
    return [math.cos(pitch) * math.cos(yaw), math.cos(pitch) * math.sin(yaw), -math.sin(pitch)]


# In cells, between centres: the vehicle is in row 60 and column 52, the box begins in column 56.
PATCH = [
    math.hypot(5, 0),
    4,
    3,
    5,
    4,
    3,
    math.hypot(5, 1),
    math.hypot(4, 1),
    math.hypot(3, 1),
]

WITHOUT_OBSTACLES = {
    "velocity": (VELOCITY, 0, 2),
    "attitude": (EULER, 3, 5),
    "body rate": (RATE, 6, 8),
    "distance to the ceiling": ([2.0 - Z], 9, 20),
    "distance to the ground": ([Z], 10, 21),
    "first control point": ([2.0, 1.0, 0.2], 11, 31),
    "second control point": ([3.0, -1.0, -0.1], 14, 34),
    "second from first": ([1.0, -2.0, -0.3], 17, 37),
    "body x axis": (body_x(), 20, 40),
    "planar distance to the first": ([math.sqrt(5)], 23, 43),
    "planar distance to the second": ([math.sqrt(10)], 24, 44),
}


@pytest.mark.parametrize("name", WITHOUT_OBSTACLES)
def test_the_25_numbers_stand_at_their_indices(make_stages, pose, name):
    values, start, _ = WITHOUT_OBSTACLES[name]
    seen = observe(make_stages("obstacle_observation=none"), pose)
    assert len(seen) == 25
    assert_close(seen[start : start + len(values)], torch.tensor(list(values)), atol=1e-6, rtol=0)


@pytest.mark.parametrize("name", WITHOUT_OBSTACLES)
def test_the_same_numbers_stand_at_their_indices_among_the_45(make_stages, pose, name):
    values, _, start = WITHOUT_OBSTACLES[name]
    seen = observe(make_stages(), pose)
    assert len(seen) == 45
    assert_close(seen[start : start + len(values)], torch.tensor(list(values)), atol=1e-6, rtol=0)


def test_the_offset_within_the_cell_stands_first(make_stages, pose):
    assert_close(observe(make_stages(), pose)[:2], torch.tensor([0.03, 0.07]), atol=1e-6, rtol=0)


def test_the_distance_patch_runs_row_by_row_from_the_upper_left(make_stages, pose):
    expected = torch.tensor(PATCH, dtype=torch.float32) * 0.1
    stages = make_stages("env.observation_frame=world")
    assert_close(observe(stages, pose)[11:20], expected, atol=1e-6, rtol=0)


def test_velocity_edges_come_before_control_point_edges_and_the_free_distance(make_stages, pose):
    field = select(
        *(pose[key] for key in (keys.ESDF, keys.SCENE_INDEX, keys.MAP_ORIGIN_W, keys.MAP_SIZE)), 0.1
    )
    here = torch.tensor([[X, Y]])
    far = math.dist((X, Y, Z), FIRST) / math.hypot(
        *VELOCITY
    )  # the velocity control point is as far as the first one
    ahead = torch.tensor([[VELOCITY[0] * far, VELOCITY[1] * far]])
    radius = torch.tensor([[math.hypot(VELOCITY[0], VELOCITY[1]) * far + 0.3, 2.0]])
    to_first = torch.tensor([[FIRST[0] - X, FIRST[1] - Y]])
    both = guided(field, here, torch.stack((ahead, to_first), 1), radius)[0].flatten()
    expected = torch.cat((both, free_distance(field, here, ahead, 3.0)))
    assert_close(observe(make_stages(), pose)[22:31], expected, atol=1e-6, rtol=0)


def test_the_free_distance_can_be_measured_toward_the_control_point(make_stages, pose):
    along_velocity = observe(make_stages(), pose)
    option = "observation.kgp_esdf.free_distance=control_point"
    toward_point = observe(make_stages(option), pose)
    assert_close(along_velocity[30], torch.tensor(3.0))
    assert_close(toward_point[30], torch.tensor(0.2))  # cell 54, 0.2 m from the box
    assert torch.equal(along_velocity[:30], toward_point[:30])


def test_without_motion_the_velocity_guide_points_at_the_control_point(make_stages, pose):
    still = observe(make_stages(), {**pose, keys.VELOCITY_W: torch.zeros(1, 3)})
    toward = torch.tensor([[2.0, 1.0, 0.2]])
    assert torch.equal(
        still[22:31], observe(make_stages(), {**pose, keys.VELOCITY_W: toward})[22:31]
    )


def test_at_the_control_point_every_number_is_finite(make_stages, pose):
    there = torch.tensor([[FIRST, FIRST]])
    arrived = {**pose, keys.POSITION_W: torch.tensor([FIRST]), keys.CONTROL_POINTS_W: there}
    assert observe(make_stages(), arrived).isfinite().all()
    assert observe(make_stages(), {**arrived, keys.VELOCITY_W: torch.zeros(1, 3)}).isfinite().all()


def test_columns_are_named_in_the_order_of_the_numbers(make_stages):
    names = make_stages().observation_columns
    assert len(names) == 45
    at = {
        0: "sub_cell.x",
        2: "velocity.x",
        5: "attitude.roll",
        8: "body_rate.p",
        11: "esdf_patch.row_0_column_0",
    }
    at |= {15: "esdf_patch.row_1_column_1", 19: "esdf_patch.row_2_column_2"}
    at |= {20: "heights.to_ceiling"}
    at |= {
        22: "kgp_esdf.velocity_left_x",
        25: "kgp_esdf.velocity_right_y",
        26: "kgp_esdf.control_point_left_x",
    }
    at |= {
        30: "kgp_esdf.free_distance",
        31: "control_points.first_x",
        39: "control_points.between_z",
    }
    at |= {40: "body_x.x", 43: "planar_distances.first", 44: "planar_distances.second"}
    assert {index: names[index] for index in at} == at


def test_the_offset_within_the_cell_is_never_negative_nor_more_than_a_cell(make_stages):
    sub_cell = next(term for term in make_stages().terms.observations if term.name == "sub_cell")
    points = torch.tensor(
        [[0.0, 0.0], [-0.03, -0.07], [-1e-9, 5.0], [5.0, -5.0], [0.1, 0.3], [11.9999, 0.29999]]
    )
    position = torch.cat((points, torch.ones(6, 1)), -1)
    index = torch.zeros(6, 1, dtype=torch.int64)
    offset = sub_cell.compute(position, index, torch.zeros(1, 2))
    assert (offset >= 0).all()
    assert (offset <= torch.tensor(0.1)).all()
