import math

import pytest
import torch
from torch.testing import assert_close

from resc.math import rotation

QUARTER = math.pi / 2


def random_euler(count=500):
    generator = torch.Generator().manual_seed(0)
    unit = 2 * torch.rand(count, 3, generator=generator, dtype=torch.float64) - 1
    return unit * torch.tensor([math.pi, QUARTER - 0.01, math.pi], dtype=torch.float64)


def multiply(a, b):
    """The Hamilton product a * b."""
    aw, ax, ay, az = a.unbind(-1)
    bw, bx, by, bz = b.unbind(-1)
    return torch.stack(
        (
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ),
        -1,
    )


def matrix(euler):
    """R = Rz(yaw) Ry(pitch) Rx(roll), written out."""
    (sr, sp, sy), (cr, cp, cy) = euler.sin().unbind(-1), euler.cos().unbind(-1)
    zero, one = torch.zeros_like(sr), torch.ones_like(sr)

    def of(*entries):
        return torch.stack(entries, -1).reshape(-1, 3, 3)

    about_x = of(one, zero, zero, zero, cr, -sr, zero, sr, cr)
    about_y = of(cp, zero, sp, zero, one, zero, -sp, zero, cp)
    about_z = of(cy, -sy, zero, sy, cy, zero, zero, zero, one)
    return about_z @ about_y @ about_x


def test_euler_angles_survive_the_way_through_a_quaternion():
    euler = random_euler()
    back = rotation.euler_from_quaternion(rotation.quaternion_from_euler(euler))
    assert_close(back, euler, atol=1e-12, rtol=0)


def test_quaternions_from_euler_angles_have_unit_norm():
    attitude = rotation.quaternion_from_euler(random_euler())
    assert_close(attitude.norm(dim=-1), torch.ones(500, dtype=torch.float64))


def test_rotate_agrees_with_the_zyx_matrix():
    euler = random_euler()
    vector = torch.randn(500, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    expected = (matrix(euler) @ vector.unsqueeze(-1)).squeeze(-1)
    attitude = rotation.quaternion_from_euler(euler)
    assert_close(rotation.rotate(attitude, vector), expected, atol=1e-12, rtol=0)
    assert_close(rotation.rotate(-attitude, vector), expected, atol=1e-12, rtol=0)


def test_rotate_inverse_undoes_rotate():
    attitude = rotation.quaternion_from_euler(random_euler())
    vector = torch.randn(500, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    back = rotation.rotate_inverse(attitude, rotation.rotate(attitude, vector))
    assert_close(back, vector, atol=1e-12, rtol=0)


@pytest.mark.parametrize(
    ("axis", "unit"), [(rotation.body_x_w, (1.0, 0.0, 0.0)), (rotation.body_z_w, (0.0, 0.0, 1.0))]
)
def test_body_axes_are_rotated_unit_vectors(axis, unit):
    attitude = rotation.quaternion_from_euler(random_euler())
    vector = torch.tensor(unit, dtype=torch.float64).expand(500, 3)
    assert_close(axis(attitude), rotation.rotate(attitude, vector), atol=1e-12, rtol=0)


def test_quarter_turns_point_where_the_conventions_say():
    yaw, pitch, roll = rotation.quaternion_from_euler(
        torch.tensor([[0.0, 0.0, QUARTER], [0.0, QUARTER, 0.0], [QUARTER, 0.0, 0.0]])
    ).split(1)
    assert_close(rotation.body_x_w(yaw), torch.tensor([[0.0, 1.0, 0.0]]))  # yaw turns to the left
    assert_close(
        rotation.body_x_w(pitch), torch.tensor([[0.0, 0.0, -1.0]])
    )  # pitch lowers the nose
    assert_close(
        rotation.body_z_w(roll), torch.tensor([[0.0, -1.0, 0.0]])
    )  # roll leans to the right


def test_a_product_applies_its_right_factor_first():
    a, b = rotation.quaternion_from_euler(random_euler(400)).split(200)
    vector = torch.randn(200, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    expected = rotation.rotate(a, rotation.rotate(b, vector))
    assert_close(rotation.rotate(multiply(a, b), vector), expected, atol=1e-12, rtol=0)


def test_derivative_agrees_with_a_finite_turn_about_a_body_axis():
    attitude = rotation.quaternion_from_euler(random_euler(100))
    rate = torch.randn(100, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))

    def after(seconds):
        angle = rate.norm(dim=-1, keepdim=True) * seconds
        turn = torch.cat(
            ((angle / 2).cos(), rate / rate.norm(dim=-1, keepdim=True) * (angle / 2).sin()), -1
        )
        return multiply(attitude, turn)

    slope = (after(1e-4) - after(-1e-4)) / 2e-4
    assert_close(rotation.derivative(attitude, rate), slope, atol=1e-7, rtol=0)


def test_pitch_is_clamped_where_rounding_exceeds_the_sine():
    attitude = torch.tensor([[0.70710684, 0.0, 0.70710684, 0.0]])  # norm 1 + 5e-8, so 2 w y > 1
    assert 2 * attitude[0, 0] * attitude[0, 2] > 1
    euler = rotation.euler_from_quaternion(attitude)
    assert_close(euler[:, 1], torch.tensor([QUARTER]))


def test_normalize_keeps_the_direction():
    attitude = torch.tensor([[2.0, 0.0, 0.0, 0.0], [3.0, 0.0, -4.0, 0.0]])
    assert_close(
        rotation.normalize(attitude), torch.tensor([[1.0, 0.0, 0.0, 0.0], [0.6, 0.0, -0.8, 0.0]])
    )
