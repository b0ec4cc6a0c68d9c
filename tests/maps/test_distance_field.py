import numpy as np
import torch
from torch.testing import assert_close

from resc.maps.distance_field import DistanceField, select
from resc.maps.distance_transform import distance_transform
from resc.term import Context
from resc.terms.sensors.clearance import Clearance
from resc.terms.terminations.collision import Collision


def numbered(size=(2.0, 1.5)):
    """Entry 1 of a pool; cell (row, column) of its map holds 10 row + column.

    Cells of 0.5 m, lower-left corner (-1, 2).
    """
    grid = 10 * torch.arange(3.0).unsqueeze(1) + torch.arange(4.0)
    pool = torch.stack((torch.full((3, 4), -1.0), grid))
    origin, extent = torch.tensor([[-1.0, 2.0]]), torch.tensor([size])
    return DistanceField(pool, torch.tensor([1]), origin, extent, 0.5)


def at(field, x, y):
    return float(field.at(torch.tensor([x]), torch.tensor([y])))


def test_a_point_reads_the_cell_it_lies_in():
    field = numbered()
    assert at(field, -0.99, 2.01) == 0
    assert at(field, -0.51, 2.49) == 0
    assert at(field, -0.5, 2.0) == 1  # a cell owns its lower and left border
    assert at(field, -1.0, 2.5) == 10
    assert at(field, 0.2, 3.3) == 22


def test_a_point_outside_reads_the_nearest_border_cell():
    field = numbered()
    assert at(field, -9.0, 2.1) == 0
    assert at(field, 1.0, 3.5) == 23  # the upper right corner itself is outside already
    assert at(field, 99.0, 99.0) == 23
    assert at(field, 0.3, -5.0) == 2
    assert at(field, -1.0001, 9.0) == 20


def test_padding_beyond_the_map_is_never_read():
    field = numbered(size=(1.5, 1.0))
    assert at(field, 0.9, 3.4) == 12
    assert at(field, 99.0, 2.0) == 2


def test_inside_includes_the_lower_and_excludes_the_upper_border():
    x = torch.tensor([-1.0, 0.999, 1.0, 0.0, 0.0, -1.001])
    y = torch.tensor([2.0, 3.499, 3.0, 3.5, 1.999, 3.0])
    field = numbered()
    inside = torch.stack([field.inside(x[i : i + 1], y[i : i + 1])[0] for i in range(6)])
    assert inside.tolist() == [True, True, False, False, False, False]


def test_environments_read_their_own_maps():
    pool = torch.stack((torch.full((2, 2), 1.0), torch.full((2, 2), 2.0)))
    origins = torch.tensor([[0.0, 0.0], [10.0, 0.0]])
    sizes = torch.tensor([[1.0, 1.0], [1.0, 1.0]])
    field = select(pool, torch.tensor([[1], [0], [1]]), origins, sizes, 0.5)
    x, y = torch.tensor([10.2, 0.2, 0.2]), torch.full((3,), 0.2)
    assert field.at(x, y).tolist() == [2.0, 1.0, 2.0]
    assert field.inside(x, y).tolist() == [True, True, False]


def test_leading_axes_are_looked_up_like_single_points():
    field = numbered()
    x, y = torch.tensor([[[-0.9]], [[0.2]]]), torch.tensor([[[2.1]], [[3.3]]])
    assert_close(field.at(x, y), torch.tensor([[[0.0]], [[22.0]]]))


def test_collision_is_flagged_exactly_where_the_cells_distance_is_below_the_radius():
    count, random = 100_000, np.random.default_rng(0)
    occupied = torch.from_numpy(random.random((5, 120, 100)) < 0.01)
    esdf = distance_transform(occupied, 0.1, 3.0)
    origin, size = (
        torch.tensor([[-5.0, 2.0]]).expand(5, 2),
        torch.tensor([[10.0, 12.0]]).expand(5, 2),
    )
    position = torch.from_numpy(random.random((count, 3)).astype(np.float32)) * torch.tensor(
        [10.0, 12.0, 2.0]
    )
    position += torch.tensor([-5.0, 2.0, 0.0])
    index = torch.from_numpy(random.integers(0, 5, (count, 1)))

    still = torch.zeros(count, 1), torch.empty(5, 0, 10)  # nothing moves
    sensor = Clearance()
    sensor.bind(Context(dt_s=0.02, resolution_m=0.1, vehicle=None))
    clearance = sensor.compute(position, index, esdf, origin, size, *still)
    flags = Collision(radius_m=0.3).compute(clearance)

    offset = (position[:, :2].numpy() - np.float32([-5.0, 2.0])) * np.float32(10)
    column, row = np.floor(offset).astype(int).clip(0, [99, 119]).T
    stored = esdf.numpy()[index[:, 0].numpy(), row, column]
    assert (flags[:, 0].numpy() == (stored < np.float32(0.3))).all()
    assert 0.1 < flags.float().mean() < 0.9
