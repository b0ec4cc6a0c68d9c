"""Motion capture."""

import math
from collections.abc import Mapping
from typing import Annotated

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.keys import NestedKey
from resc.math.rotation import normalize, product, quaternion_from_vector
from resc.math.sampling import gaussian
from resc.quantities import Angle, NotNegative, Positive, Share, Within
from resc.term import Context, Device

Latency = Annotated[float, Within(0, 1)]


class Mocap(Device):
    """Position and attitude of the vehicle `latency_s` ago, `rate_hz` times a second.

    p_t = p(t - latency) + n_p + spike,  q_t = q(t - latency) exp(n_q / 2).

    Frames arrive at the control steps; the pose between two steps is a cubic curve through their
    positions and velocities, and the attitude on the shortest turn between theirs. Where no frame
    arrives, because none is due, it is lost or the vehicle is hidden, the last one stays. Before
    its first step an episode is taken to have flown straight on.

    Args:
        rate_hz: Frames per second, at most one for each control step.
        latency_s: From the exposure of a frame to its arrival, the same for all.
        position_noise_m: Standard deviation of white noise, each axis.
        attitude_noise_rad: Of the rotation vector by which the attitude is turned, each axis.
        spike_share: Share of the frames whose position is wrong.
        spike_m: Standard deviation of what these are wrong by, each axis.
        lost_share: Share of the frames that are lost, each on its own.
        hidden_per_s: How often a second the vehicle goes out of sight.
        hidden_s: For how long.
    """

    reads = (
        keys.CLOCK,
        keys.POSITION_W,
        keys.VELOCITY_W,
        keys.ATTITUDE_WB,
        keys.MOCAP_POSITION_W,
        keys.MOCAP_ATTITUDE_WB,
        keys.MOCAP_PAST,
        keys.MOCAP_HIDDEN,
    )
    writes = (
        keys.MOCAP_POSITION_W,
        keys.MOCAP_ATTITUDE_WB,
        keys.MOCAP_FRESH,
        keys.MOCAP_PAST,
        keys.MOCAP_HIDDEN,
    )
    step_draws = 12

    def __init__(
        self,
        *,
        rate_hz: Positive,
        latency_s: Latency = 0.0,
        position_noise_m: NotNegative = 0.0,
        attitude_noise_rad: Angle = 0.0,
        spike_share: Share = 0.0,
        spike_m: NotNegative = 0.0,
        lost_share: Share = 0.0,
        hidden_per_s: NotNegative = 0.0,
        hidden_s: NotNegative = 0.0,
    ) -> None:
        super().__init__()
        self.rate_hz = rate_hz
        self.latency_s = latency_s
        self.position_noise_m = position_noise_m
        self.attitude_noise_rad = attitude_noise_rad
        self.spike_share = spike_share
        self.spike_m = spike_m
        self.lost_share = lost_share
        self.hidden_per_s = hidden_per_s
        self.hidden_s = hidden_s

    def bind(self, context: Context) -> None:
        """Takes the control period."""
        self.dt_s = context.dt_s
        if self.rate_hz * self.dt_s > 1 + 1e-6:
            raise ConfigError(
                f"rate_hz is {self.rate_hz:g}, but there are {1 / self.dt_s:g} control steps a "
                "second, each with one frame at most; lower it."
            )
        steps = self.latency_s / self.dt_s
        self.whole = math.floor(steps + 1e-6)
        self.part = max(0.0, steps - self.whole)
        self.part = self.part if self.part > 1e-6 else 0.0

    @property
    def dims(self) -> Mapping[str, int]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """How many steps back it must remember."""
        return {"b": self.whole + 1}

    def begin(self, tensors: Mapping[NestedKey, Tensor]) -> Mapping[NestedKey, Tensor]:
        """A straight flight until now."""
        position, velocity = tensors[keys.POSITION_W], tensors[keys.VELOCITY_W]
        attitude = tensors[keys.ATTITUDE_WB]
        past = [
            torch.cat((position - velocity * (age * self.dt_s), velocity, attitude), -1)
            for age in range(1, self.whole + 2)
        ]
        zero = torch.zeros_like(position[:, :1])
        return {
            keys.MOCAP_POSITION_W: position - velocity * self.latency_s,
            keys.MOCAP_ATTITUDE_WB: attitude,
            keys.MOCAP_FRESH: zero > 1,
            keys.MOCAP_PAST: torch.stack(past, 1),
            keys.MOCAP_HIDDEN: zero,
        }

    def compute(
        self,
        clock: Float[Tensor, "n 1"],
        position: Float[Tensor, "n 3"],
        velocity: Float[Tensor, "n 3"],
        attitude: Float[Tensor, "n 4"],
        last_position: Float[Tensor, "n 3"],
        last_attitude: Float[Tensor, "n 4"],
        past: Float[Tensor, "n b 10"],
        hidden: Float[Tensor, "n 1"],
        unit: Float[Tensor, "n 12"],
    ) -> tuple[Tensor, ...]:
        now = torch.cat((position, velocity, attitude), -1)
        flown = torch.cat((now.unsqueeze(1), past), 1)
        noise = gaussian(unit[:, :9])
        lost, vanishes, spikes = (unit[:, i : i + 1] for i in (9, 10, 11))
        then, turned = self._pose(flown)
        wrong = torch.where(spikes < self.spike_share, self.spike_m, 0.0)
        seen = then + self.position_noise_m * noise[:, :3] + wrong * noise[:, 6:]
        turn = quaternion_from_vector(self.attitude_noise_rad * noise[:, 3:6])
        hidden = (hidden - self.dt_s).clamp(min=0)
        begins = vanishes < self.hidden_per_s * self.dt_s
        hidden = torch.where(begins & (hidden <= 0) & (clock > 0), self.hidden_s, hidden)
        fresh = self._due(clock) & (lost >= self.lost_share) & (hidden <= 0)
        fresh = fresh | (clock == 0)
        return (
            torch.where(fresh, seen, last_position),
            torch.where(fresh, normalize(product(turned, turn)), last_attitude),
            fresh,
            flown[:, :-1],
            hidden,
        )

    def _due(self, clock: Float[Tensor, "n 1"]) -> Bool[Tensor, "n 1"]:
        """Whether a frame is due in a step: those of the first are."""
        per_step = min(self.rate_hz * self.dt_s, 1.0)
        late = 1e-3  # step * per_step is rounded
        return ((clock * per_step + late).floor() > ((clock - 1) * per_step + late).floor()) | (
            clock == 0
        )

    def _pose(self, flown: Float[Tensor, "n b 10"]) -> tuple[Tensor, Tensor]:
        """Position and attitude when the frame that arrives now was taken."""
        later, earlier = flown[:, self.whole], flown[:, self.whole + 1]
        if not self.part:
            return later[:, :3], later[:, 6:]
        s = 1 - self.part  # from the earlier step to the later one
        position = (
            (1 + 2 * s) * (1 - s) ** 2 * earlier[:, :3]
            + s * (1 - s) ** 2 * self.dt_s * earlier[:, 3:6]
            + s * s * (3 - 2 * s) * later[:, :3]
            - s * s * (1 - s) * self.dt_s * later[:, 3:6]
        )
        one, other = later[:, 6:], earlier[:, 6:]
        other = torch.where((one * other).sum(-1, keepdim=True) < 0, -other, other)
        return position, normalize(s * one + (1 - s) * other)
