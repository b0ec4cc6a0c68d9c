"""An observation of one's own, from the same file, in the place of another.

python examples/own_observation.py
"""

import torch
from jaxtyping import Float
from torch import Tensor

import resc
from resc import keys
from resc.term import Observation


class ToGoal(Observation):
    """Last control point minus position [m]; the first two numbers turn with the vehicle."""

    reads = (keys.ROUTE_W, keys.POSITION_W)
    columns = ("x", "y", "z")

    def compute(
        self, route: Float[Tensor, "n k 3"], position: Float[Tensor, "n 3"]
    ) -> Float[Tensor, "n 3"]:
        return route[:, -1] - position


def main(num_envs: int = 4) -> Tensor:
    """Prints what one vehicle sees at the start; returns what all see [num_envs, width]."""
    env = resc.make_env(
        f"allowed_targets=[{__name__}.]",
        "observation=[velocity,attitude,body_rate,heights,control_points]",
        "obstacle_observation=none",
        f"+observation.to_goal._target_={__name__}.ToGoal",
        "+observation.to_goal.scale=0.2",
        num_envs=num_envs,
    )
    observation = env.restart(torch.arange(num_envs))
    for name, number in zip(env.stages.observation_columns, observation[0].tolist(), strict=True):
        print(f"{name}: {number:+.3f}")
    return observation


if __name__ == "__main__":
    main()
