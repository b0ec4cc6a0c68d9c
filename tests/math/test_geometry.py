import torch
from torch.testing import assert_close

from resc.math.geometry import box_distance, distance, norm

BOX = torch.tensor([[[1.0, 1.0, 2.0, 4.0]]])  # x 1..3, y 1..5


def to_box(x, y):
    return float(box_distance(torch.tensor([[x, y]]), BOX))


def test_box_distance_beside_at_a_corner_and_inside():
    assert_close(to_box(0.5, 2.0), 0.5)
    assert_close(to_box(2.0, 6.5), 1.5)
    assert_close(to_box(6.0, 9.0), 5.0)  # 3-4-5 from the corner (3, 5)
    assert_close(to_box(1.2, 3.0), -0.2)
    assert_close(to_box(2.0, 3.0), -1.0)
    assert_close(to_box(3.0, 2.0), 0.0)


def test_box_distance_takes_each_point_to_its_own_boxes():
    points = torch.tensor([[0.0, 0.0], [10.0, 0.0]])
    boxes = torch.tensor(
        [
            [[1.0, 0.0, 1.0, 1.0], [3.0, 0.0, 1.0, 1.0]],
            [[8.0, -1.0, 1.0, 2.0], [2.0, 0.0, 1.0, 1.0]],
        ]
    )
    assert_close(box_distance(points, boxes), torch.tensor([[1.0, 3.0], [1.0, 7.0]]))


def test_norm_has_a_finite_gradient_at_zero():
    vector = torch.zeros(2, 3, requires_grad=True)
    norm(vector).sum().backward()
    assert vector.grad.isfinite().all()


def test_distance_keeps_the_axis():
    a, b = torch.tensor([[0.0, 3.0, 1.0]]), torch.tensor([[4.0, 0.0, 1.0]])
    assert_close(distance(a, b), torch.tensor([[5.0]]))
