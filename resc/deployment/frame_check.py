"""Whether odometry is in the frames that it says it is in."""

from collections import deque

import numpy as np
from jaxtyping import Float

from resc.deployment.odometry import Odometry, matrix
from resc.errors import LinkError
from resc.simulation.vehicle import GRAVITY_MPS2

_GRAVITY = np.array([0.0, 0.0, GRAVITY_MPS2])
WINDOW_S = 0.3
"""Of flight that is looked at: a velocity has moved something by then."""
PERSISTS = 10
"""Samples in a row that must disagree: one alone may be a jump of an estimator."""
LEAST_M = 0.12
"""Distance below which positions and velocities are not compared."""
SHARE = 0.4
"""Of the distance, by which they may disagree."""
TILT_RAD = 0.45
"""By which thrust and acceleration may point apart; drag at 3 m/s makes 0.1."""
LEVEL = 0.3
"""Cosine of the tilt beyond which no vehicle waits for a flight."""
_SWAPPED = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
"""NED read as ENU, and the other way round."""
_TO_BODY = np.diag([1.0, -1, -1]) @ _SWAPPED
"""A vector that was turned from NED, turned from FRD instead."""
HELP = "mend the frames of what sends it"


def require_upright(state: Odometry) -> None:
    """Raises LinkError if gravity points out of the top of a vehicle that waits."""
    if state.up_b[2] < LEVEL:
        raise LinkError(
            f"The attitude of the odometry has the vehicle tilted by "
            f"{np.degrees(np.arccos(np.clip(state.up_b[2], -1, 1))):.0f} degrees while it waits: "
            f"it looks like the attitude of a FLU body, not of a FRD one; {HELP}."
        )


def require_near(state: Odometry, start_w: Float[np.ndarray, "3"], limit_m: float) -> None:
    """Raises LinkError if the vehicle is not where the scene starts."""
    apart = float(np.linalg.norm(state.position_w - start_w))
    if apart <= limit_m:
        return
    where, wanted = _shown(state.position_w), _shown(start_w)
    fact = f"The vehicle is at {where} m, {apart:.2g} m from the start of the scene at {wanted} m"
    if np.linalg.norm(_SWAPPED @ state.position_w - start_w) <= limit_m:
        raise LinkError(f"{fact}: its position looks like ENU sent as NED; {HELP}.")
    raise LinkError(f"{fact}; bring it there, or give another scene.")


class FrameCheck:
    """Compares positions with velocities, and thrust with acceleration, over the last samples."""

    def __init__(self) -> None:
        self.samples: deque[Odometry] = deque()
        self.moving = self.turning = 0

    def take(self, state: Odometry) -> None:
        """Looks at one more sample.

        Raises:
            LinkError: A part of the odometry is in another frame; it says which.
        """
        self.samples.append(state)
        while state.stamp_s - self.samples[0].stamp_s > WINDOW_S:
            self.samples.popleft()
        if state.stamp_s - self.samples[0].stamp_s < 0.6 * WINDOW_S or len(self.samples) < 4:
            return
        self._compare_motion()
        self._compare_thrust()

    def _compare_motion(self) -> None:
        moved = self.samples[-1].position_w - self.samples[0].position_w
        flown = self._integral(np.array([s.velocity_w for s in self.samples]))
        self.moving = self.moving + 1 if _differ(moved, flown) else 0
        if self.moving < PERSISTS:
            return
        others = {
            "of the body, not of the world": [
                matrix(s.attitude_wb) @ _TO_BODY for s in self.samples
            ],
            "of the world, not of the body": [
                _TO_BODY.T @ matrix(s.attitude_wb).T for s in self.samples
            ],
            "in ENU, not in NED": [_SWAPPED] * len(self.samples),
        }
        paths = {
            name: self._integral(
                np.array([turn @ s.velocity_w for turn, s in zip(turns, self.samples, strict=True)])
            )
            for name, turns in others.items()
        }
        best = min(paths, key=lambda name: float(np.linalg.norm(paths[name] - moved)))
        told = "" if _differ(moved, paths[best]) else f": it looks like a velocity {best}"
        raise LinkError(
            f"The velocity of the odometry says that the vehicle moved by {_shown(flown)} m, its "
            f"positions say {_shown(moved)} m{told}; {HELP}."
        )

    def _compare_thrust(self) -> None:
        """A rotor's thrust is along the body: acceleration less gravity points there."""
        first, last = self.samples[0], self.samples[-1]
        gained = (last.velocity_w - first.velocity_w) / (last.stamp_s - first.stamp_s)
        up = np.mean([s.up_b for s in self.samples], 0)
        off = _angle(gained + _GRAVITY, up)
        self.turning = self.turning + 1 if off > TILT_RAD else 0
        if self.turning < PERSISTS:
            return
        mirrored = _angle(_SWAPPED @ gained + _GRAVITY, -_SWAPPED @ up)
        told = ": all of it looks like ENU sent as NED" if mirrored < TILT_RAD / 2 else ""
        raise LinkError(
            f"The attitude of the odometry has the thrust {np.degrees(off):.0f} degrees away from "
            f"where the vehicle accelerates{told}; {HELP}."
        )

    def _integral(self, values: Float[np.ndarray, "t 3"]) -> Float[np.ndarray, "3"]:
        times = np.array([s.stamp_s for s in self.samples])
        return np.trapezoid(values, times, axis=0)


def _differ(moved: Float[np.ndarray, "3"], flown: Float[np.ndarray, "3"]) -> bool:
    far = max(np.linalg.norm(moved), np.linalg.norm(flown))
    return bool(far > LEAST_M and np.linalg.norm(moved - flown) > SHARE * far)


def _angle(a: Float[np.ndarray, "3"], b: Float[np.ndarray, "3"]) -> float:
    cosine = a @ b / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-9)
    return float(np.arccos(np.clip(cosine, -1, 1)))


def _shown(vector: Float[np.ndarray, "3"]) -> str:
    return f"({', '.join(f'{value:.2f}' for value in vector)})"
