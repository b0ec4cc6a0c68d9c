"""Policy and value networks, as TorchRL modules over TensorDict keys."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import torch
from jaxtyping import Float
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.modules import IndependentNormal, ProbabilisticActor, ValueOperator

from resc.errors import ConfigError
from resc.process import require_memory
from resc.quantities import Positive, Within

EPSILON = 1e-8
BOUND = 10.0
COPIES = 8
"""Of the weights in memory: policy and value, each with its gradient and Adam's two moments."""


class Tanh(nn.Module):
    """tanh(x) = 2 sigmoid(2 x) - 1, to 2e-7: compiled, four times as fast as `torch.tanh`."""

    def forward(self, x: Tensor) -> Tensor:
        """Of each number."""
        return 2 * torch.sigmoid(2 * x) - 1


ACTIVATIONS = {"tanh": Tanh, "relu": nn.ReLU, "elu": nn.ELU}


class RunningNormalization(nn.Module):
    """The observation with mean 0 and variance 1 by column, as far as it has been seen.

    y = clip((x - mean) / sqrt(variance + 1e-8), -10, 10): the constants of Stable-Baselines3. The
    identity until the first `update`. Nothing but `update` changes the statistics: evaluation, a
    resumed run and a policy file use what they load.
    """

    mean: Tensor
    variance: Tensor
    count: Tensor

    def __init__(self, width: int) -> None:
        super().__init__()
        # float64: sums over 1e8 samples
        self.register_buffer("mean", torch.zeros(width, dtype=torch.float64))
        self.register_buffer("variance", torch.ones(width, dtype=torch.float64))
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))

    def forward(self, observation: Float[Tensor, "*n d"]) -> Float[Tensor, "*n d"]:
        """The observation, normalised."""
        inverse_std = (self.variance + EPSILON).rsqrt().to(observation.dtype)
        centred = observation - self.mean.to(observation.dtype)
        return (centred * inverse_std).clamp(-BOUND, BOUND)

    @torch.no_grad()
    def update(self, observation: Float[Tensor, "*n d"]) -> None:
        """Adds a batch to the statistics, in place (Chan et al. 1979)."""
        batch = observation.flatten(0, -2).double()
        variance, mean = torch.var_mean(batch, 0, correction=0)
        total = self.count + len(batch)
        share = len(batch) / total
        step = mean - self.mean
        spread = self.variance * (1 - share) + variance * share + step**2 * share * (1 - share)
        self.variance.copy_(spread)
        self.mean += step * share
        self.count.copy_(total)


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


NORMALIZATIONS = {"none": nn.Identity, "running": RunningNormalization}


@dataclass(frozen=True)
class Networks:
    """The policy `actor` and the value function `critic`; they share nothing but their input.

    That is what `normalization` makes of the observation. It stands before them, not in them, so
    that an update normalises its batch once.
    """

    actor: ProbabilisticActor
    critic: ValueOperator
    normalization: nn.Module = field(default_factory=nn.Identity)

    @property
    def head(self) -> GaussianHead:
        """The policy without its distribution: of normalised observations."""
        # A sequence does not tell what its modules wrap; `build_networks` put the head there.
        return self.actor[0].module  # pyright: ignore[reportReturnType]

    @property
    def policy(self) -> nn.Module:
        """The normalisation, then the head: takes observations as the environment gives them."""
        return nn.Sequential(self.normalization, self.head)

    def parameters(self) -> list[nn.Parameter]:
        """All weights, policy first."""
        return [*self.actor.parameters(), *self.critic.parameters()]

    def to(self, device: torch.device | str) -> "Networks":
        """Moves all in place."""
        self.normalization.to(device)
        self.actor.to(device)
        self.critic.to(device)
        return self


def build_networks(
    *,
    hidden: Sequence[Annotated[int, Within(1, 10_000)]],
    activation: str = "tanh",
    initial_std: Positive = 0.6,
    normalization: str = "none",
    observation_width: int,
    action_width: int,
    seed: int = 0,
) -> Networks:
    """Two multilayer perceptrons with orthogonal weights.

    Args:
        hidden: Width of each hidden layer.
        activation: tanh, relu or elu.
        initial_std: Standard deviation of the actions at the start, in action units.
        normalization: Of the observation: none, or running (mean 0 and variance 1 by column, from
            what training has seen). Fixed factors are each observation's `scale`.
        observation_width: Length of the observation.
        action_width: Length of the action.
        seed: Of the initial weights.
    """
    if activation not in ACTIVATIONS:
        raise ConfigError(
            f"activation is '{activation}'; expected one of {', '.join(ACTIVATIONS)}."
        )
    if normalization not in NORMALIZATIONS:
        raise ConfigError(
            f"normalization is '{normalization}'; expected one of {', '.join(NORMALIZATIONS)}."
        )
    if initial_std <= 0 or min(hidden, default=1) < 1:
        raise ConfigError("initial_std and every hidden width must be above zero.")
    weights = sum(a * b for a, b in itertools.pairwise([observation_width, *hidden, action_width]))
    require_memory(
        4.0 * weights * COPIES, f"hidden is {list(hidden)}", "take narrower or fewer layers"
    )
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
    critic = ValueOperator(value, in_keys=["observation"])
    return Networks(actor, critic, NORMALIZATIONS[normalization](observation_width))


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
