"""What PX4 is told of a vehicle: gains, filters and the geometry that its allocator believes in."""

from collections.abc import Sequence
from typing import Literal

from resc.errors import ConfigError
from resc.quantities import NotNegative, Positive, Share

AXES = "roll, pitch, yaw"


class Px4Settings:
    """Parameters of PX4's rate loop; torque is normalised, throttle in [0, 1].

    Args:
        p: MC_*RATE_P, normalised torque per rad/s.
        i: MC_*RATE_I, per rad.
        d: MC_*RATE_D, per rad/s^2.
        k: MC_*RATE_K, which scales p, i and d.
        feed_forward: MC_*RATE_FF, normalised torque per commanded rad/s.
        integral_limit: MC_*R_INT_LIM, normalised torque.
        gyro_cutoff_hz: IMU_GYRO_CUTOFF.
        acceleration_cutoff_hz: IMU_DGYRO_CUTOFF; null for the firmware's.
        airmode: MC_AIRMODE.
        thrust_factor: THR_MDL_FAC.
        arm_m: CA_ROTOR*_P: x, y of the front rotors, y of the rear ones; null for the true ones.
        torque_ratio_m: CA_ROTOR*_KM; null for the true one.
    """

    def __init__(
        self,
        *,
        p: Sequence[NotNegative],
        i: Sequence[NotNegative],
        d: Sequence[NotNegative],
        k: Sequence[NotNegative] = (1.0, 1.0, 1.0),
        feed_forward: Sequence[NotNegative] = (0.0, 0.0, 0.0),
        integral_limit: Sequence[NotNegative] = (0.3, 0.3, 0.3),
        gyro_cutoff_hz: Positive = 40.0,
        acceleration_cutoff_hz: Positive | None = None,
        airmode: Literal[0, 1, 2] = 0,
        thrust_factor: Share = 0.0,
        arm_m: Sequence[Positive] | None = None,
        torque_ratio_m: Positive | None = None,
    ) -> None:
        lists = {"p": p, "i": i, "d": d, "k": k, "feed_forward": feed_forward}
        lists["integral_limit"] = integral_limit
        for name, numbers in lists.items():
            if len(numbers) != 3:
                raise ConfigError(f"{name} is {list(numbers)}; expected 3 numbers: {AXES}.")
        if arm_m is not None and len(arm_m) != 3:
            raise ConfigError(f"arm_m is {list(arm_m)}; expected 3 numbers: x, front y, rear y.")
        self.p = tuple(gain * factor for gain, factor in zip(p, k, strict=True))
        self.i = tuple(gain * factor for gain, factor in zip(i, k, strict=True))
        self.d = tuple(gain * factor for gain, factor in zip(d, k, strict=True))
        self.feed_forward = tuple(feed_forward)
        self.integral_limit = tuple(integral_limit)
        self.gyro_cutoff_hz = gyro_cutoff_hz
        self.acceleration_cutoff_hz = acceleration_cutoff_hz
        self.airmode = airmode
        self.thrust_factor = thrust_factor
        self.arm_m = None if arm_m is None else tuple(arm_m)
        self.torque_ratio_m = torque_ratio_m
