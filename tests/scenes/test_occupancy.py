"""Grids of occupied cells: the boxes they become are the cells, no more and no less."""

import numpy as np
import pytest
import torch

from resc.errors import ConfigError
from resc.math.geometry import box_distance
from resc.scenes.named import NamedScene
from resc.scenes.occupancy import merged, occupancy_boxes

ROOM = {
    "start_m": [0.25, 0.25, 1.0],
    "goal_m": [1.75, 0.25, 1.0],
    "origin_m": [0.0, 0.0],
    "size_m": [2.0, 1.0],
    "cell_m": 0.5,
    "occupancy": ["#..#", "...."],
}


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 1.0])
def test_rectangles_cover_every_occupied_cell_once_and_no_other(share):
    cells = np.random.default_rng(0).random((17, 23)) < share
    count = np.zeros(cells.shape, int)
    for row, column, deep, wide in merged(cells):
        count[row : row + deep, column : column + wide] += 1
    np.testing.assert_array_equal(count, cells)


def test_a_wall_is_one_rectangle_and_a_ring_four():
    wall = np.zeros((5, 8), bool)
    wall[1:4, 2:7] = True
    ring = np.ones((5, 8), bool)
    ring[1:4, 1:7] = False
    assert merged(wall) == [(1, 2, 3, 5)]
    assert len(merged(ring)) == 4


def test_distances_to_the_boxes_are_those_to_the_cells():
    generator = np.random.default_rng(1)
    cells = generator.random((12, 9)) < 0.3
    rows = ["".join("#" if cell else "." for cell in row) for row in cells]
    boxes = torch.tensor(occupancy_boxes(rows, 0.25, (-1.0, 2.0)), dtype=torch.float64)
    points = torch.tensor(generator.uniform((-2, 1), (2.5, 6), (500, 2)))
    each = [
        (-1.0 + column * 0.25, 2.0 + (len(rows) - 1 - row) * 0.25, 0.25, 0.25)
        for row, column in np.argwhere(cells)
    ]
    single = torch.tensor(each, dtype=torch.float64)
    expected = box_distance(points, single.expand(500, -1, -1)).amin(1)
    found = box_distance(points, boxes.expand(500, -1, -1)).amin(1)
    outside = expected > 0
    torch.testing.assert_close(found[outside], expected[outside])
    assert (found[~outside] <= 0).all()
    assert len(boxes) < len(single)


def test_the_first_row_has_the_greatest_y():
    assert occupancy_boxes(["#.", ".."], 2.0, (1.0, 1.0)) == [(1.0, 3.0, 2.0, 2.0)]


def test_a_file_is_the_same_as_its_rows(tmp_path):
    np.save(tmp_path / "maze.npy", np.array([[True, False], [True, True]]))
    rows = occupancy_boxes(["#.", "##"], 0.5, (0.0, 0.0))
    assert occupancy_boxes(str(tmp_path / "maze.npy"), 0.5, (0.0, 0.0)) == rows


def test_a_grid_stands_beside_boxes_and_pillars():
    scene = NamedScene(**ROOM, boxes=[[1.0, 0.9, 0.1, 0.1]], pillars=[[1.2, 0.7, 0.1]])
    layout = scene.sample(2, torch.Generator())
    assert layout.boxes_w.shape == (2, 3, 4)
    assert layout.boxes_w[0, 1].tolist() == [0.0, 0.5, 0.5, 0.5]


@pytest.mark.parametrize(
    ("wrong", "answer"),
    [
        ({"occupancy": []}, "occupancy is empty"),
        ({"occupancy": [""]}, "occupancy is empty"),
        ({"occupancy": ["#..#", "..."]}, r"occupancy\[1\] has 3 cells and occupancy\[0\] 4"),
        ({"occupancy": ["#.x#", "...."]}, r"occupancy\[0\] holds 'x'; expected only '#'"),
        ({"occupancy": "maze.npy"}, "occupancy is 'maze.npy', which is not an .npy file"),
        ({"occupancy": ["....", "#..."]}, r"start_m is \[0.25, 0.25\], inside an occupied cell"),
        ({"occupancy": ["....", "...#"]}, r"goal_m is \[1.75, 0.25\], inside an occupied cell"),
        ({"cell_m": 0.6}, r"from \(0, 0.6\) to \(0.6, 1.2\) m, beyond the map"),
        ({"corner_m": [-0.1, 0.0]}, r"from \(-0.1, 0.5\) to \(0.4, 1\) m, beyond the map"),
        ({"cell_m": None}, "cell_m is missing"),
        ({"occupancy": None}, "cell_m belongs to a grid, but there is none"),
        ({"corner_m": [1.0]}, r"corner_m is \[1.0\]; expected 2 numbers"),
    ],
)
def test_a_wrong_grid_is_one_sentence(wrong, answer):
    with pytest.raises(ConfigError, match=answer):
        NamedScene(**ROOM | wrong)


@pytest.mark.parametrize(
    "array", [np.zeros((2, 2)), np.zeros(3, bool), np.zeros((0, 2), bool)], ids=str
)
def test_a_file_of_something_else_is_refused(array, tmp_path):
    np.save(tmp_path / "maze.npy", array)
    with pytest.raises(ConfigError, match="expected Booleans"):
        occupancy_boxes(str(tmp_path / "maze.npy"), 0.5, (0.0, 0.0))
