"""The free-space rule against its definition."""

import numpy as np
import pytest

from resc.planning.grid import (
    CORNER_NN,
    CORNER_NP,
    CORNER_PN,
    CORNER_PP,
    corner_mask,
    inflate,
    line_is_free,
    segment_is_free,
)


def grid(*rows: str) -> np.ndarray:
    """Boolean map from rows of '.' and '#', the first row at the top (largest y)."""
    return np.array([[c == "#" for c in row] for row in reversed(rows)])


def misses_every_square(blocked: np.ndarray, a: tuple[int, int], b: tuple[int, int]) -> bool:
    """The rule as defined: a segment and an open square are apart iff some axis parts them."""
    (ax, ay), (bx, by) = a, b
    for y, x in np.argwhere(blocked).tolist():
        beside = max(ax, bx) <= x - 1 or min(ax, bx) >= x + 1
        beside = beside or max(ay, by) <= y - 1 or min(ay, by) >= y + 1
        sides = [
            (bx - ax) * (y + v - ay) - (by - ay) * (x + u - ax) for u in (-1, 1) for v in (-1, 1)
        ]
        if not (beside or min(sides) >= 0 or max(sides) <= 0):
            return False
    return True


def free_cells(blocked: np.ndarray) -> list[tuple[int, int]]:
    return [(x, y) for y, x in np.argwhere(~blocked).tolist()]


@pytest.mark.parametrize("radius", [0.0, 1.0, 1.5, 0.3 / 0.1, 0.4 / 0.1, 5.0])
def test_inflation_blocks_exactly_the_cells_within_the_radius(radius: float):
    occupancy = np.random.default_rng(1).random((23, 31)) < 0.02
    y, x = np.mgrid[:23, :31]
    squared = [(y - v) ** 2 + (x - u) ** 2 for v, u in np.argwhere(occupancy)]
    expected = np.min(squared, axis=0) <= round(radius**2, 6)
    np.testing.assert_array_equal(inflate(occupancy, radius), expected)


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (3, 2)])
def test_a_radius_may_reach_beyond_the_map(shape: tuple[int, int]):
    occupancy = np.zeros(shape, bool)
    occupancy[0, 0] = True
    assert inflate(occupancy, 12.0).all()
    y, x = np.indices(shape)
    np.testing.assert_array_equal(inflate(occupancy, 2.0), x * x + y * y <= 4)


def test_inflating_an_empty_map_blocks_nothing():
    assert not inflate(np.zeros((4, 7), bool), 3.0).any()


def test_isolated_cell_has_four_corners():
    mask = corner_mask(grid("...", ".#.", "..."))
    expected = [[CORNER_PP, 0, CORNER_NP], [0, 0, 0], [CORNER_PN, 0, CORNER_NN]]
    np.testing.assert_array_equal(mask, expected)


def test_cell_between_two_diagonal_obstacles_is_a_corner_twice():
    mask = corner_mask(grid("..#", "...", "#.."))
    assert mask[1, 1] == CORNER_PP | CORNER_NN


def test_diagonal_gap_has_no_corner_inside():
    mask = corner_mask(grid("....", ".#..", "..#.", "...."))
    assert mask[1, 1] == 0
    assert mask[2, 2] == 0


def test_both_jambs_of_a_door_are_corners():
    mask = corner_mask(grid(".....", "##.##", "....."))
    np.testing.assert_array_equal(mask[0], [0, 0, CORNER_PP | CORNER_NP, 0, 0])
    np.testing.assert_array_equal(mask[2], [0, 0, CORNER_PN | CORNER_NN, 0, 0])


def test_inside_of_an_angle_is_no_corner():
    mask = corner_mask(grid("#..", "#..", "###"))
    assert mask[1, 1] == 0


def test_obstacle_at_the_border_has_corners_only_inside_the_map():
    mask = corner_mask(grid("...", "...", "#.."))
    assert mask[1, 1] == CORNER_NN
    assert np.count_nonzero(mask) == 1


def test_lines_follow_the_definition_on_all_pairs_of_small_maps():
    random = np.random.default_rng(2)
    for _ in range(12):
        blocked = random.random((5, 6)) < random.uniform(0.05, 0.4)
        cells = free_cells(blocked)
        for a in cells:
            for b in cells:
                expected = misses_every_square(blocked, a, b)
                assert line_is_free(blocked, a, b) == expected
                real_a, real_b = (float(a[0]), float(a[1])), (float(b[0]), float(b[1]))
                assert segment_is_free(blocked, real_a, real_b) == expected


def test_long_lines_are_symmetric_and_agree_with_the_real_rule():
    random = np.random.default_rng(3)
    blocked = random.random((80, 120)) < 0.004
    ends = random.integers(0, [120, 80, 120, 80], size=(2000, 4)).tolist()
    free = 0
    for ax, ay, bx, by in ends:
        seen = line_is_free(blocked, (ax, ay), (bx, by))
        assert line_is_free(blocked, (bx, by), (ax, ay)) == seen
        assert segment_is_free(blocked, (float(ax), float(ay)), (float(bx), float(by))) == seen
        free += seen
    assert 200 < free < 1800


def test_line_may_run_between_two_walls_one_cell_apart():
    blocked = grid("#####", ".....", "#####")
    assert line_is_free(blocked, (0, 1), (4, 1))
    assert line_is_free(blocked.T.copy(), (1, 0), (1, 4))


def test_line_may_touch_the_corner_of_a_keep_out_square():
    blocked = grid(
        "....", "..#.", "....", "...."
    )  # obstacle at (2, 2), corner of its square (1, 1)
    assert line_is_free(blocked, (0, 2), (2, 0))
    assert not line_is_free(blocked, (0, 3), (3, 0))


def test_line_cannot_pass_between_diagonal_neighbours():
    blocked = grid("#.", ".#")
    assert not line_is_free(blocked, (0, 0), (1, 1))


def test_line_to_a_blocked_cell_or_out_of_the_map_is_not_free():
    blocked = grid("..#", "...")
    assert not line_is_free(blocked, (0, 1), (2, 1))
    assert not line_is_free(blocked, (0, 0), (3, 0))
    assert not line_is_free(blocked, (0, 0), (0, -1))
    assert not segment_is_free(blocked, (0.0, 0.0), (-0.6, 0.0))
    assert segment_is_free(blocked, (0.0, 0.0), (-0.4, -0.4))


def test_real_line_keeps_one_cell_from_a_blocked_centre():
    blocked = grid(".......", "...#...", ".......", ".......")  # obstacle at (3, 2)
    assert segment_is_free(blocked, (0.3, 1.0), (5.7, 1.0))
    assert not segment_is_free(blocked, (0.3, 1.01), (5.7, 1.0))
    assert not segment_is_free(blocked, (2.5, 0.0), (2.5, 3.0))
    assert segment_is_free(blocked, (2.0, 0.0), (2.0, 3.0))
