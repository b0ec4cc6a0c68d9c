"""Uniform cubic B-splines at a time, and where they collide."""

from typing import no_type_check

import numpy as np
from numba import njit

from resc.baselines.ego_planner.path_kernels import is_blocked


@njit(cache=True, nogil=True)
@no_type_check
def fill_state(points, interval, time, state):
    """Sets position, velocity, acceleration, jerk [4, 3] at a time; past the ends, those there."""
    pieces = len(points) - 3
    place = min(max(time / interval, 0.0), float(pieces))
    piece = min(int(place), pieces - 1)
    s = place - piece
    for axis in range(3):
        a, b = points[piece, axis], points[piece + 1, axis]
        c, d = points[piece + 2, axis], points[piece + 3, axis]
        constant, linear = (a + 4.0 * b + c) / 6.0, (c - a) / 2.0
        square, cube = (a - 2.0 * b + c) / 2.0, (d - a + 3.0 * (b - c)) / 6.0
        state[0, axis] = constant + s * (linear + s * (square + s * cube))
        state[1, axis] = (linear + s * (2.0 * square + 3.0 * s * cube)) / interval
        state[2, axis] = (2.0 * square + 6.0 * s * cube) / interval**2
        state[3, axis] = 6.0 * cube / interval**3


@njit(cache=True, nogil=True)
@no_type_check
def first_hit(points, interval, begin, end, step, space):
    """The first time, from a beginning in steps to before an end, at which it collides; or -1."""
    time, state = begin, np.empty((4, 3))
    while time < end:
        fill_state(points, interval, time, state)
        if is_blocked(state[0], space):
            return time
        time += step
    return -1.0
