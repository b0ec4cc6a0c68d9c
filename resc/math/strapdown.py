"""What accelerometer and gyroscope tell of the motion: dead reckoning over a delay."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from resc.math.rotation import normalize, product, quaternion_from_vector, rotate


class Motion(NamedTuple):
    """Position [m], velocity [m/s], attitude, body to world."""

    position: Float[Tensor, "n 3"]
    velocity: Float[Tensor, "n 3"]
    attitude: Float[Tensor, "n 4"]


class Delay(NamedTuple):
    """A delay in steps: so many whole ones, and a part of one more."""

    whole: int
    part: float

    @classmethod
    def of(cls, delay_s: float, dt_s: float) -> "Delay":
        """The delay of so many seconds; a thousandth of a step is none."""
        steps = delay_s / dt_s
        whole = int(steps + 1e-3)
        return cls(whole, steps - whole if steps - whole > 1e-3 else 0.0)

    @property
    def steps(self) -> int:
        """Readings, the newest included, that a step which ends this much ago reaches back to."""
        return self.whole + 2

    def last_step(self) -> list[tuple[int, float]]:
        """Ages of the readings of the step that ended this long ago, and their shares of it."""
        shares = [(self.whole + 1, self.part), (self.whole, 1 - self.part)]
        return [(age, share) for age, share in shares if share]

    def until_now(self) -> list[tuple[int, float]]:
        """The same of the time from then on."""
        parts = [(self.whole, self.part)] if self.part else []
        return [*parts, *((age, 1.0) for age in reversed(range(self.whole)))]


def flown_on(
    motion: Motion,
    readings: Float[Tensor, "n b 6"],
    shares: Sequence[tuple[int, float]],
    dt_s: float,
    *,
    gravity_mps2: float | None,
) -> Motion:
    """The motion after some steps, or shares of them.

    a = R(q exp(w t/4)) f - g e_z;  p += v t + a t^2/2;  v += a t;  q <- q exp(w t / 2), with q of
    the middle of the time t in a.

    Args:
        motion: Where it begins.
        readings: Specific force and body rate, means of a step, newest first.
        shares: Ages of the readings, and for how much of a step each holds, in order of time.
        dt_s: The control period.
        gravity_mps2: g; None where the specific force does not count and the velocity stays.
    """
    position, velocity, attitude = motion
    for age, share in shares:
        force, rate = readings[:, age].split(3, -1)
        time = share * dt_s
        position = position + velocity * time
        if gravity_mps2 is not None:
            middle = product(attitude, quaternion_from_vector(rate * (time / 2)))
            push = acceleration(middle, force, gravity_mps2)
            position = position + push * (time * time / 2)
            velocity = velocity + push * time
        attitude = normalize(product(attitude, quaternion_from_vector(rate * time)))
    return Motion(position, velocity, attitude)


def acceleration(
    attitude: Float[Tensor, "n 4"], force: Float[Tensor, "n 3"], gravity_mps2: float
) -> Float[Tensor, "n 3"]:
    """Kinematic acceleration [m/s^2] of a specific force."""
    return rotate(attitude, force) - force.new_tensor([0.0, 0.0, gravity_mps2])


def with_newest(
    past: Float[Tensor, "n b 6"], newest: Float[Tensor, "n 6"]
) -> Float[Tensor, "n b 6"]:
    """A reading put before those of earlier steps, the oldest left out."""
    return torch.cat((newest.unsqueeze(1), past[:, :-1]), 1)
