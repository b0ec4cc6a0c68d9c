"""Collective thrust and body rates: the published action."""

from collections.abc import Sequence
from typing import Annotated

import torch
from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.quantities import CountOrNone, NotNegative, Positive, Within
from resc.term import Action, Channel, Context

FASTEST_RADPS = 100.0
"""No quadrotor turns faster; a greater limit is degrees by mistake."""


class BodyRateThrust(Action):
    """Commanded body rates [rad/s] and collective thrust [N].

    From the action a = [p, q, r, thrust], clipped to [-1, 1]: omega = a_0..2 * limit;
    F = m g ((a_3 + 1) / 2 (high - low) + low), so a_3 = 0 hovers when low + high = 2 (facts 2.3).
    The action waits in a queue for as many steps as the environment's delay, at most
    `longest_delay_steps`.

    Args:
        rate_limit_radps: Largest roll, pitch and yaw rate.
        thrust_range_g: Least and greatest collective thrust in units of the nominal weight.
        gravity_mps2: Weight per mass in the thrust command; the published conversions use 9.7946.
        longest_delay_steps: Length of the queue.
    """

    reads = (keys.ACTION, keys.ACTION_QUEUE, keys.ACTION_DELAY)
    writes = (keys.ACTION_QUEUE, keys.BODY_RATE_COMMAND_B, keys.COLLECTIVE_THRUST)
    width = 4
    limit: Tensor

    def __init__(
        self,
        *,
        rate_limit_radps: Sequence[Annotated[float, Within(0, FASTEST_RADPS, above=True)]],
        thrust_range_g: Sequence[NotNegative],
        gravity_mps2: Positive = 9.7946,
        longest_delay_steps: CountOrNone = 3,
    ) -> None:
        super().__init__()
        if len(rate_limit_radps) != 3:
            raise ConfigError(
                f"rate_limit_radps is {list(rate_limit_radps)}; expected 3 numbers, one per axis."
            )
        if len(thrust_range_g) != 2 or not 0 <= thrust_range_g[0] < thrust_range_g[1]:
            raise ConfigError(
                f"thrust_range_g is {list(thrust_range_g)}; expected [low, high], 0 <= low < high."
            )
        if longest_delay_steps < 0:
            raise ConfigError(f"longest_delay_steps is {longest_delay_steps}; expected 0 or more.")
        self.register_buffer(
            "limit", torch.tensor(list(rate_limit_radps), dtype=torch.float32), persistent=False
        )
        self.thrust_range_g = tuple(thrust_range_g)
        self.gravity_mps2 = gravity_mps2
        self.longest_delay_steps = longest_delay_steps
        self.dims = {"d": longest_delay_steps + 1}
        self.initial = {keys.ACTION_QUEUE: 0.0}
        self.weight_n = 0.0

    def bind(self, context: Context) -> None:
        """Takes the nominal weight: the command does not know of randomised masses."""
        self.weight_n = context.vehicle.mass_kg * self.gravity_mps2

    @property
    def channels(self) -> Sequence[Channel]:
        """Body rates [rad/s] about the forward, the left and the upward axis; thrust [N]."""
        low, high = (self.weight_n * factor for factor in self.thrust_range_g)
        names = ("roll_rate", "pitch_rate", "yaw_rate")
        rates = [
            Channel(name, "rad/s", "body", 0.0, limit)
            for name, limit in zip(names, self.limit.tolist(), strict=True)
        ]
        return [*rates, Channel("thrust", "N", "body", (low + high) / 2, (high - low) / 2)]

    def compute(
        self,
        action: Float[Tensor, "n 4"],
        queue: Float[Tensor, "n d 4"],
        delay: Float[Tensor, "n 1"],
    ) -> tuple[Float[Tensor, "n d 4"], Float[Tensor, "n 3"], Float[Tensor, "n 1"]]:
        queue = torch.cat((action.clamp(-1, 1).unsqueeze(1), queue[:, :-1]), 1)
        age = torch.arange(queue.shape[1], device=queue.device)
        due = age == delay.clamp(max=queue.shape[1] - 1)
        applied = (queue * due.unsqueeze(-1)).sum(1)
        low, high = self.thrust_range_g
        thrust = self.weight_n * ((applied[:, 3:] + 1) / 2 * (high - low) + low)
        return queue, applied[:, :3] * self.limit, thrust

    def commanding(
        self, body_rate: Float[Tensor, "n 3"], thrust: Float[Tensor, "n 1"]
    ) -> Float[Tensor, "n 4"]:
        """The action that commands these body rates [rad/s] and thrusts [N], as far as it can."""
        low, high = self.thrust_range_g
        throttle = 2 * (thrust / self.weight_n - low) / (high - low) - 1
        return torch.cat((body_rate / self.limit, throttle), -1).clamp(-1, 1)
