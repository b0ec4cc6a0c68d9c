"""The map of the planners that are compared with; fields as the original planners printed them."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from resc.baselines.voxel_kernels import is_occupied
from resc.baselines.voxel_map import Sensing, VoxelMap, columns

DATA = Path(__file__).parents[1] / "data" / "planner_scenes"
START = np.array([0.0, 0.0, 1.0])
EAST = np.array([1.0, 0.0])
ALL_ROUND, AHEAD = Sensing(), Sensing(front=True)


def a_map(inflation_m=0.3):
    return VoxelMap(np.array([-10.0, -10.0]), np.array([10.0, 10.0]), inflation_m=inflation_m)


def seen(*obstacles, position=START, sensing=ALL_ROUND, inflation_m=0.3):
    voxels = a_map(inflation_m)
    voxels.see(np.array(obstacles), position, EAST, sensing)
    return voxels


def at(voxels, x, y, outside=False):
    return bool(is_occupied(voxels.cells, voxels.corner, voxels.per_m, x, y, outside))


def test_a_box_covers_the_cells_with_their_centres_in_it():
    centres = columns([[-0.5, 1.0, 0.2, 0.1]], [])
    np.testing.assert_allclose(centres, [[-0.45, 1.05, 0.0], [-0.35, 1.05, 0.0]])


def test_a_cylinder_covers_the_cells_with_their_centres_in_it():
    centres = columns([], [[0.05, 0.05, 0.11]])
    near = [[-0.05, 0.05], [0.05, -0.05], [0.05, 0.05], [0.05, 0.15], [0.15, 0.05]]
    np.testing.assert_allclose(centres[:, :2], near, atol=1e-12)


def test_no_obstacles_are_no_cells():
    assert columns([], []).shape == (0, 3)


@pytest.mark.parametrize(("inflation_m", "edge"), [(0.3, 7), (0.099, 3), (0.0, 1)])
def test_an_obstacle_is_inflated_by_a_square_of_whole_cells(inflation_m, edge):
    cells = seen([2.05, 1.05, 0.0], inflation_m=inflation_m).cells
    assert cells.sum() == edge**2
    reach = edge // 2
    assert cells[120 - reach : 121 + reach, 110 - reach : 111 + reach].all()


def test_what_is_beyond_the_map_is_what_the_planner_takes_it_for():
    voxels = a_map()
    for x, y in ((-10.01, 0.0), (10.01, 0.0), (0.0, -10.01), (0.0, 10.01)):
        assert at(voxels, x, y, outside=True)
        assert not at(voxels, x, y, outside=False)
    assert not at(voxels, 9.99, 9.99, outside=True)


def test_a_sensor_sees_as_far_as_its_horizon_and_through_obstacles():
    voxels = seen([2.05, 0.05, 0.0], [4.95, 0.05, 0.0], [5.05, 0.05, 0.0])
    assert at(voxels, 2.05, 0.05)
    assert at(voxels, 5.25, 0.05)
    assert not at(voxels, 5.35, 0.05)


def test_a_sensor_ahead_sees_nothing_behind():
    obstacles = [2.05, 0.05, 0.0], [-2.05, 0.05, 0.0]
    assert at(seen(*obstacles), -2.05, 0.05)
    voxels = seen(*obstacles, sensing=AHEAD)
    assert at(voxels, 2.05, 0.05)
    assert not at(voxels, -2.05, 0.05)


def test_obstacles_are_remembered_outside_the_updated_square_only():
    obstacles = np.array([[2.05, 0.05, 0.0]])
    voxels = seen(*obstacles)
    voxels.see(obstacles, np.array([8.0, 0.0, 1.0]), EAST, AHEAD)
    assert at(voxels, 2.05, 0.05)
    voxels.see(obstacles, np.array([7.0, 0.0, 1.0]), EAST, AHEAD)
    assert not at(voxels, 2.05, 0.05)
    voxels.see(obstacles, np.array([7.0, 0.0, 1.0]), EAST, ALL_ROUND)
    assert at(voxels, 2.05, 0.05)


def test_obstacles_and_vehicles_off_the_map_do_no_harm():
    voxels = seen([12.05, 0.05, 0.0], [10.05, 0.05, 0.0], position=np.array([11.0, 0.0, 1.0]))
    assert voxels.cells.sum() == 3 * 7  # what the inflation of the nearer one leaves on the map


def test_distances_to_inflated_cells_are_those_of_the_original_planner():
    """Interpolated on cell centres, where all of a point's surroundings was measured."""
    scenes = json.loads((DATA / "scenes.json").read_text())["scenes"]
    scene = next(scene for scene in scenes if scene["name"] == "B1_sparse")
    golden = json.loads((DATA / "golden.json").read_text())["fp_B1_sparse"]["esdf"][:7]
    voxels = VoxelMap(np.array([-20.0, -10.0]), np.array([20.0, 10.0]), inflation_m=0.3)
    voxels.see(columns(scene["boxes"], scene["cylinders"]), START, EAST, ALL_ROUND)
    centres = (np.argwhere(voxels.cells) + voxels.corner + 0.5) / voxels.per_m
    for x, y, _, distance, *_ in golden:
        assert interpolated(centres, x, y) == pytest.approx(distance, abs=1e-5)


def interpolated(centres, x, y):
    """Distance from (x, y) to the nearest centre, bilinear between the four cells round it."""
    i, j = math.floor(x / 0.1 - 0.5 + 1e-9), math.floor(y / 0.1 - 0.5 + 1e-9)
    a, b = x / 0.1 - 0.5 - i, y / 0.1 - 0.5 - j
    here = (np.array([[i, j], [i, j + 1], [i + 1, j], [i + 1, j + 1]]) + 0.5) * 0.1
    near = np.linalg.norm(here[:, None] - centres, axis=-1).min(axis=1)
    return np.array([(1 - a) * (1 - b), (1 - a) * b, a * (1 - b), a * b]) @ near
