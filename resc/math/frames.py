"""Flight-controller frames (NED world, FRD body) turned into ours (ENU world, FLU body).

The one place where signs and axes of PX4 are changed; quaternions are wxyz on both sides.
"""

import numpy as np
from jaxtyping import Float

_HALF = np.sqrt(0.5)
_ENU_NED = np.array([0.0, _HALF, _HALF, 0.0])
"""Turns NED into ENU and back: a half turn about the horizontal axis between north and east."""
_FLU_FRD = np.array([0.0, 1.0, 0.0, 0.0])
"""Turns FRD into FLU and back: a half turn about the forward axis."""


def enu_from_ned(vectors: Float[np.ndarray, "t 3"]) -> Float[np.ndarray, "t 3"]:
    """World vectors: (north, east, down) as (east, north, up)."""
    return vectors[:, [1, 0, 2]] * (1.0, 1.0, -1.0)


def flu_from_frd(vectors: Float[np.ndarray, "t 3"]) -> Float[np.ndarray, "t 3"]:
    """Body vectors: (forward, right, down) as (forward, left, up)."""
    return vectors * (1.0, -1.0, -1.0)


def attitude_enu_flu(attitude_ned_frd: Float[np.ndarray, "t 4"]) -> Float[np.ndarray, "t 4"]:
    """Attitude, FLU body to ENU world, from that of FRD body to NED world.

    q = q(NED to ENU) q(FRD to NED) q(FLU to FRD).
    """
    return _product(_product(_ENU_NED[None], attitude_ned_frd), _FLU_FRD[None])


def ned_from_enu(vectors: Float[np.ndarray, "t 3"]) -> Float[np.ndarray, "t 3"]:
    """World vectors: (east, north, up) as (north, east, down)."""
    return enu_from_ned(vectors)


def frd_from_flu(vectors: Float[np.ndarray, "t 3"]) -> Float[np.ndarray, "t 3"]:
    """Body vectors: (forward, left, up) as (forward, right, down)."""
    return flu_from_frd(vectors)


def attitude_ned_frd(attitude_enu_flu: Float[np.ndarray, "t 4"]) -> Float[np.ndarray, "t 4"]:
    """Attitude, FRD body to NED world, from that of FLU body to ENU world.

    q = q(ENU to NED) q(FLU to ENU) q(FRD to FLU): half turns, which are their own inverses.
    """
    return _product(_product(_ENU_NED[None], attitude_enu_flu), _FLU_FRD[None])


def _product(a: Float[np.ndarray, "_ 4"], b: Float[np.ndarray, "_ 4"]) -> Float[np.ndarray, "t 4"]:
    """Hamilton product of quaternions."""
    (aw, ax, ay, az), (bw, bx, by, bz) = a.T, b.T
    return np.stack(
        (
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ),
        -1,
    )
