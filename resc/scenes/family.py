"""What a family of random maps is, and what families share."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from resc.errors import ConfigError
from resc.math.sampling import uniform
from resc.quantities import Positive, Share
from resc.scenes.layout import NO_BOX, NO_PILLAR


class Obstacles(NamedTuple):
    """Boxes `[x, y, len_x, len_y]` and pillars `[x, y, radius]` of many maps [m]."""

    boxes: Float[Tensor, "p k 4"]
    pillars: Float[Tensor, "p m 3"]


class Family(ABC):
    """Random maps of one kind.

    A family draws from the generator alone, and every map of it has room for as many obstacles:
    those that are not there are left out by `where`.

    Args:
        weight: Its share of the scenes is this over the sum of all weights.
        fence: Share of its maps with a wall around them.
    """

    def __init__(self, *, weight: Positive = 1.0, fence: Share = 0.5) -> None:
        self.weight = weight
        self.fence = fence

    @abstractmethod
    def obstacles(self, count: int, side_m: float, generator: torch.Generator) -> Obstacles:
        """Obstacles of `count` maps in the square from (0, 0) to (`side_m`, `side_m`)."""


def where(there: Bool[Tensor, "p k"], obstacles: Float[Tensor, "p k _"]) -> Float[Tensor, "p k _"]:
    """The boxes or pillars that are there, the others out of the way."""
    none = NO_BOX if obstacles.shape[-1] == 4 else NO_PILLAR
    return torch.where(there.unsqueeze(-1), obstacles, obstacles.new_tensor(none))


def boxes_about(
    centre: Float[Tensor, "p k 2"], lengths: Float[Tensor, "p k 2"]
) -> Float[Tensor, "p k 4"]:
    """Boxes with these centres and edges [m]."""
    return torch.cat((centre - lengths / 2, lengths), -1)


def first_few(count: int, number: Sequence[int], generator: torch.Generator) -> Bool[Tensor, "p k"]:
    """Which of the greatest `number` of things each map has: the first, a random number of them."""
    return torch.arange(number[1]) < whole(count, number, generator)


def whole(count: int, number: Sequence[int], generator: torch.Generator) -> Int[Tensor, "p 1"]:
    """Random whole numbers from the least to the greatest, both included."""
    return uniform((count, 1), number[0], number[1] + 1, generator).long().clamp(max=number[1])


def no_pillars(count: int) -> Float[Tensor, "p 1 3"]:
    """The pillars of maps without any."""
    return torch.tensor(NO_PILLAR).expand(count, 1, 3)


def require_families(name: str, families: Mapping[str, Any]) -> None:
    """Raises ConfigError for a part of a configuration that is no family."""
    for part, family in families.items():
        if not isinstance(family, Family):
            raise ConfigError(
                f"{name}.{part} is {family!r}, which is not a family of maps; name a class derived "
                "from resc.scenes.family.Family."
            )


def require_ranges(**ranges: Sequence[int | float]) -> None:
    """Raises ConfigError for what is no [least, greatest]."""
    for name, numbers in ranges.items():
        if len(numbers) != 2 or numbers[0] > numbers[1]:
            raise ConfigError(f"{name} is {list(numbers)}; expected [least, greatest].")
