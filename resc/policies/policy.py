"""A policy is one module: the same object trains, evaluates, records and clones."""

from typing import cast

import torch
from jaxtyping import Float
from tensordict import TensorDict
from tensordict.nn import (
    ProbabilisticTensorDictSequential,
    TensorDictModule,
    TensorDictModuleBase,
)
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType, set_exploration_type

from resc.policies.heads import Head
from resc.policies.networks import IS_INIT, NORMALIZED, STATE, Model

OBSERVATION, ACTION = "observation", "action"
OBSERVATION_CRITIC = "observation_critic"
"""What the value function alone sees."""


class Policy(ProbabilisticTensorDictSequential):
    """TensorDict in, TensorDict out: normalisation, network, head, and the draw of an action.

    Reads `observation` [*n, d]; writes `action` [*n, a], drawn or, under TorchRL's
    `ExplorationType.DETERMINISTIC`, its most likely value. One that remembers also reads
    `policy_state` [*n, 1, m] and `is_init` [*n, 1], and writes `("next", "policy_state")`.

    Args:
        model: Makes normalisation and network.
        head: Makes the distribution.
        observation_width: Length of the observation.
        gain: Of the network's last layer; a small one begins near the middle of the action space.
    """

    def __init__(
        self, model: Model, head: Head, observation_width: int, gain: float = 0.01
    ) -> None:
        normalization = model.normalizer(observation_width)
        modules: list[TensorDictModuleBase] = [
            TensorDictModule(normalization, [OBSERVATION], [NORMALIZED]),
            *model.policy(observation_width, head.inputs, gain),
            *head.modules_of_policy,
        ]
        super().__init__(*modules)  # pyright: ignore[reportCallIssue, reportArgumentType]
        self.state_width = model.state_width
        self.observation_width = observation_width
        self.action_width = head.width

    @property
    def normalization(self) -> nn.Module:
        """What the observation goes through first."""
        return cast(nn.Module, self[0].module)

    @property
    def network(self) -> nn.Module:
        """Its last part before the head: from normalised observations, or from the memory."""
        return cast(nn.Module, self[-3].module)

    @property
    def head(self) -> Head:
        """From features to the numbers of a distribution."""
        return cast(Head, self[-2].module)

    def first_state(self, count: int) -> Float[Tensor, "n 1 m"] | None:
        """What it remembers at the beginning of `count` episodes; None if it remembers nothing."""
        if not self.state_width:
            return None
        device = next(self.parameters()).device
        return torch.zeros(count, 1, self.state_width, device=device)

    @torch.no_grad()
    def decide(
        self, observation: Float[Tensor, "*n d"], state: Float[Tensor, "n 1 m"] | None = None
    ) -> tuple[Float[Tensor, "*n a"], Float[Tensor, "n 1 m"] | None]:
        """The most likely action, clipped to [-1, 1], and what to remember until the next step.

        `state` is None at the first step of an episode, and always for one that remembers nothing.
        """
        tensors = TensorDict({OBSERVATION: observation}, [len(observation)])
        if self.state_width:
            first = self.first_state(len(observation)) if state is None else state
            began = torch.zeros(len(observation), 1, dtype=torch.bool, device=observation.device)
            tensors = tensors.update({STATE: first, IS_INIT: began})
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            out = self(tensors)
        following = cast(Tensor, out["next", STATE]) if self.state_width else None
        return cast(Tensor, out[ACTION]).clamp(-1, 1), following
