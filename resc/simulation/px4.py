"""PX4's body-rate loop: gyro filters, PID, allocation and thrust curve, several runs a step."""

import math
from collections.abc import Mapping
from typing import Annotated

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.keys import NestedKey
from resc.quantities import Positive, Within
from resc.simulation.filters import Butterworth, share_of_new
from resc.simulation.px4_allocator import allocate, mixing
from resc.simulation.px4_settings import Px4Settings
from resc.term import Context, Term

FLU_FRD = (1.0, -1.0, -1.0)
FADED_RADPS = math.radians(400)
"""Error of the rate at which the integrator stands still."""
STATUS_S = 0.005
"""The least time between two reports of the allocator to the rate controller."""
ACHIEVED = 1e-6
"""Square of the unallocated torque below which the allocator reports none."""
EPSILON = torch.finfo(torch.float32).eps

LOOP = (
    keys.GYRO_DELAYS,
    keys.FILTERED_RATE,
    keys.FILTERED_ACCELERATION,
    keys.RATE_INTEGRAL,
    keys.YAW_TORQUE,
    keys.UNALLOCATED,
    keys.STATUS_AGE,
)


class Px4RateLoop(Term):
    """Rotor thrust [N] as PX4 commands it; gains and geometry are the vehicle's `controllers.px4`.

    tau = P (commanded - w) + I-state - D w' + FF commanded, w the gyro behind a Butterworth filter,
    w' the difference of w behind a filter of order 1, yaw torque behind another one. The integrator
    fades out with large errors and stops at its limit; where the allocator reports torque that it
    could not give, the error that would ask for more does not count. Thrust [N] becomes throttle by
    the vehicle's own curve. The gyro measures the true rate, unless `randomization=gyro` gives it
    errors; `randomization=gains` draws gains for each environment. Source: px4.md 1.1 to 1.7.

    Args:
        rate_hz: Runs per second, each followed by as much dynamics.
        acceleration_cutoff_hz: IMU_DGYRO_CUTOFF of the firmware, unless the vehicle has its own.
        yaw_torque_cutoff_hz: MC_YAW_TQ_CUTOFF; null before v1.16.
    """

    reads = (keys.COLLECTIVE_THRUST, keys.BODY_RATE_COMMAND_B, keys.BODY_RATE_B, *LOOP)
    writes = (keys.ROTOR_COMMAND, *LOOP)
    keeps = LOOP
    varies = (keys.RATE_GAINS,)
    p: Tensor
    i: Tensor
    d: Tensor
    feed_forward: Tensor
    integral_limit: Tensor
    frame: Tensor
    is_yaw: Tensor
    mix: Tensor
    demix: Tensor

    def __init__(
        self,
        *,
        rate_hz: Annotated[float, Within(50, 2000)] = 400.0,
        acceleration_cutoff_hz: Positive = 20.0,
        yaw_torque_cutoff_hz: Positive | None = 2.0,
    ) -> None:
        super().__init__()
        self.rate_hz = rate_hz
        self.acceleration_cutoff_hz = acceleration_cutoff_hz
        self.yaw_torque_cutoff_hz = yaw_torque_cutoff_hz
        self.reports_every = math.ceil(STATUS_S * rate_hz - 1e-9)

    def bind(self, context: Context) -> None:
        """Takes the gains and the geometry, and how often it runs."""
        self.runs = runs_per_step(self.rate_hz, context.dt_s)
        self.vehicle = context.vehicle
        settings = self.settings = settings_of(context.vehicle)
        cutoff_hz = settings.acceleration_cutoff_hz or self.acceleration_cutoff_hz
        if 2 * settings.gyro_cutoff_hz >= self.rate_hz:
            raise ConfigError(
                f"vehicle.controllers.px4.gyro_cutoff_hz is {settings.gyro_cutoff_hz:g}; expected "
                f"less than half of rate_hz, {self.rate_hz / 2:g}."
            )
        self.gyro = Butterworth.of(self.rate_hz, settings.gyro_cutoff_hz)
        self.acceleration_share = share_of_new(self.rate_hz, cutoff_hz)
        yaw_hz = self.yaw_torque_cutoff_hz
        self.yaw_share = share_of_new(self.rate_hz, yaw_hz) if yaw_hz else 1.0
        mix = torch.from_numpy(
            mixing(
                settings.arm_m or context.vehicle.arm_m,
                settings.torque_ratio_m or context.vehicle.torque_coefficient_m,
            )
        )
        constants = {name: getattr(settings, name) for name in GAINS}
        for name, numbers in {**constants, "frame": FLU_FRD}.items():
            self._keep(name, torch.tensor(numbers).unsqueeze(-1))
        self._keep("mix", mix)
        self.register_buffer("is_yaw", torch.tensor([[False], [False], [True]]), persistent=False)
        self._keep("demix", torch.linalg.inv(mix)[:3])

    def begin(self, tensors: Mapping[NestedKey, Tensor]) -> Mapping[NestedKey, Tensor]:
        """Filters that have settled on the present rate, and an empty integrator."""
        rate = tensors[keys.BODY_RATE_B] * self.frame[:, 0]
        nothing = torch.zeros_like(rate)
        return {
            keys.GYRO_DELAYS: self.gyro.settled(rate).unsqueeze(1).expand(-1, 2, -1),
            keys.FILTERED_RATE: rate,
            keys.FILTERED_ACCELERATION: nothing,
            keys.RATE_INTEGRAL: nothing,
            keys.YAW_TORQUE: nothing[:, :1],
            keys.UNALLOCATED: nothing,
            keys.STATUS_AGE: nothing[:, :1] + self.reports_every,
        }

    def compute(
        self,
        thrust: Float[Tensor, "n 1"],
        rate_command: Float[Tensor, "n 3"],
        body_rate: Float[Tensor, "n 3"],
        gyro_delays: Float[Tensor, "n 2 3"],
        filtered_rate: Float[Tensor, "n 3"],
        acceleration: Float[Tensor, "n 3"],
        integral: Float[Tensor, "n 3"],
        yaw_torque: Float[Tensor, "n 1"],
        unallocated: Float[Tensor, "n 3"],
        age: Float[Tensor, "n 1"],
        *drawn: Tensor,
    ) -> tuple[Tensor, ...]:
        # An axis or a rotor a row: the last dimension is long, and everything is done along it.
        command = rate_command.T * self.frame
        last, before = gyro_delays.permute(1, 2, 0).unbind(0)
        rate, delay = self.gyro.filtered(body_rate.T * self.frame, last, before)
        slope = (rate - filtered_rate.T) * self.rate_hz
        slope = acceleration.T + self.acceleration_share * (slope - acceleration.T)
        error = command - rate
        p, i, d = self._gains(*drawn)
        torque = p * error + integral.T - d * slope + self.feed_forward * command
        yaw = yaw_torque[:, 0] + self.yaw_share * (torque[2] - yaw_torque[:, 0])
        # No stack: the compiler would keep yaw as an unaligned part of it, which its loop refuses.
        torque = torch.where(self.is_yaw, yaw, torque)
        integral = self._integrated(integral.T, i, error, unallocated.T).T
        motors = allocate(torque, self._throttle(thrust[:, 0]), self.mix, self.settings.airmode)
        missing = torque - (self.demix.unsqueeze(-1) * motors).sum(1)
        missing = torch.where(missing.square().sum(0) < ACHIEVED, 0.0, missing)
        due = age >= self.reports_every
        return (
            self._thrust(motors).T,
            torch.stack((delay, last)).permute(2, 0, 1),
            rate.T,
            slope.T,
            integral,
            yaw.unsqueeze(-1),
            torch.where(due, missing.T, unallocated),
            torch.where(due, 1.0, age + 1),
        )

    def _gains(self, *drawn: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """P, I and D, each [3, 1], or [3, n] where the environments have their own."""
        nominal = (self.p, self.i, self.d)
        if not drawn:
            return nominal
        p, i, d = (gain * own for gain, own in zip(nominal, drawn[0].unbind(-1), strict=True))
        return p, i, d

    def _integrated(
        self, integral: Tensor, gain: Tensor, error: Tensor, unallocated: Tensor
    ) -> Tensor:
        """The integrator's next state [3, n]."""
        error = torch.where(unallocated > EPSILON, error.clamp(max=0), error)
        error = torch.where(unallocated < -EPSILON, error.clamp(min=0), error)
        fade = (1 - (error / FADED_RADPS).square()).clamp(min=0)
        integral = integral + fade * gain * error / self.rate_hz
        return torch.minimum(torch.maximum(integral, -self.integral_limit), self.integral_limit)

    def _throttle(self, thrust: Tensor) -> Tensor:
        """Normalised thrust [n] whose motors give the collective thrust [N]."""
        factor, signal = self.settings.thrust_factor, self.vehicle.throttle(thrust / 4)
        return signal * (1 - factor + factor * signal)

    def _thrust(self, motors: Tensor) -> Tensor:
        """Thrust [N] of the rotors [4, n] behind PX4's thrust curve."""
        factor = self.settings.thrust_factor
        if factor:
            straight = 1 - factor
            root = (straight**2 + 4 * factor * motors).sqrt()
            motors = (root - straight) / (2 * factor)
        return self.vehicle.thrust(motors).clamp(min=0)

    def _keep(self, name: str, values: Tensor) -> None:
        self.register_buffer(name, values.float(), persistent=False)


GAINS = ("p", "i", "d", "feed_forward", "integral_limit")


def runs_per_step(rate_hz: float, dt_s: float) -> int:
    """How often a loop runs in a control step.

    Raises:
        ConfigError: That is no whole number.
    """
    runs = rate_hz * dt_s
    if round(runs) < 1 or abs(runs - round(runs)) > 1e-6 * runs:
        raise ConfigError(
            f"rate_hz is {rate_hz:g}, {runs:g} runs in a control step of {dt_s:g} s; choose a rate "
            f"that is a multiple of {1 / dt_s:g}, or another env.dt_s."
        )
    return round(runs)


def settings_of(vehicle: object) -> Px4Settings:
    """What PX4 is told of a vehicle.

    Raises:
        ConfigError: Its file does not say.
    """
    settings = getattr(vehicle, "controllers", {}).get("px4")
    if not isinstance(settings, Px4Settings):
        raise ConfigError(
            "The vehicle has no controllers.px4, which holds PX4's gains for it; add them as in "
            "conf/vehicle/imp250.yaml, or choose a vehicle that has them, such as vehicle=imp250."
        )
    return settings
