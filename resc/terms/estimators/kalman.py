"""Kalman filters of position and velocity."""

from collections.abc import Mapping

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.keys import NestedKey
from resc.math.kalman import corrected, predicted_covariance, transition, white_acceleration
from resc.math.rotation import (
    inverse,
    normalize,
    product,
    quaternion_from_vector,
    rotate_inverse,
    vector_from_quaternion,
)
from resc.math.sampling import gaussian
from resc.math.strapdown import Delay, Motion, flown_on, with_newest
from resc.quantities import Angle, NotNegative, Positive, Share
from resc.simulation.vehicle import GRAVITY_MPS2
from resc.term import Context, Estimator


class Kalman(Estimator):
    """A Kalman filter of position and velocity, and a gyroscope whose attitude is held by frames.

    x = (p, v) of each axis; p += v dt + a dt^2/2, v += a dt + w, w of deviation sa dt; z = p + n.

    The filter stands at the time of the newest frame, `latency_s` ago, and the readings of the IMU
    since then carry what it knows up to now. a = R f - g from the accelerometer, or 0. The attitude
    follows the gyroscope and is turned by a share of its difference to that of each frame. All axes
    share one covariance. An episode begins with an error of the initial deviations.

    Args:
        uses_accelerometer: Whether a is measured, or unknown.
        acceleration_mps2: sa: what a is wrong by, for the length of a step.
        position_noise_m: Standard deviation of n.
        attitude_gain: Share of the attitude's error that a frame takes away.
        gate: Frames farther off than this many standard deviations are dropped; null for none.
        initial_position_m: Standard deviation of the first error.
        initial_velocity_mps: The same of the velocity.
        initial_attitude_rad: The same of the attitude.
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
        uses_accelerometer: bool,
        acceleration_mps2: Positive,
        position_noise_m: Positive,
        attitude_gain: Share,
        gate: Positive | None = None,
        initial_position_m: NotNegative = 0.0,
        initial_velocity_mps: NotNegative = 0.0,
        initial_attitude_rad: Angle = 0.0,
        latency_s: NotNegative | None = None,
        buffer_s: NotNegative = 0.1,
    ) -> None:
        super().__init__()
        self.gravity_mps2 = GRAVITY_MPS2 if uses_accelerometer else None
        self.acceleration_mps2 = acceleration_mps2
        self.position_noise_m = position_noise_m
        self.attitude_gain = attitude_gain
        self.gate = gate
        self.first_errors = (initial_position_m, initial_velocity_mps, initial_attitude_rad)
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
        """Position and velocity, three axes, and the readings of the buffer."""
        return {"d": 2, "c": 3, "b": self.kept}

    def begin(self, tensors: Mapping[NestedKey, Tensor]) -> Mapping[NestedKey, Tensor]:
        """The truth when the newest frame was taken, had the flight been straight until now."""
        position, velocity = tensors[keys.POSITION_W], tensors[keys.VELOCITY_W]
        attitude = tensors[keys.ATTITUDE_WB]
        up = torch.zeros_like(velocity) + velocity.new_tensor([0.0, 0.0, GRAVITY_MPS2])
        still = torch.cat((rotate_inverse(attitude, up), torch.zeros_like(velocity)), -1)
        spread = torch.tensor(self.first_errors[:2], dtype=velocity.dtype, device=velocity.device)
        return {
            **super().begin(tensors),
            keys.FILTER_MEAN: torch.stack((position - velocity * self.late_s, velocity), 1),
            keys.FILTER_ATTITUDE_WB: attitude,
            keys.FILTER_COVARIANCE: torch.diag(spread.square()).expand(len(velocity), 2, 2),
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
        mean: Float[Tensor, "n 2 3"],
        turned: Float[Tensor, "n 4"],
        covariance: Float[Tensor, "n 2 2"],
        inputs: Float[Tensor, "n b 6"],
        unit: Float[Tensor, "n 9"],
    ) -> tuple[Tensor, ...]:
        begins = clock == 0
        newest = with_newest(inputs, torch.cat((force, mean_rate), -1))
        inputs = torch.where(begins.unsqueeze(-1), inputs, newest)
        before = Motion(mean[:, 0], mean[:, 1], turned)
        first = self._first(before, gaussian(unit))
        later = self._flown_on(before, inputs, self.delay.last_step())
        motion = Motion(*(torch.where(begins, a, b) for a, b in zip(first, later, strict=True)))
        covariance = torch.where(begins.unsqueeze(-1), covariance, self._spread(covariance))

        used = fresh & ~begins
        motion, covariance = self._corrected(motion, covariance, position, attitude, used)
        now = self._flown_on(motion, inputs, self.delay.until_now())
        mean = torch.stack((motion.position, motion.velocity), 1)
        return (*now, rate, mean, motion.attitude, covariance, inputs)

    def _first(self, motion: Motion, noise: Float[Tensor, "n 9"]) -> Motion:
        """The motion with an error of the initial deviations."""
        of_position, of_velocity, of_attitude = self.first_errors
        turn = quaternion_from_vector(of_attitude * noise[:, 6:])
        return Motion(
            motion.position + of_position * noise[:, :3],
            motion.velocity + of_velocity * noise[:, 3:6],
            normalize(product(motion.attitude, turn)),
        )

    def _flown_on(
        self, motion: Motion, inputs: Float[Tensor, "n b 6"], shares: list[tuple[int, float]]
    ) -> Motion:
        return flown_on(motion, inputs, shares, self.dt_s, gravity_mps2=self.gravity_mps2)

    def _spread(self, covariance: Float[Tensor, "n 2 2"]) -> Float[Tensor, "n 2 2"]:
        """The covariance one step later."""
        noise = white_acceleration(self.dt_s, self.acceleration_mps2, covariance)
        return predicted_covariance(covariance, transition(self.dt_s, covariance), noise)

    def _corrected(
        self,
        motion: Motion,
        covariance: Float[Tensor, "n 2 2"],
        position: Float[Tensor, "n 3"],
        attitude: Float[Tensor, "n 4"],
        used: Bool[Tensor, "n 1"],
    ) -> tuple[Motion, Float[Tensor, "n 2 2"]]:
        """What a frame says, where one arrived."""
        mean, covariance = corrected(
            torch.stack((motion.position, motion.velocity), 1),
            covariance,
            innovation=(position - motion.position).unsqueeze(1),
            observed=covariance.new_tensor([[1.0, 0.0]]),
            noise=covariance.new_tensor([[self.position_noise_m**2]]),
            used=used,
            gate=self.gate,
        )
        error = vector_from_quaternion(product(inverse(motion.attitude), attitude))
        turn = quaternion_from_vector(torch.where(used, self.attitude_gain * error, 0.0))
        turned = normalize(product(motion.attitude, turn))
        return Motion(mean[:, 0], mean[:, 1], turned), covariance
