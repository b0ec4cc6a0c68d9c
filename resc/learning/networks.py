"""Policy and value networks, as TorchRL modules over TensorDict keys."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.modules import IndependentNormal, ProbabilisticActor, ValueOperator

from resc.errors import ConfigError

ACTIVATIONS = {"tanh": nn.Tanh, "relu": nn.ReLU, "elu": nn.ELU}


class GaussianHead(nn.Module):
    """Mean and standard deviation of the action; the latter is the same everywhere."""

    def __init__(self, body: nn.Module, width: int, initial_std: float) -> None:
        super().__init__()
        self.body = body
        self.log_std = nn.Parameter(torch.full((width,), initial_std).log())

    def forward(
        self, observation: Float[Tensor, "*n d"]
    ) -> tuple[Float[Tensor, "*n a"], Float[Tensor, "*n a"]]:
        """Mean and standard deviation, in action units."""
        mean = self.body(observation)
        return mean, self.log_std.exp().expand_as(mean)


@dataclass(frozen=True)
class Networks:
    """The policy `actor` and the value function `critic`; they share nothing."""

    actor: ProbabilisticActor
    critic: ValueOperator

    @property
    def head(self) -> GaussianHead:
        """The policy without its distribution."""
        # A sequence does not tell what its modules wrap; `build_networks` put the head there.
        return self.actor[0].module  # pyright: ignore[reportReturnType]

    def parameters(self) -> list[nn.Parameter]:
        """All weights, policy first."""
        return [*self.actor.parameters(), *self.critic.parameters()]

    def to(self, device: torch.device | str) -> "Networks":
        """Moves both in place."""
        self.actor.to(device)
        self.critic.to(device)
        return self


def build_networks(
    *,
    hidden: Sequence[int],
    activation: str = "tanh",
    initial_std: float = 0.6,
    observation_width: int,
    action_width: int,
    seed: int = 0,
) -> Networks:
    """Two multilayer perceptrons with orthogonal weights.

    Args:
        hidden: Width of each hidden layer.
        activation: tanh, relu or elu.
        initial_std: Standard deviation of the actions at the start, in action units.
        observation_width: Length of the observation.
        action_width: Length of the action.
        seed: Of the initial weights.
    """
    if activation not in ACTIVATIONS:
        raise ConfigError(
            f"activation is '{activation}'; expected one of {', '.join(ACTIVATIONS)}."
        )
    if initial_std <= 0 or min(hidden, default=1) < 1:
        raise ConfigError("initial_std and every hidden width must be above zero.")
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        body = _perceptron(observation_width, hidden, action_width, activation, gain=0.01)
        value = _perceptron(observation_width, hidden, 1, activation, gain=1.0)
    head = TensorDictModule(
        GaussianHead(body, action_width, initial_std), ["observation"], ["loc", "scale"]
    )
    actor = ProbabilisticActor(
        head, in_keys=["loc", "scale"], distribution_class=IndependentNormal, return_log_prob=True
    )
    return Networks(actor, ValueOperator(value, in_keys=["observation"]))


def _perceptron(
    inputs: int, hidden: Sequence[int], outputs: int, activation: str, gain: float
) -> nn.Sequential:
    layers: list[nn.Module] = []
    widths = [inputs, *hidden]
    for before, after in itertools.pairwise(widths):
        layers += [_linear(before, after, 2**0.5), ACTIVATIONS[activation]()]
    return nn.Sequential(*layers, _linear(widths[-1], outputs, gain))


def _linear(inputs: int, outputs: int, gain: float) -> nn.Linear:
    layer = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer
