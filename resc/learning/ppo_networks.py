"""What of PPO is compiled: acting, and the gradients of a minibatch of samples."""

from typing import cast

import torch
from torch import Tensor, nn

from resc.learning.algorithm import LearningContext
from resc.learning.flat_adam import side_by_side
from resc.learning.ppo_losses import Figures, Moments, draw_action, losses
from resc.policies.policy import Policy


class PpoNetworks:
    """Policy and value function as functions of tensors.

    They hold networks and numbers alone: a program that is kept holds what its owner holds.

    Args:
        networks: `policy`, `value` and, where the critic sees more, `critic_normalization`.
        weights: Those that are learned.
        context: The run.
        weighting: Settings of the losses.
    """

    def __init__(
        self,
        networks: nn.ModuleDict,
        weights: list[nn.Parameter],
        context: LearningContext,
        weighting: dict[str, float],
    ) -> None:
        self.networks = networks
        self.policy = cast(Policy, networks["policy"])
        self.weights = weights
        self.seen = context.observation_width
        self.widths = (self.seen + context.critic_width, context.action_width, 1, 1, 1)
        self.weighting = weighting

    def valued(self, normal: Tensor, extra: Tensor | None = None) -> Tensor:
        """The value [*n, 1] of normalised observations and of what the critic alone sees."""
        if extra is not None:
            normal = torch.cat((normal, self.networks["critic_normalization"](extra)), -1)
        return self.networks["value"](normal)

    def act(self, observation: Tensor, noise: Tensor, extra: Tensor | None = None) -> Figures:
        """Action, its log probability [n] and the value [n, 1]."""
        normal = self.policy.normalization(observation)
        mean, std = self.policy.head(self.policy.network(normal))
        action, log_prob = draw_action(mean, std, noise)
        return action, log_prob, self.valued(normal, extra)

    def losses(self, samples: Tensor, shared: Moments | None = None) -> Figures:
        """Of samples, as `Ppo` puts them side by side."""
        observation, action, before, advantage, target = samples.split(self.widths, -1)
        mean, std = self.policy.head(self.policy.network(observation[:, : self.seen]))
        value = self.networks["value"](observation)
        given = (mean, std, value, action, before, advantage, target)
        return losses(*given, shared=shared, **self.weighting)

    def gradients(self, samples: Tensor, shared: Moments | None) -> tuple[Tensor, Tensor]:
        """The gradient of the loss of samples, as `taken` gives it, and the loss's figures [5]."""
        return taken(self.losses(samples, shared), self.weights)


def taken(figures: Figures, weights: list[nn.Parameter]) -> tuple[Tensor, Tensor]:
    """The gradient of the first of the figures, by all weights side by side, and the others [5].

    A weight that the loss does not depend on, in a network of one's own, has one of zeros.
    """
    loss, *told = figures
    gradients = torch.autograd.grad(loss, weights, materialize_grads=True)
    return side_by_side(gradients), torch.stack(told).detach()
