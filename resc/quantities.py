"""What the numbers of a configuration may be, as annotations of arguments: `radius_m: Positive`.

`resc.build` checks every argument against its annotation, so that the sentence names the path of
the setting and its value, and a class need not.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from types import NoneType
from typing import Annotated, Any, Literal, get_args, get_origin

from resc.errors import ConfigError, shown

LARGEST = 1e6
"""Of a quantity in SI units; what is beyond is a slip of the finger or of the unit."""
LIMIT = 1e15
"""Of any number: larger ones lose their digits in float32 and overflow the integers of PyTorch."""


@dataclass(frozen=True)
class Within:
    """Bounds of a number, both of them allowed.

    Args:
        low: The least.
        high: The greatest.
        above: Whether the least is excluded.
    """

    low: int | float
    high: int | float = LARGEST
    above: bool = False

    def admits(self, value: int | float) -> bool:
        """Whether the number is within the bounds."""
        return self.low <= value <= self.high and not (self.above and value == self.low)

    def __str__(self) -> str:
        """The bounds in words."""
        return f"a number {'above' if self.above else 'from'} {self.low:g}, up to {self.high:g}"


Positive = Annotated[float, Within(0, above=True)]
NotNegative = Annotated[float, Within(0)]
Number = Annotated[float, Within(-LARGEST)]
Share = Annotated[float, Within(0, 1)]
Angle = Annotated[float, Within(0, 2 * math.pi)]
"""An amount in radians; sixty of them are meant to be degrees."""
Count = Annotated[int, Within(1, 1000)]
"""Of things that there are at least one of, within one step of one environment."""
CountOrNone = Annotated[int, Within(0, 1000)]


def checked(path: str, value: Any, annotation: Any) -> Any:  # noqa: ANN401 - of any type
    """The value as its annotation wants it: a text where a number is expected is a typo.

    Raises:
        ConfigError: It is of another type, or out of range.
    """
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _bounded(path, checked(path, value, inner[0]), annotation.__metadata__)
    if NoneType in inner:
        others = [kind for kind in inner if kind is not NoneType]
        lists = [kind for kind in others if get_origin(kind) is Sequence]
        wanted = lists[0] if lists and isinstance(value, list | tuple) else others[-1]
        return None if value is None else checked(path, value, wanted)
    if float in inner and origin is not Sequence:  # int | float
        return checked(path, value, float)
    if annotation in (float, int):
        return _number(path, value, annotation)
    if origin is Literal and value not in inner:
        raise ConfigError(
            f"{path} is {shown(value)}; expected one of {', '.join(map(str, inner))}."
        )
    for kind, name in ((str, "a name"), (bool, "true or false")):
        if annotation is kind and not isinstance(value, kind):
            raise ConfigError(f"{path} is {shown(value)}; expected {name}.")
    if origin is Sequence:
        if not isinstance(value, list | tuple):
            raise ConfigError(f"{path} is {shown(value)}; expected a list.")
        return [checked(f"{path}[{number}]", part, inner[0]) for number, part in enumerate(value)]
    if _is_part(annotation) and not isinstance(value, annotation):
        raise ConfigError(
            f"{path} is {shown(value)}; expected a mapping with _target_ that describes a "
            f"{annotation.__name__}."
        )
    return value


def _is_part(annotation: Any) -> bool:  # noqa: ANN401 - of any type
    """Whether it is a class of ours."""
    return isinstance(annotation, type) and annotation.__module__.startswith("resc.")


def _number(path: str, value: Any, kind: type[int] | type[float]) -> int | float:  # noqa: ANN401
    wanted = (int, float) if kind is float else (int,)
    if isinstance(value, bool) or not isinstance(value, wanted):
        expected = "a number" if kind is float else "a whole number"
        raise ConfigError(f"{path} is {shown(value)}; expected {expected}.")
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"{path} is {value}; expected a finite number.")
    if abs(value) > LIMIT:
        raise ConfigError(
            f"{path} is {shown(value)}; expected a number between -{LIMIT:g} and {LIMIT:g}."
        )
    return kind(value)


def _bounded(path: str, value: Any, bounds: Sequence[Any]) -> Any:  # noqa: ANN401
    for bound in bounds:
        if isinstance(bound, Within) and not bound.admits(value):
            raise ConfigError(f"{path} is {value}; expected {bound}.")
    return value
