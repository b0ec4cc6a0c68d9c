import torch

from resc.scenes.layout import PARKED_M, Layout, concatenate, rasterize

ORIGIN = torch.tensor([[0.0, 0.0]])


def cells(*boxes, origin=ORIGIN, shape=(6, 8)):
    """Occupied cells as (row, column), the map being 0.8 m by 0.6 m."""
    grid = rasterize(torch.tensor([boxes]), origin, shape, 0.1)
    assert grid.shape == (1, *shape)
    return {tuple(cell) for cell in grid[0].nonzero().tolist()}


def block(rows, columns):
    return {(row, column) for row in rows for column in columns}


def test_a_box_fills_the_cells_it_overlaps():
    assert cells([0.25, 0.15, 0.2, 0.1]) == block(range(1, 3), range(2, 5))


def test_a_box_that_ends_on_cell_borders_fills_no_neighbour():
    assert cells([0.2, 0.1, 0.3, 0.2]) == block(range(1, 3), range(2, 5))


def test_a_box_thinner_than_a_cell_fills_one():
    assert cells([0.32, 0.0, 0.01, 0.6]) == block(range(6), [3])
    assert cells([0.3, 0.2, 0.0, 0.0]) == {(2, 3)}


def test_a_box_that_leaves_the_map_is_cut():
    assert cells([0.7, -1.0, 5.0, 1.25]) == block(range(3), [7])
    assert cells([-3.0, -3.0, 1.0, 1.0]) == set()


def test_parked_boxes_fill_nothing():
    assert cells([PARKED_M, PARKED_M, 0.0, 0.0], [0.0, 0.0, 0.1, 0.1]) == {(0, 0)}


def test_the_origin_shifts_the_map_not_the_box():
    origin = torch.tensor([[-0.4, 0.3]])
    assert cells([-0.35, 0.55, 0.2, 0.1], origin=origin) == block(range(2, 4), range(3))


def test_overlapping_boxes_fill_their_union_and_only_in_their_own_scene():
    boxes = torch.tensor(
        [[[0.0, 0.0, 0.2, 0.1], [0.1, 0.0, 0.2, 0.1]], [[0.5, 0.5, 0.1, 0.1], [0.5, 0.5, 0.1, 0.1]]]
    )
    grid = rasterize(boxes, ORIGIN.expand(2, 2), (6, 8), 0.1)
    assert {tuple(c) for c in grid[0].nonzero().tolist()} == block([0], range(3))
    assert {tuple(c) for c in grid[1].nonzero().tolist()} == {(5, 5)}


def layout(count, boxes, points):
    return Layout(
        boxes_w=torch.rand(count, boxes, 4),
        origin_w=torch.zeros(count, 2),
        size=torch.full((count, 2), 12.0),
        start_w=torch.rand(count, 3),
        route_w=torch.rand(count, points, 3),
        route_length=torch.full((count, 1), points, dtype=torch.int64),
    )


def test_concatenated_layouts_are_padded_with_parked_boxes_and_the_last_control_point():
    first, second = layout(2, 3, 1), layout(1, 5, 4)
    both = concatenate([first, second])
    assert len(both) == 3
    assert torch.equal(both.boxes_w[:2, :3], first.boxes_w)
    assert torch.equal(both.boxes_w[2], second.boxes_w[0])
    assert (both.boxes_w[:2, 3:, :2] == PARKED_M).all()
    assert torch.equal(both.route_w[:2], first.route_w.expand(-1, 4, -1))
    assert both.route_length[:, 0].tolist() == [1, 1, 4]
