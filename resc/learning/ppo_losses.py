"""The arithmetic of PPO: what is drawn from a policy, and the losses of a minibatch.

TorchRL's modules and losses give the same numbers (tested), and cost milliseconds a minibatch more.
"""

import math

import torch
from torch import Tensor

HALF_LOG_2_PI = 0.5 * math.log(2 * math.pi)
Figures = tuple[Tensor, ...]
"""A total to minimise; then policy and value loss, entropy, divergence, share clipped."""
Moments = tuple[Tensor, Tensor]
"""Mean and standard deviation of the advantages of a minibatch []."""


def draw_action(mean: Tensor, std: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
    """An action and its log probability [n], from standard normal noise."""
    action = mean + std * noise
    return action, (-0.5 * noise.square() - std.log() - HALF_LOG_2_PI).sum(-1)


def losses(
    mean: Tensor,
    std: Tensor,
    value: Tensor,
    action: Tensor,
    before: Tensor,
    advantage: Tensor,
    target: Tensor,
    *,
    shared: Moments | None,
    clip_epsilon: float,
    value_coefficient: float,
    entropy_coefficient: float,
) -> Figures:
    """The sum to minimise; then policy and value loss, entropy, divergence, share clipped.

    What TorchRL's `ClipPPOLoss` computes (Schulman et al. 2017, eq. 7 and 9; advantages
    normalised, by their own moments unless told those of all ranks).
    """
    log_std = std.log()
    now = -(0.5 * ((action - mean) / std).square() + log_std + HALF_LOG_2_PI)
    change = now.sum(-1, keepdim=True) - before
    clip = math.log1p(-clip_epsilon), math.log1p(clip_epsilon)
    clipped = change.clamp(*clip)
    centre, spread = (advantage.mean(), advantage.std()) if shared is None else shared
    advantage = (advantage - centre) / spread.clamp(min=1e-6)
    gain = torch.minimum(change.exp() * advantage, clipped.exp() * advantage)
    policy = -gain.mean()
    error = value - target
    value_loss = value_coefficient * error.square().mean()
    entropy = (log_std + HALF_LOG_2_PI + 0.5).sum(-1).mean()
    total = policy + value_loss - entropy_coefficient * entropy
    share = (clipped != change).float().mean()
    return total, policy, value_loss, entropy, -change.mean(), share
