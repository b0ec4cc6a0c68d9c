"""Hamilton quaternions, wxyz, body to world; ZYX Euler angles (roll, pitch, yaw)."""

import torch
from jaxtyping import Float
from torch import Tensor

SMALL = 1e-8
"""Squared angle [rad^2] below which sines are series."""


def normalize(attitude: Float[Tensor, "n 4"]) -> Float[Tensor, "n 4"]:
    """The unit quaternion of the same rotation."""
    return attitude / attitude.square().sum(-1, keepdim=True).sqrt()


def body_x_w(attitude: Float[Tensor, "n 4"]) -> Float[Tensor, "n 3"]:
    """The body's forward axis in the world frame."""
    w, x, y, z = attitude.unbind(-1)
    return torch.stack((1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)), -1)


def heading(attitude: Float[Tensor, "n 4"]) -> Float[Tensor, "n 2"]:
    """Cosine and sine of the yaw: the body's forward axis, seen from above; nose up, that of yaw 0.

    The yaw of the ZYX angles is the direction of this axis.
    """
    x, y, _ = body_x_w(attitude).unbind(-1)
    length = torch.hypot(x, y)
    defined = length > 1e-6
    length = torch.where(defined, length, 1.0)
    return torch.stack((torch.where(defined, x / length, 1.0), y / length), -1)


def body_z_w(attitude: Float[Tensor, "n 4"]) -> Float[Tensor, "n 3"]:
    """The body's upward axis, the direction of thrust, in the world frame."""
    w, x, y, z = attitude.unbind(-1)
    return torch.stack((2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)), -1)


def rotate(attitude: Float[Tensor, "n 4"], vector_b: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    """A body-frame vector in the world frame: v + 2 w (u x v) + 2 u x (u x v), with q = (w, u)."""
    w, u = attitude[..., :1], attitude[..., 1:]
    t = 2 * torch.linalg.cross(u, vector_b)
    return vector_b + w * t + torch.linalg.cross(u, t)


def rotate_inverse(
    attitude: Float[Tensor, "n 4"], vector_w: Float[Tensor, "n 3"]
) -> Float[Tensor, "n 3"]:
    """A world-frame vector in the body frame."""
    w, u = attitude[..., :1], attitude[..., 1:]
    t = 2 * torch.linalg.cross(u, vector_w)
    return vector_w - w * t + torch.linalg.cross(u, t)


def euler_from_quaternion(attitude: Float[Tensor, "n 4"]) -> Float[Tensor, "n 3"]:
    """Roll, pitch, yaw [rad] of R = Rz(yaw) Ry(pitch) Rx(roll); pitch is clamped at +-pi/2."""
    w, x, y, z = attitude.unbind(-1)
    roll = torch.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = torch.asin((2 * (w * y - z * x)).clamp(-1.0, 1.0))
    yaw = torch.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return torch.stack((roll, pitch, yaw), -1)


def quaternion_from_euler(euler: Float[Tensor, "n 3"]) -> Float[Tensor, "n 4"]:
    """The quaternion of R = Rz(yaw) Ry(pitch) Rx(roll), angles in rad."""
    half = euler / 2
    cr, cp, cy = half.cos().unbind(-1)
    sr, sp, sy = half.sin().unbind(-1)
    return torch.stack(
        (
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ),
        -1,
    )


def product(first: Float[Tensor, "n 4"], second: Float[Tensor, "n 4"]) -> Float[Tensor, "n 4"]:
    """The quaternion of the second rotation followed by the first: q1 q2."""
    w, u = first[..., :1], first[..., 1:]
    other_w, v = second[..., :1], second[..., 1:]
    scalar = w * other_w - (u * v).sum(-1, keepdim=True)
    return torch.cat((scalar, w * v + other_w * u + torch.linalg.cross(u, v)), -1)


def inverse(attitude: Float[Tensor, "n 4"]) -> Float[Tensor, "n 4"]:
    """The quaternion of the opposite rotation."""
    return torch.cat((attitude[..., :1], -attitude[..., 1:]), -1)


def matrix_from_quaternion(attitude: Float[Tensor, "n 4"]) -> Float[Tensor, "n 3 3"]:
    """The rotation matrix: body to world."""
    w, x, y, z = attitude.unbind(-1)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack([torch.stack(row, -1) for row in rows], -2)


def quaternion_from_vector(vector: Float[Tensor, "n 3"]) -> Float[Tensor, "n 4"]:
    """The rotation about the vector's direction by its length [rad]: (cos(a/2), u sin(a/2))."""
    square = vector.square().sum(-1, keepdim=True)
    small = square < SMALL
    angle = torch.where(small, 1.0, square).sqrt()
    share = torch.where(small, 0.5 - square / 48, (angle / 2).sin() / angle)
    scalar = torch.where(small, 1 - square / 8, (angle / 2).cos())
    return torch.cat((scalar, share * vector), -1)


def vector_from_quaternion(attitude: Float[Tensor, "n 4"]) -> Float[Tensor, "n 3"]:
    """The rotation vector [rad] of at most half a turn."""
    attitude = torch.where(attitude[..., :1] < 0, -attitude, attitude)
    w, u = attitude[..., :1], attitude[..., 1:]
    square = u.square().sum(-1, keepdim=True)
    small = square < SMALL
    length = torch.where(small, 1.0, square).sqrt()
    return torch.where(small, 2 / w.clamp(min=0.5), 2 * torch.atan2(length, w) / length) * u


def derivative(
    attitude: Float[Tensor, "n 4"], body_rate_b: Float[Tensor, "n 3"]
) -> Float[Tensor, "n 4"]:
    """The time derivative q * (0, omega) / 2 [1/s]."""
    w, x, y, z = attitude.unbind(-1)
    p, q, r = body_rate_b.unbind(-1)
    return 0.5 * torch.stack(
        (
            -x * p - y * q - z * r,
            w * p + y * r - z * q,
            w * q - x * r + z * p,
            w * r + x * q - y * p,
        ),
        -1,
    )


def turned(attitude: Float[Tensor, "n 4"], angle_b: Float[Tensor, "n 3"]) -> Float[Tensor, "n 4"]:
    """The attitude after a small turn: q exp(angle / 2), the angle [rad] times its body axis.

    A series that errs by 1e-8 at 0.1 rad and has a derivative at zero; of unit length.
    """
    square = angle_b.square().sum(-1, keepdim=True) / 4
    cosine = 1 - square / 2 * (1 - square / 12)
    x, y, z = (angle_b * (0.5 - square / 12)).unbind(-1)
    w = cosine[..., 0]
    a, b, c, d = attitude.unbind(-1)
    product = (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )
    return normalize(torch.stack(product, -1))
