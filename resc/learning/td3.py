"""Twin delayed deterministic policy gradient (Fujimoto et al. 2018) on TorchRL's loss."""

from typing import Any, cast

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor
from torchrl.objectives import TD3Loss
from torchrl.objectives.common import LossModule

from resc.learning.off_policy import OffPolicy
from resc.policies.heads import Deterministic, Head
from resc.policies.networks import STATE
from resc.quantities import Count, NotNegative


class Td3(OffPolicy):
    """A deterministic policy that explores by noise, with two value functions.

    Args:
        exploration: Standard deviation of the noise, in action units.
        smoothing: Standard deviation of the noise on target actions.
        smoothing_clip: Greatest magnitude of that.
        delay: Gradient steps of the values for each of the policy.
        **options: Those of `OffPolicy`.
    """

    def __init__(
        self,
        *,
        exploration: NotNegative = 0.2,
        smoothing: NotNegative = 0.2,
        smoothing_clip: NotNegative = 0.5,
        delay: Count = 2,
        **options: object,
    ) -> None:
        self.exploration, self.delay = exploration, delay
        self.smoothing, self.smoothing_clip = smoothing, smoothing_clip
        super().__init__(**options)  # pyright: ignore[reportArgumentType]
        self.taken = 0  # gradient steps

    @property
    def head(self) -> Head:
        """A squashed action."""
        return Deterministic(self.context.action_width)

    def make_loss(self, actor: TensorDictModuleBase, value: TensorDictModule) -> LossModule:
        """TorchRL's, with two value functions, and targets of all three networks."""
        return TD3Loss(
            actor,  # pyright: ignore[reportArgumentType]
            value,
            bounds=(-1.0, 1.0),  # pyright: ignore[reportArgumentType]
            num_qvalue_nets=2,
            policy_noise=self.smoothing,
            noise_clip=self.smoothing_clip,
            loss_function="l2",
        )

    def losses(self, sample: TensorDict) -> dict[str, Tensor]:
        """Of the values, and every `delay` steps of the policy."""
        loss = cast(TD3Loss, self.loss)
        value, figures = loss.value_loss(sample)
        found = {"loss/value": value, "value/mean": figures["pred_value"].mean()}
        self.taken += 1
        policy, _ = loss.actor_loss(sample)
        return found | {"loss/policy": policy if self.taken % self.delay == 0 else policy.detach()}

    @torch.no_grad()
    def explore(self, seen: TensorDict) -> TensorDict:
        """The policy's action and noise."""
        moments = self.policy[:-1](seen.copy())
        wanted = torch.tanh(cast(Tensor, moments["param"]))
        noise = torch.randn(wanted.shape, generator=self.noise, device=wanted.device)
        action = (wanted + self.exploration * noise).clamp(-1, 1)
        chosen = TensorDict({"action": action}, seen.batch_size)
        if self.policy.state_width:
            chosen["next", STATE] = moments["next", STATE]
        return chosen

    def state_dict(self) -> dict[str, Any]:
        """As of `OffPolicy`, and the gradient steps taken."""
        return super().state_dict() | {"taken": self.taken}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Takes what `state_dict` gave."""
        super().load_state_dict(state)
        self.taken = state["taken"]
