"""The protocol of every swappable part: keys in, tensors through `compute`, keys out."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from resc.errors import ConfigError
from resc.keys import NestedKey


@dataclass(frozen=True)
class Context:
    """What a term may know about its surroundings: constants only, never the environment.

    Args:
        dt_s: Control period.
        resolution_m: Edge of a map cell.
        vehicle: Nominal parameters (see `resc.simulation.vehicle.Vehicle`).
    """

    dt_s: float
    resolution_m: float
    vehicle: Any


class Term(TensorDictModuleBase):
    """A pure function from the tensors under `reads` to the tensors under `writes`.

    `writes = ()` means one key named by the configuration, `(group, name)`. Terms hold constants
    only; what must survive a step is written under a key with an `initial` value. `draws` uniform
    numbers per reset environment reach `compute` as its last argument when `draws > 0`.
    """

    reads: ClassVar[tuple[NestedKey, ...]] = ()
    writes: ClassVar[tuple[NestedKey, ...]] = ()
    initial: Mapping[NestedKey, float] = {}
    group: ClassVar[str] = ""
    draws: int = 0
    name: str = ""

    def bind(self, context: Context) -> None:
        """Takes the constants of its surroundings, once, before the first `compute`."""

    def compute(self, *tensors: Tensor) -> Tensor | tuple[Tensor, ...]:
        """The maths, on batched tensors in the order of `reads`."""
        raise ConfigError(
            f"{type(self).__name__} has no compute(); add one that takes {len(self.reads)} tensors."
        )

    def named(self, name: str) -> "Term":
        """Gives the term its configured name and, with it, its keys."""
        self.name = name
        # tensordict annotates its keys as tuples of exactly one string, but takes any length.
        self.in_keys = list(self.reads)  # pyright: ignore[reportAttributeAccessIssue]
        self.out_keys = list(self.outputs)  # pyright: ignore[reportAttributeAccessIssue]
        return self

    @property
    def outputs(self) -> tuple[NestedKey, ...]:
        """The keys it writes, the name filled in."""
        return self.writes or ((self.group, self.name),)

    def run(self, tensors: dict[NestedKey, Tensor], *drawn: Tensor) -> None:
        """Reads from and writes to a flat dict: what the compiled step is made of."""
        result = self.compute(*(tensors[key] for key in self.reads), *drawn)
        values = result if isinstance(result, tuple) else (result,)
        for key, value in zip(self.outputs, values, strict=True):
            tensors[key] = value

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """TensorDict in, TensorDict out: the same as `run`, for tests and notebooks."""
        result = self.compute(*(tensordict[key] for key in self.reads))
        values = result if isinstance(result, tuple) else (result,)
        for key, value in zip(self.outputs, values, strict=True):
            tensordict[key] = value
        return tensordict


class Action(Term):
    """Turns the policy's output into a command. `width` is the number of actions."""

    width: ClassVar[int]


class Sensor(Term):
    """Something measured from the state and the map; several observations may share it."""

    group = "sensor"


class Observation(Term):
    """A block of the observation vector, [n, width].

    Args:
        scale: Factor applied to the raw SI value.
    """

    group = "observation"
    columns: ClassVar[tuple[str, ...]] = ()
    compute: Callable[..., Tensor]

    def __init__(self, *, scale: float = 1.0) -> None:
        super().__init__()
        self.scale = scale

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.columns)


class Reward(Term):
    """An unweighted reward, [n, 1]; the environment adds `weight` times it to the reward."""

    group = "reward"

    def __init__(self, *, weight: float) -> None:
        super().__init__()
        self.weight = weight


class Termination(Term):
    """A reason to end an episode, [n, 1] bool.

    `truncates`: the clock's doing, so the value function bootstraps.
    """

    group = "termination"
    truncates: ClassVar[bool] = False
    success: ClassVar[bool] = False


class Randomization(Term):
    """Draws physical parameters anew at every reset: reads nominal values, writes drawn ones."""

    group = "params"


class Metric(Term):
    """A running number per episode, [n, 1]: `compute(so_far, *reads)` gives its next value.

    `start` is its value at the reset; it stands still once the route is finished, unless it says
    otherwise.
    """

    group = "metric"
    unit: ClassVar[str] = "-"
    start: ClassVar[float] = 0.0
    freezes_at_finish: ClassVar[bool] = True
    compute: Callable[..., Tensor]


def uniform_between(unit: Tensor, low: float | Tensor, high: float | Tensor) -> Tensor:
    """Maps uniform numbers in [0, 1) to [low, high)."""
    return low + (high - low) * unit


def as_column(values: float, like: Tensor) -> Tensor:
    """A [n, 1] column holding one constant, on the device and of the dtype of `like`."""
    return torch.full((like.shape[0], 1), values, dtype=like.dtype, device=like.device)
