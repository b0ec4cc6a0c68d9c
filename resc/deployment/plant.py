"""A simulated vehicle that takes body rates and thrust, and can hold its position."""

import numpy as np
import torch
from jaxtyping import Float

from resc import keys
from resc.deployment.odometry import Odometry, matrix
from resc.envs.quadrotor import QuadrotorEnv
from resc.simulation.vehicle import GRAVITY_MPS2

STIFFNESS, DAMPING = 1.5, 2.0
"""Of the hold: 1/s^2 and 1/s."""
PUSH_MPS2 = 3.0
"""Its greatest horizontal acceleration."""
REHEARSED = 10
"""Steps before real time begins."""
TILT_GAIN, RATE_RADPS = 6.0, 2.0


class Plant:
    """The rate loop and the dynamics of an environment's only row.

    Args:
        env: The vehicle, its rate loop and its dynamics; its step is that of the simulation.
    """

    def __init__(self, env: QuadrotorEnv) -> None:
        env.restart(torch.arange(1))
        self.stages, self.world = env.stages, env.tensors
        self.vehicle = env.stages.context.vehicle
        self.dt_s = env.stages.context.dt_s
        self.generator = torch.Generator().manual_seed(0)
        begun = self.world
        for _ in range(REHEARSED):  # first times are slow, and real time does not wait
            self.step(*self.holding(self.state().position_w))
        self.world = begun

    def state(self, stamp_s: float = 0.0) -> Odometry:
        """Where it is and how it moves."""
        named = (keys.POSITION_W, keys.VELOCITY_W, keys.ATTITUDE_WB, keys.BODY_RATE_B)
        return Odometry(stamp_s, *(self.world[key][0].double().numpy() for key in named))

    @torch.no_grad()
    def step(self, rates_flu: Float[np.ndarray, "3"], throttle: float) -> None:
        """One step under a command."""
        thrust = 4 * self.vehicle.thrust(torch.tensor([[throttle]], dtype=torch.float32))
        tensors = {
            **self.world,
            keys.COLLECTIVE_THRUST: thrust.clamp(min=0),
            keys.BODY_RATE_COMMAND_B: torch.from_numpy(rates_flu.astype(np.float32))[None],
        }
        drawn = {
            name: torch.rand(1, width, generator=self.generator)
            for name, width in self.stages.step_draws.items()
        }
        self.stages.move(tensors, drawn)
        self.world = {key: tensors[key] for key in self.world}

    def holding(self, place_w: Float[np.ndarray, "3"]) -> tuple[Float[np.ndarray, "3"], float]:
        """Body rates and throttle that bring it to a place and keep it there."""
        state = self.state()
        push = STIFFNESS * (place_w - state.position_w) - DAMPING * state.velocity_w
        push = push.clip(-PUSH_MPS2, PUSH_MPS2) + np.array([0, 0, GRAVITY_MPS2])
        wanted_b = matrix(state.attitude_wb).T @ (push / np.linalg.norm(push))
        rates = TILT_GAIN * np.array([-wanted_b[1], wanted_b[0], 0.0])
        thrust_n = self.vehicle.mass_kg * float(push @ state.up_b)
        throttle = self.vehicle.throttle(torch.tensor(max(thrust_n, 0.0) / 4))
        return rates.clip(-RATE_RADPS, RATE_RADPS), float(throttle)
