"""Suites: which scenes an evaluation flies, on how many maps, and how often on each.

A file of conf/suite maps names of scenes to these numbers, so that several suites are one:
`suite=[paper,forest]`.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from resc.errors import ConfigError, nearest, shown
from resc.settings import listed

FLIGHTS = 20
"""Of each scene, where `scenes` names them and no number is given."""
MOST = 1_000_000
KNOWN = ("maps", "flights")


@dataclass(frozen=True)
class Amount:
    """How often a scene is flown.

    Args:
        flights: On each map.
        maps: Of a scene that draws them; None is a map of its own for every flight.
    """

    flights: int
    maps: int | None = None

    @property
    def drawn(self) -> int:
        """How many maps are drawn, of a scene that draws them."""
        return self.flights if self.maps is None else self.maps

    @property
    def flights_a_map(self) -> int:
        """How often each of them is flown."""
        return 1 if self.maps is None else self.flights


def scenes_to_fly(
    scenes: Sequence[str] | str | None,
    suite: Mapping[str, Any] | None,
    overrides: Iterable[str] = (),
) -> list[str]:
    """Names of the scenes: those of `scenes`, or else those of the suite.

    Raises:
        ConfigError: The command names scenes and a suite, or neither names a scene.
    """
    given = [text.lstrip("+~").partition("=")[0].partition(".")[0] for text in overrides]
    if scenes is None:
        if not suite:
            raise ConfigError(
                "scenes is null and suite is empty; name a suite (suite=paper) or at least one "
                "file of conf/scene: 'scenes=[random_boxes]'."
            )
        return list(suite)
    if "suite" in given:
        raise ConfigError(
            "Both suite and scenes say what to fly; leave one of them out. To leave a scene "
            "out of a suite, give '~suite.<scene>'; to change its numbers, suite.<scene>.maps=10."
        )
    return listed(scenes)


def amounts_of(
    scenes: Iterable[str], suite: Mapping[str, Any] | None, *, maps: int | None, flights: int | None
) -> dict[str, Amount]:
    """How often each of the scenes is flown: as the suite says, but `maps` and `flights` win.

    Without a suite, the scenes were named.

    Raises:
        ConfigError: A number of the suite is missing or impossible, or `maps` means nothing for it.
    """
    if suite is None:
        return {name: Amount(flights or FLIGHTS, maps) for name in scenes}
    own = {name: _read(name, suite[name]) for name in scenes if name in suite}
    if maps is not None and own and all(amount.maps is None for amount in own.values()):
        raise ConfigError(
            f"maps is {maps}, but {', '.join(own)} have fixed maps; leave it out or raise flights."
        )
    found = {name: own.get(name, Amount(FLIGHTS, maps)) for name in scenes}
    return {
        name: Amount(flights or a.flights, a.maps if maps is None or a.maps is None else maps)
        for name, a in found.items()
    }


def _read(name: str, node: Any) -> Amount:  # noqa: ANN401 - as a configuration holds it
    if not isinstance(node, Mapping) or "flights" not in node:
        raise ConfigError(
            f"suite.{name} is {shown(node)}; expected numbers such as {{maps: 100, flights: 5}}, "
            "or {flights: 20} of a scene with one map."
        )
    for key, value in node.items():
        if key not in KNOWN:
            raise ConfigError(f"suite.{name} has no '{key}'.{nearest(str(key), KNOWN)}")
        whole = isinstance(value, int) and not isinstance(value, bool)
        if not (whole and 1 <= value <= MOST) and not (key == "maps" and value is None):
            raise ConfigError(
                f"suite.{name}.{key} is {shown(value)}; expected a whole number from 1 to {MOST}."
            )
    return Amount(node["flights"], node.get("maps"))
