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


def turned(
    dial: Dial,
    limits: Limits,
    *,
    randomization: Settings | None,
    trained: Settings,
    sensor: Settings | None,
    search: Settings | None,
    clearance_given: bool = False,
) -> dict[str, Any]:
    """Groups of an evaluation in which its limits are asked of a policy with a dial.

    The limits become those that are counted and the draws of every flight, and the search keeps the
    margin and the headroom of the training, unless its clearance is given.

    Args:
        dial: Of the policy.
        limits: What is asked.
        randomization: Group of the evaluation.
        trained: The same group of the policy's training.
        sensor: Group of the evaluation.
        search: Group of the evaluation.
        clearance_given: Whether the command gives `search.clearance_m`.

    Raises:
        ConfigError: A limit is outside of what was trained.
    """
    _require_within("limits.speed_mps", limits.speed_mps, dial.speed.speed_mps, "m/s")
    _require_within("limits.margin_m", limits.margin_m, dial.margin.margin_m, "m")
    fixed = {dial.speed: limits.speed_mps, dial.margin: limits.margin_m}
    drawn = {
        term.name: {**trained[term.name], part: [value, value]}
        for (term, value), part in zip(fixed.items(), ("speed_mps", "margin_m"), strict=True)
    }
    sensors = {**(sensor or {})}
    if sensors.get("limit_violations"):
        sensors["limit_violations"] = {**sensors["limit_violations"], "speed_mps": limits.speed_mps}
    if search and not clearance_given:
        search = {**search, "clearance_m": clearance_m(dial, limits)}
    return {
        "randomization": {**(randomization or {}), **drawn},
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
            f"{unit}; ask for a value in this range, or train a policy with a wider one."
        )


def require_own(
    limits: Limits,
    sensors: Settings | None,
    trained_sensors: Settings | None,
    terminations: Settings | None,
) -> None:
    """Refuses limits that a policy without a dial cannot know of.

    The speed above which steps are counted may differ: it is the evaluation's.

    Args:
        limits: What is asked.
        sensors: Group of the evaluation.
        trained_sensors: The same group of the policy's training.
        terminations: Of the training.

    Raises:
        ConfigError: A limit is neither the policy's nor the one that is counted.
    """
    counted, trained = _counted(sensors), _counted(trained_sensors)
    radius = ((terminations or {}).get("collision") or {}).get("radius_m")
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


def _counted(sensors: Settings | None) -> float | None:
    """The speed [m/s] above which steps are counted, if some are."""
    return ((sensors or {}).get("limit_violations") or {}).get("speed_mps")
