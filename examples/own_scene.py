"""A scene of one's own, from the same file: other obstacles between the same start and goal.

python examples/own_scene.py
"""

import torch
from torch import Tensor

import resc
from resc import keys
from resc.scenes.family import Obstacles, no_pillars
from resc.scenes.random_maps import RandomMaps


class Slalom(RandomMaps):
    """Walls across the way, by turns from the left and from the right; their number is given."""

    def __init__(self, *, walls: int = 3, gap_m: float = 2.0) -> None:
        super().__init__(
            origin_m=(0.0, 0.0),
            size_m=(14.0, 6.0),
            start_m=(1.0, 3.0, 1.0),
            goal_m=(13.0, 3.0, 1.0),
        )
        self.walls, self.gap_m = walls, gap_m

    def obstacles(self, count: int, generator: torch.Generator) -> Obstacles:
        """Boxes [x, y, length in x, length in y] of so many maps, a little shifted on each."""
        x = torch.linspace(3.0, 11.0, self.walls) + torch.rand(count, 1, generator=generator) - 0.5
        length = torch.full_like(x, 6.0 - self.gap_m)
        y = torch.where(torch.arange(self.walls) % 2 == 0, 0.0, self.gap_m).expand_as(x)
        return Obstacles(
            torch.stack((x, y, torch.full_like(x, 0.3), length), -1), no_pillars(count)
        )


def main(num_envs: int = 8, walls: int = 3) -> Tensor:
    """Prints where the route leads; returns how many control points each row has [num_envs]."""
    env = resc.make_env(
        f"allowed_targets=[{__name__}.]",
        "~scene",
        f"+scene._target_={__name__}.Slalom",
        f"+scene.walls={walls}",
        num_envs=num_envs,
        pool_size=num_envs,
    )
    env.restart(torch.arange(num_envs))
    length = env.world[keys.ROUTE_LENGTH][:, 0]
    for point in env.world[keys.ROUTE_W][0, : length[0]].tolist():
        print("control point at ({:.1f}, {:.1f}, {:.1f}) m".format(*point))
    return length


if __name__ == "__main__":
    main()
