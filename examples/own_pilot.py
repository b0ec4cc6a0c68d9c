"""A planner of one's own as a pilot: a force away from obstacles and one along the route.

python examples/own_pilot.py
"""

import torch
from jaxtyping import Float
from tensordict import TensorDictBase
from torch import Tensor

import resc
from resc import keys
from resc.envs.stages import Stages, World
from resc.flying.flights import fly
from resc.flying.pilot import Pilot
from resc.flying.pursuit import Pursuit

K_M2 = 0.3


class PotentialField(Pilot):
    """Plans a point ahead in every step, and leaves flying there to a controller.

    It is p + (p_next - p) / |p_next - p| + K sum (p - b) / d^3: b is nearest on a box, d away.
    """

    def begin(self, flights: int, stages: Stages, maps: World) -> None:
        """Takes the boxes of all scenes; the controller forgets the last flights."""
        self.controller = Pursuit(speed_mps=1.5)
        self.controller.begin(flights, stages, maps)
        self.boxes = maps[keys.BOXES_W]

    def act(self, world: TensorDictBase, observation: Float[Tensor, "n d"]) -> Float[Tensor, "n 4"]:
        """Replaces the route by the planned point, then follows it."""
        position, route = world[keys.POSITION_W], world[keys.ROUTE_W]
        next_point = world[keys.ROUTE_INDEX][:, 0].clamp(max=route.shape[1] - 1)
        ahead = route[torch.arange(len(route)), next_point] - position
        corner, size = self.boxes[world[keys.SCENE_INDEX][:, 0]].split(2, -1)  # [n, boxes, 2]
        away = position[:, None, :2] - position[:, None, :2].clamp(corner, corner + size)
        distance = away.norm(dim=-1, keepdim=True).clamp(min=0.1)
        aim = torch.nn.functional.normalize(ahead, dim=-1)
        aim[:, :2] += K_M2 * (away / distance**3).sum(1)
        first = torch.zeros_like(world[keys.ROUTE_INDEX])
        planned = world.copy()
        planned[keys.ROUTE_W], planned[keys.ROUTE_INDEX] = (position + aim)[:, None], first
        self.controller.start = None  # the route of this step begins at the vehicle
        return self.controller.act(planned, observation)


def main(num_envs: int = 64) -> float:
    """Flies it among boxes; returns the share of flights that arrive."""
    env = resc.make_env("scene=training", num_envs=num_envs)
    flights = fly(env, PotentialField())
    print(f"{flights.success_rate:.0%} arrive, {flights.collision_rate:.0%} collide")
    return flights.success_rate


if __name__ == "__main__":
    main()
