"""An extended Kalman filter of the whole motion and of the IMU's biases."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.keys import NestedKey
from resc.math.kalman import corrected, predicted_covariance
from resc.math.rotation import (
    inverse,
    matrix_from_quaternion,
    normalize,
    product,
    quaternion_from_vector,
    rotate_inverse,
    vector_from_quaternion,
)
from resc.math.sampling import gaussian
from resc.math.strapdown import Delay, Motion, flown_on, with_newest
from resc.quantities import Angle, NotNegative, Positive
from resc.simulation.vehicle import GRAVITY_MPS2
from resc.term import Context, Estimator


class Belief(NamedTuple):
    """What the filter holds for true when the newest frame was taken."""

    motion: Motion
    bias: Float[Tensor, "n 6"]
    covariance: Float[Tensor, "n 15 15"]


class Ekf(Estimator):
    """An error-state Kalman filter: frames of motion capture correct what the IMU integrates.

    State: p, v, q, gyroscope bias b_w, accelerometer bias b_f; error e = (dp, dv, dth, db_w, db_f)
    with q_true = q exp(dth / 2). Between frames, R and q of the middle of a step:

    v' = v + (R (f - b_f) - g e_z) dt,  p' = p + v dt + (v' - v) dt / 2,  q' = q exp((w - b_w) dt/2)
    dth' = exp(-(w - b_w) dt) dth - dt db_w,  dv' = dv - dt R ([f]x dth + db_f)

    A frame measures p and q: y = (z_p - p, log(q^-1 z_q)), H = (I 0 0 0 0; 0 0 I 0 0), in the form
    of Joseph. The turn of the error's frame by a correction, of second order, is left out. As in
    `Kalman`, the filter stands `latency_s` ago and readings carry it up to now. An episode begins
    with errors of the initial deviations.

    Args:
        force_noise_mps2: Standard deviation of the accelerometer's noise in one step.
        rate_noise_radps: The gyroscope's.
        force_drift_mps2: How much its bias may drift, in a second.
        rate_drift_radps: The gyroscope's.
        position_noise_m: Standard deviation of a frame's position, each axis.
        attitude_noise_rad: Of its attitude.
        gate: Frames farther off than this many standard deviations are dropped; null for none.
        initial_position_m: Standard deviation of the first error, each axis.
        initial_velocity_mps: The same of the velocity.
        initial_attitude_rad: The same of the attitude.
        initial_rate_bias_radps: What is known of the gyroscope's bias: taken for 0 at first.
        initial_force_bias_mps2: The same of the accelerometer's.
        latency_s: What the filter takes for the age of the frames; null for what it is.
        buffer_s: How long readings of the IMU are kept.
    """

    reads = (
        keys.CLOCK,
        keys.MOCAP_POSITION_W,
        keys.MOCAP_ATTITUDE_WB,
        keys.MOCAP_FRESH,
        keys.IMU_SPECIFIC_FORCE_B,
        keys.IMU_MEAN_RATE_B,
        keys.IMU_BODY_RATE_B,
        keys.FILTER_MEAN,
        keys.FILTER_ATTITUDE_WB,
        keys.FILTER_COVARIANCE,
        keys.FILTER_INPUTS,
    )
    writes = (
        *Estimator.writes,
        keys.FILTER_MEAN,
        keys.FILTER_ATTITUDE_WB,
        keys.FILTER_COVARIANCE,
        keys.FILTER_INPUTS,
    )
    step_draws = 9

    def __init__(
        self,
        *,
        force_noise_mps2: Positive,
        rate_noise_radps: Positive,
        position_noise_m: Positive,
        attitude_noise_rad: Positive,
        force_drift_mps2: NotNegative = 0.0,
        rate_drift_radps: NotNegative = 0.0,
        gate: Positive | None = None,
        initial_position_m: NotNegative = 0.0,
        initial_velocity_mps: NotNegative = 0.0,
        initial_attitude_rad: Angle = 0.0,
        initial_rate_bias_radps: NotNegative = 0.0,
        initial_force_bias_mps2: NotNegative = 0.0,
        latency_s: NotNegative | None = None,
        buffer_s: NotNegative = 0.1,
    ) -> None:
        super().__init__()
        self.noise = (rate_noise_radps, force_noise_mps2)
        self.drift = (rate_drift_radps, force_drift_mps2)
        self.frame_noise = (position_noise_m, attitude_noise_rad)
        self.gate = gate
        self.first_errors = (
            initial_position_m,
            initial_velocity_mps,
            initial_attitude_rad,
            initial_rate_bias_radps,
            initial_force_bias_mps2,
        )
        self.latency_s = latency_s
        self.buffer_s = buffer_s

    def bind(self, context: Context) -> None:
        """Takes the control period, and the latency where it is not told one."""
        self.dt_s = context.dt_s
        late_s = context.latency_s if self.latency_s is None else self.latency_s
        if late_s > self.buffer_s + 1e-9:
            raise ConfigError(
                f"buffer_s is {self.buffer_s:g}, but frames are {late_s:g} s old when they arrive; "
                f"raise it to {late_s:g}, or lower the sensor's latency_s."
            )
        self.delay = Delay.of(late_s, self.dt_s)
        self.kept = max(self.delay.steps, Delay.of(self.buffer_s, self.dt_s).steps)
        self.late_s = late_s

    @property
    def dims(self) -> Mapping[str, int]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Fifteen errors, and the readings of the buffer."""
        return {"d": 15, "c": 1, "b": self.kept}

    def begin(self, tensors: Mapping[NestedKey, Tensor]) -> Mapping[NestedKey, Tensor]:
        """The truth when the newest frame was taken, had the flight been straight until now."""
        position, velocity = tensors[keys.POSITION_W], tensors[keys.VELOCITY_W]
        attitude, none = tensors[keys.ATTITUDE_WB], torch.zeros_like(velocity)
        up = none + velocity.new_tensor([0.0, 0.0, GRAVITY_MPS2])
        still = torch.cat((rotate_inverse(attitude, up), none), -1)
        past = position - velocity * self.late_s
        mean = torch.cat((past, velocity, none, none, none), -1)
        spread = velocity.new_tensor([each for each in self.first_errors for _ in range(3)])
        return {
            **super().begin(tensors),
            keys.FILTER_MEAN: mean.unsqueeze(-1),
            keys.FILTER_ATTITUDE_WB: attitude,
            keys.FILTER_COVARIANCE: torch.diag(spread.square()).expand(len(mean), 15, 15),
            keys.FILTER_INPUTS: still.unsqueeze(1).expand(-1, self.kept, -1),
        }

    def compute(
        self,
        clock: Float[Tensor, "n 1"],
        position: Float[Tensor, "n 3"],
        attitude: Float[Tensor, "n 4"],
        fresh: Bool[Tensor, "n 1"],
        force: Float[Tensor, "n 3"],
        mean_rate: Float[Tensor, "n 3"],
        rate: Float[Tensor, "n 3"],
        mean: Float[Tensor, "n 15 1"],
        turned: Float[Tensor, "n 4"],
        covariance: Float[Tensor, "n 15 15"],
        inputs: Float[Tensor, "n b 6"],
        unit: Float[Tensor, "n 9"],
    ) -> tuple[Tensor, ...]:
        begins = clock == 0
        newest = with_newest(inputs, torch.cat((force, mean_rate), -1))
        inputs = torch.where(begins.unsqueeze(-1), inputs, newest)
        held = mean[..., 0]
        bias = torch.cat((held[:, 12:], held[:, 9:12]), -1)  # of force and rate, as inputs are
        before = Motion(held[:, :3], held[:, 3:6], turned)

        first = self._first(before, gaussian(unit))
        unbiased = inputs - bias.unsqueeze(1)
        later = self._flown_on(before, unbiased, self.delay.last_step())
        motion = Motion(*(torch.where(begins, a, b) for a, b in zip(first, later, strict=True)))
        spread = self._spread(before.attitude, unbiased, covariance)
        covariance = torch.where(begins.unsqueeze(-1), covariance, spread)

        belief = Belief(motion, bias, covariance)
        motion, bias, covariance = self._corrected(belief, position, attitude, fresh & ~begins)
        now = self._flown_on(motion, inputs - bias.unsqueeze(1), self.delay.until_now())
        zero = torch.zeros_like(position)  # the attitude's error is zero: it is in the attitude
        held = torch.cat((motion.position, motion.velocity, zero, bias[:, 3:], bias[:, :3]), -1)
        return (
            *now,
            rate - bias[:, 3:],
            held.unsqueeze(-1),
            motion.attitude,
            covariance,
            inputs,
        )

    def _first(self, motion: Motion, noise: Float[Tensor, "n 9"]) -> Motion:
        """The motion with an error of the initial deviations."""
        of_position, of_velocity, of_attitude, *_ = self.first_errors
        turn = quaternion_from_vector(of_attitude * noise[:, 6:])
        return Motion(
            motion.position + of_position * noise[:, :3],
            motion.velocity + of_velocity * noise[:, 3:6],
            normalize(product(motion.attitude, turn)),
        )

    def _flown_on(
        self, motion: Motion, inputs: Float[Tensor, "n b 6"], shares: Sequence[tuple[int, float]]
    ) -> Motion:
        return flown_on(motion, inputs, shares, self.dt_s, gravity_mps2=GRAVITY_MPS2)

    def _spread(
        self,
        attitude: Float[Tensor, "n 4"],
        inputs: Float[Tensor, "n b 6"],
        covariance: Float[Tensor, "n 15 15"],
    ) -> Float[Tensor, "n 15 15"]:
        """The covariance one step later, over the readings' mean of that time."""
        shares = self.delay.last_step()
        reading = torch.stack([share * inputs[:, age] for age, share in shares]).sum(0)
        step, turn = self._transition(attitude, reading)
        of_rate, of_force = self.noise
        time = self.dt_s
        none = torch.zeros_like(turn)
        eye = none + torch.eye(3, dtype=none.dtype, device=none.device)
        rows = (
            (turn * (of_force * time * time / 2), none),
            (turn * (of_force * time), none),
            (none, eye * (of_rate * time)),
            (none, none),
            (none, none),
        )
        enters = torch.cat([torch.cat(row, -1) for row in rows], 1)
        drifts = [0.0] * 9 + [drift * time**0.5 for drift in self.drift for _ in range(3)]
        wander = torch.diag(covariance.new_tensor(drifts).square())
        return predicted_covariance(covariance, step, enters @ enters.mT + wander)

    def _transition(
        self, attitude: Float[Tensor, "n 4"], reading: Float[Tensor, "n 6"]
    ) -> tuple[Float[Tensor, "n 15 15"], Float[Tensor, "n 3 3"]]:
        """F of the errors over a step, and R of the middle of it."""
        time = self.dt_s
        force, rate = reading.split(3, -1)
        turn = matrix_from_quaternion(product(attitude, quaternion_from_vector(rate * (time / 2))))
        back = matrix_from_quaternion(quaternion_from_vector(-rate * time))
        half = matrix_from_quaternion(quaternion_from_vector(-rate * (time / 2)))
        eye = torch.eye(3, dtype=reading.dtype, device=reading.device).expand_as(turn)
        none = torch.zeros_like(turn)
        tilted = -time * (turn @ crossing(force) @ half)  # what the attitude's error does to v
        pushed = -time * turn
        rows = (
            (eye, time * eye, tilted * (time / 2), none, pushed * (time / 2)),
            (none, eye, tilted, -tilted * (time / 2), pushed),
            (none, none, back, -time * eye, none),
            (none, none, none, eye, none),
            (none, none, none, none, eye),
        )
        return torch.cat([torch.cat(row, -1) for row in rows], 1), turn

    def _corrected(
        self,
        belief: Belief,
        position: Float[Tensor, "n 3"],
        attitude: Float[Tensor, "n 4"],
        used: Bool[Tensor, "n 1"],
    ) -> Belief:
        """What a frame says, where one arrived."""
        motion, bias, covariance = belief
        off = vector_from_quaternion(product(inverse(motion.attitude), attitude))
        innovation = torch.cat((position - motion.position, off), -1).unsqueeze(-1)
        eye = torch.eye(15, dtype=covariance.dtype, device=covariance.device)
        spread = covariance.new_tensor([each for each in self.frame_noise for _ in range(3)])
        error, covariance = corrected(
            torch.zeros_like(covariance[..., :1]),
            covariance,
            innovation=innovation,
            observed=torch.cat((eye[:3], eye[6:9])),
            noise=torch.diag(spread.square()),
            used=used,
            gate=self.gate,
        )
        of_position, of_velocity, of_attitude, of_rate, of_force = error[..., 0].split(3, -1)
        turned = normalize(product(motion.attitude, quaternion_from_vector(of_attitude)))
        moved = Motion(motion.position + of_position, motion.velocity + of_velocity, turned)
        return Belief(moved, bias + torch.cat((of_force, of_rate), -1), covariance)


def crossing(vector: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3 3"]:
    """The matrix of a cross product: [v]x u = v x u."""
    x, y, z = vector.unbind(-1)
    zero = torch.zeros_like(x)
    rows = ((zero, -z, y), (z, zero, -x), (-y, x, zero))
    return torch.stack([torch.stack(row, -1) for row in rows], -2)
