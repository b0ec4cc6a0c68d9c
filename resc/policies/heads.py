"""Heads: from the features of a policy's network to a distribution of actions."""

from typing import ClassVar

import torch
from jaxtyping import Float
from tensordict.nn import ProbabilisticTensorDictModule, TensorDictModule, TensorDictModuleBase
from torch import Tensor, nn
from torchrl.modules import IndependentNormal, TanhDelta, TanhNormal

from resc.policies.networks import FEATURES

LEAST_STD, GREATEST_STD = 0.01, 1.0
"""Of a distribution that depends on the observation, before the hyperbolic tangent."""


class Head(nn.Module):
    """Gives the numbers [*n, a] that a distribution of actions is made of.

    Args:
        width: Number of actions.
    """

    distribution: ClassVar[type[torch.distributions.Distribution]]
    parameters_of_distribution: ClassVar[tuple[str, ...]] = ("loc", "scale")

    def __init__(self, width: int) -> None:
        super().__init__()
        self.width = width

    @property
    def inputs(self) -> int:
        """Number of features."""
        return self.width

    @property
    def modules_of_policy(self) -> list[TensorDictModuleBase]:
        """From the key `features` to the key `action`."""
        own = TensorDictModule(self, [FEATURES], list(self.parameters_of_distribution))
        drawn = ProbabilisticTensorDictModule(
            in_keys=list(self.parameters_of_distribution),
            out_keys=["action"],
            distribution_class=self.distribution,
        )
        return [own, drawn]


class Gaussian(Head):
    """Mean and standard deviation of the action; the latter is the same everywhere.

    Ours, not TorchRL's NormalParamExtractor: that one's spread depends on the observation.
    """

    distribution = IndependentNormal

    def __init__(self, width: int, initial_std: float = 1.0) -> None:
        super().__init__(width)
        self.log_std = nn.Parameter(torch.full((width,), initial_std).log())

    def forward(
        self, features: Float[Tensor, "*n a"]
    ) -> tuple[Float[Tensor, "*n a"], Float[Tensor, "*n a"]]:
        """Mean and standard deviation, in action units."""
        return features, self.log_std.exp().expand_as(features)


class TanhGaussian(Head):
    """A Gaussian whose mean and spread depend on the observation, squashed to (-1, 1)."""

    distribution = TanhNormal

    @property
    def inputs(self) -> int:
        """A mean and a spread for each action."""
        return 2 * self.width

    def forward(
        self, features: Float[Tensor, "*n b"]
    ) -> tuple[Float[Tensor, "*n a"], Float[Tensor, "*n a"]]:
        """Location and scale before the hyperbolic tangent."""
        loc, raw = features.chunk(2, -1)
        return loc, LEAST_STD + (GREATEST_STD - LEAST_STD) * torch.sigmoid(raw)


class Deterministic(Head):
    """One action, squashed to (-1, 1); exploring is left to the algorithm."""

    distribution = TanhDelta
    parameters_of_distribution = ("param",)

    def forward(self, features: Float[Tensor, "*n a"]) -> Float[Tensor, "*n a"]:
        """The action before the hyperbolic tangent."""
        return features
