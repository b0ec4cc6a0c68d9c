"""Soft actor-critic (Haarnoja et al. 2018) on TorchRL's loss."""

from typing import cast

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor
from torchrl.objectives import SACLoss
from torchrl.objectives.common import LossModule

from resc.learning.off_policy import OffPolicy
from resc.policies.heads import Head, TanhGaussian
from resc.policies.networks import STATE
from resc.quantities import Number, Positive


class Sac(OffPolicy):
    """A stochastic policy that is paid for staying so, with two value functions.

    Args:
        target_entropy: Of the policy, per action [nat]; the bonus is tuned to reach it.
        initial_bonus: Weight of the entropy at the start.
        **options: Those of `OffPolicy`.
    """

    def __init__(
        self, *, target_entropy: Number = -1.0, initial_bonus: Positive = 0.1, **options: object
    ) -> None:
        self.target_entropy, self.initial_bonus = target_entropy, initial_bonus
        super().__init__(**options)  # pyright: ignore[reportArgumentType]

    @property
    def head(self) -> Head:
        """A squashed Gaussian."""
        return TanhGaussian(self.context.action_width)

    def make_loss(self, actor: TensorDictModuleBase, value: TensorDictModule) -> LossModule:
        """TorchRL's, with two value functions and their targets."""
        loss = SACLoss(
            actor,  # pyright: ignore[reportArgumentType]
            value,
            num_qvalue_nets=2,
            alpha_init=self.initial_bonus,
            target_entropy=self.target_entropy * self.context.action_width,
            loss_function="l2",
        )
        assert loss.target_entropy is not None  # TorchRL registers it when it is first asked for
        return loss

    def losses(self, sample: TensorDict) -> dict[str, Tensor]:
        """Of the policy, of the values and of the entropy's weight."""
        out = self.loss(sample)
        names = {"loss_actor": "loss/policy", "loss_qvalue": "loss/value"}
        names |= {"loss_alpha": "loss/bonus", "alpha": "policy/bonus", "entropy": "policy/entropy"}
        return {ours: cast(Tensor, out[theirs]) for theirs, ours in names.items()}

    @torch.no_grad()
    def explore(self, seen: TensorDict) -> TensorDict:
        """A draw from the policy."""
        moments = self.policy[:-1](seen.copy())
        loc, scale = moments["loc"], moments["scale"]
        noise = torch.randn(loc.shape, generator=self.noise, device=loc.device)
        chosen = TensorDict({"action": torch.tanh(loc + scale * noise)}, seen.batch_size)
        if self.policy.state_width:
            chosen["next", STATE] = moments["next", STATE]
        return chosen
