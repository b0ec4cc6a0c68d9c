"""The dial: the speed limit and the margin that an evaluation asks of a policy.

`limits.speed_mps` and `limits.margin_m` are what the bound keeps to. A policy that was trained with
many of both, and observes them, is asked to keep to them, too: they fix what training drew, the
search keeps the margin and its headroom, and steps above the speed are counted. Any other policy
has limits of its own, and no others can be asked of it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from resc import keys
from resc.build import build_terms
from resc.errors import ConfigError
from resc.maps.constants import INFLATION_M
from resc.planning.time_optimal import Limits
from resc.term import Observation, Randomization
from resc.terms.randomizations.limits import Margin, SpeedLimit

DIGITS = 6
"""Decimals of a clearance [m]: 0.2 + 0.1 is 0.3."""
Settings = Mapping[str, Any]


@dataclass(frozen=True)
class Dial:
    """What a policy can be asked for.

    Args:
        speed: Draws the speed limit of its training.
        margin: Draws the margin.
    """

    speed: SpeedLimit
    margin: Margin


def dial_of(
    randomization: Settings | None, observation: Settings | None, allowed: Sequence[str] = ()
) -> Dial | None:
    """The dial of what a policy's training drew and saw; None if that is not both, twice.

    Raises:
        ConfigError: A part of the configuration cannot be built.
    """
    drawing = build_terms(randomization, "randomization", Randomization, allowed)
    speeds = [term for term in drawing if isinstance(term, SpeedLimit)]
    margins = [term for term in drawing if isinstance(term, Margin)]
    if not speeds or not margins:
        return None
    seeing = build_terms(observation, "observation", Observation, allowed)
    seen = {key for term in seeing for key in term.reads}
    return Dial(speeds[0], margins[0]) if {keys.SPEED_LIMIT, keys.MARGIN} <= seen else None


def commanded(
    config: Settings,
    stored: Settings,
    dial: Dial | None,
    limits: Limits,
    overrides: Sequence[str] = (),
) -> dict[str, Any]:
    """The evaluation's configuration, its limits asked of the policy.

    Of a policy with a dial they become the limits that are counted and the draws of every flight,
    and the search keeps the margin and the headroom of the training unless the `overrides` give
    `search.clearance_m`. For any other policy nothing changes.

    Raises:
        ConfigError: A limit is outside of what was trained.
    """
    if dial is None:
        counted, trained = (_counted(of.get("sensor")) for of in (config, stored))
        collision = (stored.get("termination") or {}).get("collision") or {}
        _require_own(limits, counted, trained, collision.get("radius_m"))
        return dict(config)
    _require_within("limits.speed_mps", limits.speed_mps, dial.speed.speed_mps, "m/s")
    _require_within("limits.margin_m", limits.margin_m, dial.margin.margin_m, "m")
    fixed = {dial.speed: limits.speed_mps, dial.margin: limits.margin_m}
    drawn = {
        term.name: {**stored["randomization"][term.name], part: [value, value]}
        for (term, value), part in zip(fixed.items(), ("speed_mps", "margin_m"), strict=True)
    }
    sensors = {**(config["sensor"] or {})}
    if sensors.get("limit_violations"):
        sensors["limit_violations"] = {**sensors["limit_violations"], "speed_mps": limits.speed_mps}
    search = config["search"]
    if search and not _gives(overrides, "search.clearance_m"):
        search = {**search, "clearance_m": clearance_m(dial, limits)}
    return {
        **config,
        "randomization": {**(config["randomization"] or {}), **drawn},
        "sensor": sensors,
        "search": search,
    }


def commanded_scenes(
    scenes: Mapping[str, Settings], dial: Dial, limits: Limits
) -> dict[str, Settings]:
    """The scenes; of those that say what their routes keep, it is the margin and its headroom."""
    kept = [clearance_m(dial, limits)] * 2
    return {
        name: {**node, "clearance_m": kept} if "clearance_m" in node else node
        for name, node in scenes.items()
    }


def clearance_m(dial: Dial, limits: Limits) -> float:
    """What a route keeps [m] so that the margin can be kept along it."""
    return round(limits.margin_m + dial.margin.headroom_m, DIGITS)


def _require_within(name: str, value: float, ends: tuple[float, float], unit: str) -> None:
    least, greatest = ends
    if not least <= value <= greatest:
        raise ConfigError(
            f"{name} is {value:g}, but the policy was trained from {least:g} to {greatest:g} "
            f"{unit}; ask for one of these, or train it with other ends."
        )


def _counted(sensors: Settings | None) -> float | None:
    """The speed [m/s] above which steps are counted, if some are."""
    return ((sensors or {}).get("limit_violations") or {}).get("speed_mps")


def _require_own(
    limits: Limits, counted: float | None, trained: float | None, radius: float | None
) -> None:
    """Refuses limits that a policy without a dial cannot know of.

    The speed above which steps are counted may differ: it is the evaluation's.
    """
    asked = (
        ("speed_mps", limits.speed_mps, (trained, counted), trained),
        ("margin_m", limits.margin_m, (radius, INFLATION_M), radius or INFLATION_M),
    )
    for name, value, own, nominal in asked:
        if value not in own and nominal is not None:
            raise ConfigError(
                f"limits.{name} is {value:g}, but the policy does not observe its limits: it was "
                f"trained with {nominal:g}; leave it out, or fly a policy that was trained with "
                "+experiment=dial."
            )


def _gives(overrides: Sequence[str], key: str) -> bool:
    return any(text.lstrip("+").partition("=")[0] == key for text in overrides)
