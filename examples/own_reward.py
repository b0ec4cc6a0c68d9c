"""A reward of one's own, from the same file: nothing is registered, one class is allowed by name.

python examples/own_reward.py
"""

import torch
from jaxtyping import Float
from torch import Tensor

import resc
from resc import keys
from resc.term import Reward


class Gentle(Reward):
    """-|omega|^2 [rad^2/s^2]: turning slowly."""

    reads = (keys.BODY_RATE_B,)

    def compute(self, body_rate: Float[Tensor, "n 3"]) -> Tensor:
        return -body_rate.square().sum(-1, keepdim=True)


def main(num_envs: int = 64, steps: int = 50) -> Tensor:
    """Flies the shipped policy; returns what the new term paid in each step [num_envs, steps]."""
    env = resc.make_env(
        f"allowed_targets=[{__name__}.]",
        "reward=[progress,time,crash]",
        f"+reward.gentle._target_={__name__}.Gentle",
        "+reward.gentle.weight=0.05",
        num_envs=num_envs,
    )
    policy = resc.load_policy("policies/obstacles")
    names = [term.name for term in env.stages.terms.rewards]
    paid, observation = [], env.restart(torch.arange(num_envs))
    for _ in range(steps):
        out = env.advance(policy(observation))
        paid.append(out.reward_terms)
        observation = env.restart(out.done[:, 0].nonzero()[:, 0])
    each = torch.stack(paid, 1)
    for name, mean in zip(names, each.mean((0, 1)).tolist(), strict=True):
        print(f"{name}: {mean:+.3f} a step")
    return each[..., names.index("gentle")]


if __name__ == "__main__":
    main()
