"""Movers: where they are at any time, how far away, and which cells they are in."""

import torch
from torch.testing import assert_close

from resc.maps.movers import covered, distances, motion, nearest_surface, outlines

BOUNCING = [2.0, 5.0, 1.5, -1.0, 0.3, 0.2, 1.0, 3.0, 4.0, 7.0]
"""A box of 0.6 x 0.4 m, its centre within (1, 3) and (4, 7)."""
CONSTANT = [2.0, 5.0, 1.5, -1.0, 0.5, 0.0, 2.0, 5.0, 2.0, 5.0]
"""A round one of 0.5 m that goes on for ever."""


def at(mover, time_s):
    centre, velocity = motion(torch.tensor([[mover]]), torch.tensor([[time_s]]))
    return centre[0, 0].tolist(), velocity[0, 0].tolist()


def test_a_bouncing_mover_turns_where_its_range_ends():
    assert at(BOUNCING, 0.0) == ([2.0, 5.0], [1.5, -1.0])
    assert at(BOUNCING, 1.0) == ([3.5, 4.0], [1.5, -1.0])
    assert at(BOUNCING, 2.0) == ([3.0, 3.0], [-1.5, -1.0])  # x turned at 4 m, 1.33 s
    assert at(BOUNCING, 4.0) == ([2.0, 5.0], [1.5, 1.0])  # back at the ends: 1 m at 3.33 s


def test_a_constant_mover_goes_on():
    assert at(CONSTANT, 0.0) == ([2.0, 5.0], [1.5, -1.0])
    assert at(CONSTANT, 8.0) == ([14.0, -3.0], [1.5, -1.0])


def test_axes_with_ends_and_without_may_be_mixed():
    vertical = [2.0, 5.0, 0.0, 1.0, 0.3, 0.3, 2.0, 4.0, 2.0, 6.0]
    assert at(vertical, 3.0) == ([2.0, 4.0], [0.0, 1.0])
    assert at(vertical, 2.0) == ([2.0, 5.0], [0.0, -1.0])


def test_a_crossing_mover_stays_on_its_line():
    way = torch.tensor([0.6, 0.8])
    ends = torch.stack((torch.tensor([3.0, 1.0]) - 2 * way, torch.tensor([3.0, 1.0]) + 2 * way))
    mover = torch.cat((torch.tensor([3.0, 1.0]), way, torch.tensor([0.3, 0.0]), *ends))
    time_s = torch.linspace(0, 40, 401).unsqueeze(-1)
    centre, velocity = motion(mover.expand(401, 1, 10), time_s)
    offset = centre[:, 0] - torch.tensor([3.0, 1.0])
    assert_close(offset @ torch.tensor([0.8, -0.6]), torch.zeros(401), atol=1e-5, rtol=0)
    assert (offset @ way).abs().max() <= 2.0 + 1e-5
    assert_close(velocity.norm(dim=-1), torch.ones(401, 1))


def test_distances_are_those_of_boxes_and_discs():
    movers = torch.tensor([[BOUNCING, CONSTANT]]).expand(3, -1, -1)
    centre, _ = motion(movers, torch.tensor([[0.0], [0.0], [1.0]]))
    points = torch.tensor([[2.0, 6.2], [2.3, 5.0], [6.5, 4.0]])
    found = distances(points, movers, centre)
    assert_close(found, torch.tensor([[1.0, 0.7], [0.0, -0.2], [2.7, 2.5]]))
    nearest = nearest_surface(points, movers, torch.tensor([[0.0], [0.0], [1.0]]))
    assert_close(nearest, torch.tensor([[0.7], [-0.2], [2.5]]))


def test_cells_that_a_mover_overlaps_are_covered():
    movers = torch.tensor([[BOUNCING, [0.55, 0.55, 0, 0, 0.12, 0.0, 0, 0, 0, 0]]])
    seen = outlines(movers, torch.zeros(1, 1))
    cells = covered(seen, torch.tensor([[0.0, 0.0]]), (60, 40), 0.1)[0]
    box = torch.zeros(60, 40, dtype=torch.bool)
    box[48:52, 17:23] = True
    disc = torch.zeros(60, 40, dtype=torch.bool)
    disc[4:7, 4:7] = True  # the corners of this block are 0.07 m from the centre
    assert torch.equal(cells, box | disc)
