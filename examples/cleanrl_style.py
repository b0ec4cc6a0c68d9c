"""PPO in one file, in the style of CleanRL, over Gymnasium's VectorEnv.

python examples/cleanrl_style.py
"""

import gymnasium
import numpy as np
import torch
from torch import nn
from torch.distributions import Normal
from torchrl.objectives.value.functional import generalized_advantage_estimate

import resc  # noqa: F401 - tells Gymnasium of resc/Flight-v0

FREE = {"overrides": ["+experiment=obstacle_free", "reward=[progress,finish]"]}
STEPS, UPDATES, MINIBATCH, GAMMA, GAE_LAMBDA, CLIP, SCALE = 32, 32, 4096, 0.99, 0.95, 0.2, 0.01


def main(num_envs: int = 1024, iterations: int = 100) -> None:
    """Learns to fly without obstacles."""
    envs = gymnasium.make_vec("resc/Flight-v0", num_envs, autoreset_mode="SameStep", **FREE)
    width, size = envs.single_observation_space.shape[0], envs.single_action_space.shape[0]
    actor, critic = (
        nn.Sequential(nn.Linear(width, 64), nn.Tanh(), nn.Linear(64, out)) for out in (size, 1)
    )
    log_std = nn.Parameter(torch.full((size,), -0.5))
    optimizer = torch.optim.Adam([*actor.parameters(), *critic.parameters(), log_std], lr=1e-3)
    seen = torch.from_numpy(envs.reset(seed=0)[0])
    for iteration in range(iterations):
        steps, successes = [], []
        for _ in range(STEPS):
            action = torch.normal(actor(seen), log_std.exp()).detach()
            after, reward, terminated, truncated, info = envs.step(action.numpy())
            following = after.copy()
            if info:  # some flights ended, and their rows show the next flights already
                following[info["_final_obs"]] = np.stack(info["final_obs"][info["_final_obs"]])
                successes += info["final_info"]["is_success"][info["_final_info"]].tolist()
            told = (following, SCALE * reward, terminated, terminated | truncated)
            steps.append((seen, action, *map(torch.from_numpy, told)))
            seen = torch.from_numpy(after)
        seens, actions, followings, *told = map(torch.stack, zip(*steps, strict=True))
        reward, terminated, done = (part.unsqueeze(-1) for part in told)  # [t, n, 1]
        old = Normal(actor(seens), log_std.exp()).log_prob(actions).sum(-1, True).detach()
        flow = (critic(seens).detach(), critic(followings).detach(), reward, done, terminated)
        gains, targets = generalized_advantage_estimate(GAMMA, GAE_LAMBDA, *flow, time_dim=0)
        batch = [x.flatten(0, 1) for x in (seens, actions, old, gains / gains.std(), targets)]
        for part in torch.randint(STEPS * num_envs, (UPDATES, MINIBATCH)):
            o, a, before, gain, target = (x[part] for x in batch)
            ratio = (Normal(actor(o), log_std.exp()).log_prob(a).sum(-1, True) - before).exp()
            clipped = torch.min(ratio * gain, ratio.clamp(1 - CLIP, 1 + CLIP) * gain).mean()
            loss = 0.5 * (critic(o) - target).square().mean() - clipped
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        print(f"{iteration}: {np.mean(successes or 0):.0%} of {len(successes)} flights succeed")


if __name__ == "__main__":
    main()
