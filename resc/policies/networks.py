"""Networks: what normalises an observation, and the models that policies and values are made of."""

import itertools
from collections.abc import Sequence
from typing import Annotated, Protocol, runtime_checkable

import torch
from jaxtyping import Float
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor, nn
from torchrl.modules import GRUModule

from resc import ranks
from resc.errors import ConfigError
from resc.process import require_memory
from resc.quantities import Within

Width = Annotated[int, Within(1, 10_000)]
EPSILON = 1e-8
BOUND = 10.0
COPIES = 8
"""Of the weights in memory: policy and value, each with its gradient and Adam's two moments."""
NORMALIZED, MEMORY, FEATURES = "normalized", "memory", "features"
"""Keys between the modules of a policy."""
STATE, IS_INIT = "policy_state", "is_init"
"""Keys of a recurrent policy: what it remembers, and whether an episode begins."""


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
        """Adds a batch, with those of all ranks, to the statistics, in place (Chan et al. 1979)."""
        batch = observation.flatten(0, -2).double()
        samples = len(batch) * ranks.count()
        if ranks.count() == 1:
            variance, mean = torch.var_mean(batch, 0, correction=0)
        else:
            mean, squares = ranks.moments(batch)
            variance = squares / samples
        total = self.count + samples
        share = samples / total
        step = mean - self.mean
        spread = self.variance * (1 - share) + variance * share + step**2 * share * (1 - share)
        self.variance.copy_(spread)
        self.mean += step * share
        self.count.copy_(total)


NORMALIZATIONS = {"none": nn.Identity, "running": RunningNormalization}


@runtime_checkable
class Model(Protocol):
    """What the networks of a run are made of; the algorithm says which it needs.

    `state_width` is how many numbers the policy remembers from step to step, 0 for none.
    """

    state_width: int

    def policy(self, inputs: int, outputs: int, gain: float) -> Sequence[TensorDictModuleBase]:
        """Modules from the key `normalized` to the key `features`."""
        ...

    def value(self, inputs: int, outputs: int = 1) -> nn.Module:
        """A function of numbers side by side [*n, inputs], without memory."""
        ...

    def normalizer(self, width: int) -> nn.Module:
        """What comes before both."""
        ...


class Mlp:
    """Multilayer perceptrons with orthogonal weights, one for the policy and one for each value.

    Args:
        hidden: Width of each hidden layer.
        activation: tanh, relu or elu.
        normalization: Of the observation: none, or running (mean 0 and variance 1 by column, from
            what training has seen). Fixed factors are each observation's `scale`.
    """

    state_width = 0

    def __init__(
        self, *, hidden: Sequence[Width], activation: str = "tanh", normalization: str = "none"
    ) -> None:
        if activation not in ACTIVATIONS:
            raise ConfigError(
                f"activation is '{activation}'; expected one of {', '.join(ACTIVATIONS)}."
            )
        if normalization not in NORMALIZATIONS:
            raise ConfigError(
                f"normalization is '{normalization}'; expected one of {', '.join(NORMALIZATIONS)}."
            )
        if min(hidden, default=1) < 1:
            raise ConfigError("every hidden width must be above zero.")
        self.hidden = list(hidden)
        self.activation = activation
        self.normalization = normalization

    def policy(self, inputs: int, outputs: int, gain: float) -> Sequence[TensorDictModuleBase]:
        """One module from the normalised observation to the features."""
        body = self._perceptron(inputs, outputs, gain)
        return [TensorDictModule(body, [NORMALIZED], [FEATURES])]

    def value(self, inputs: int, outputs: int = 1) -> nn.Module:
        """A perceptron of the same hidden layers."""
        return self._perceptron(inputs, outputs, gain=1.0)

    def normalizer(self, width: int) -> nn.Module:
        """What comes before both."""
        return NORMALIZATIONS[self.normalization](width)

    def _perceptron(self, inputs: int, outputs: int, gain: float) -> nn.Sequential:
        widths = [inputs, *self.hidden]
        weights = sum(a * b for a, b in itertools.pairwise([*widths, outputs]))
        require_memory(
            4.0 * weights * COPIES, f"hidden is {self.hidden}", "take narrower or fewer layers"
        )
        layers: list[nn.Module] = []
        for before, after in itertools.pairwise(widths):
            layers += [_linear(before, after, 2**0.5), ACTIVATIONS[self.activation]()]
        return nn.Sequential(*layers, _linear(widths[-1], outputs, gain))


class Gru(Mlp):
    """A policy that remembers: a gated recurrent unit, and a perceptron that reads its state.

    Value functions have no memory; what they cannot see in the observation of the moment, give them
    by `observation_critic`. The memory is empty where an episode begins.

    Args:
        width: Numbers remembered.
        hidden: Width of each hidden layer after the memory, and of those of value functions.
        activation: tanh, relu or elu.
        normalization: As of `Mlp`.
    """

    def __init__(
        self,
        *,
        width: Width,
        hidden: Sequence[Width],
        activation: str = "tanh",
        normalization: str = "none",
    ) -> None:
        super().__init__(hidden=hidden, activation=activation, normalization=normalization)
        self.state_width = width

    def policy(self, inputs: int, outputs: int, gain: float) -> Sequence[TensorDictModuleBase]:
        """The memory, which reads `policy_state` and `is_init`, then the perceptron."""
        memory = GRUModule(
            input_size=inputs,
            hidden_size=self.state_width,
            in_keys=[NORMALIZED, STATE, IS_INIT],
            out_keys=[MEMORY, ("next", STATE)],
        )
        reading = self._perceptron(self.state_width, outputs, gain)
        return [memory, TensorDictModule(reading, [MEMORY], [FEATURES])]


def _linear(inputs: int, outputs: int, gain: float) -> nn.Linear:
    layer = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer
