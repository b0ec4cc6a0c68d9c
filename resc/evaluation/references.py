"""Stored references of scenes: the fastest flight and a smooth one, found by their own digest.

`python -m resc.evaluation.bound` computes them, an evaluation only reads. The digest is of all that
a reference depends on, so a scene or a limit that has changed finds no reference, not a stale one.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from jaxtyping import Float
from omegaconf import OmegaConf
from omegaconf.errors import InterpolationKeyError
from torch import Tensor

from resc.build import build
from resc.errors import ConfigError
from resc.places import INSTALLED, RESULTS
from resc.planning.time_optimal import FASTEST, SMOOTH, Crossing, Limits
from resc.planning.trajectory import Trajectory
from resc.run_folder import replacing
from resc.scenes.layout import Layout

STORED = RESULTS / "references.json"
"""The references that come with RESC."""
OWN = Path("references.json") if INSTALLED else STORED
"""Where new ones are kept unless `references` names another file; a wheel is not written to."""
SCENE_DIGITS, CONTROL_DIGITS = 4, 7
"""Decimals of scenes [m], by which they are told apart, and of control points [m].

Jerk is a third difference of control points times some thousand 1/s^3, so these need the digits.
"""
WEIGHTS = {"fastest": FASTEST[0], "smooth": SMOOTH}
"""What each flight pays for a unit of energy [s^6/m^2], by which two of a kind are compared."""
FORMAT = 1


@dataclass(frozen=True)
class Reference:
    """Two flights through one scene.

    Args:
        scene: Its name when they were computed, for people.
        crossing: What they are flights through.
        path_m: Length of the path that led the solver.
        fastest: The time-optimal one, a local optimum; its duration is the bound.
        smooth: The one that pays a millisecond for a unit of energy.
    """

    scene: str
    crossing: Crossing
    path_m: float
    fastest: Trajectory
    smooth: Trajectory

    @property
    def digest(self) -> str:
        """Its key."""
        return digest(self.crossing)


References = Mapping[str, Reference]


def limits_of(node: Any) -> Limits:  # noqa: ANN401 - as a configuration holds it
    """The limits that references keep to, from the group `limits`.

    Raises:
        ConfigError: One is missing or out of range.
    """
    try:
        node = OmegaConf.to_container(node, resolve=True) if OmegaConf.is_config(node) else node
    except InterpolationKeyError:
        raise ConfigError(
            "limits.speed_mps and limits.acceleration_mps2 follow sensor.limit_violations, which "
            "is left out; give them as numbers: limits.speed_mps=3.0 limits.acceleration_mps2=6.0"
        ) from None
    return build(cast(Mapping[str, Any], node), "limits")


def crossings(layout: Layout, nominal_w: Float[Tensor, "p 3"], limits: Limits) -> list[Crossing]:
    """What each scene of a layout is for a reference: starts are `nominal_w`, without jitter."""
    found = []
    last = (layout.route_length[:, 0] - 1).clamp(min=0).tolist()
    for number in range(len(layout)):
        obstacles = (*layout.boxes_w[number], *layout.pillars_w[number])
        boxes = {shape for shape in map(_plain, obstacles) if min(shape[2:]) > 0}
        found.append(
            Crossing(
                boxes=tuple(sorted(boxes)),
                origin_m=_plain(layout.origin_w[number]),
                size_m=_plain(layout.size[number]),
                start_m=_plain(nominal_w[number]),
                goal_m=_plain(layout.route_w[number, last[number]]),
                limits=limits,
            )
        )
    return found


def digest(crossing: Crossing) -> str:
    """16 hexadecimal digits of everything that a reference depends on."""
    text = json.dumps(asdict(crossing), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def read_references(path: Path | None = None) -> dict[str, Reference]:
    """The stored references by digest; without a file, those of RESC and the user's own.

    Raises:
        ConfigError: The file is not there, or one is cut or damaged.
    """
    if path is not None:
        return _read(path)
    found: dict[str, Reference] = {}
    for stored in filter(Path.exists, files_of()):
        for name, reference in _read(stored).items():
            found[name] = better(found[name], reference) if name in found else reference
    return found


def files_of(path: Path | None = None) -> tuple[Path, ...]:
    """The files that references are read from."""
    return tuple(dict.fromkeys((STORED, OWN))) if path is None else (path,)


def better(one: Reference, other: Reference) -> Reference:
    """Of two references of the same scene, the better of each flight, the first if they are equal.

    Better is what minimises more: a local optimum found earlier may be the lower one.
    """
    flights = {
        name: min(getattr(one, name), getattr(other, name), key=lambda f, w=weight: f.cost(w))
        for name, weight in WEIGHTS.items()
    }
    return replace(other, **flights)


def _read(stored: Path) -> dict[str, Reference]:
    try:
        content = json.loads(stored.read_text())
        if content["format"] != FORMAT:
            raise ValueError(f"format {content['format']}, expected {FORMAT}")
        found = {name: _reference(entry) for name, entry in content["references"].items()}
    except FileNotFoundError:
        raise ConfigError(
            f"references is '{stored}', which does not exist; compute it with: "
            f"python -m resc.evaluation.bound references={stored}"
        ) from None
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(
            f"{stored} is cut or damaged ({error}); restore it, or delete it and compute it with "
            "python -m resc.evaluation.bound."
        ) from None
    return found


def keep(reference: Reference, path: Path | None = None) -> Reference:
    """Stores a reference beside those that are there; of the same scene, the better of each flight.

    Returns it as stored, that is, rounded.
    """
    stored = path or OWN
    kept = _read(stored) if stored.exists() else {}
    rounded = {name: _rounded(getattr(reference, name)) for name in WEIGHTS}
    reference = replace(reference, **rounded)
    known = kept if path is not None else read_references()
    if earlier := known.get(reference.digest):
        reference = better(earlier, reference)
    kept[reference.digest] = reference
    lines = [
        f'"{name}":{json.dumps(_entry(entry), separators=(",", ":"))}'
        for name, entry in sorted(kept.items())
    ]
    text = f'{{"format": {FORMAT}, "references": {{\n' + ",\n".join(lines) + "\n}}\n"
    with replacing(stored) as part:
        part.write_text(text)
    return reference


def outdone(found: Reference, stored: Reference) -> list[str]:
    """The flights of a reference that are worse than what is stored, in words."""
    return [
        f"{name} of before kept, {was.duration_s:.2f} s and energy {was.energy_m2ps5:.0f}"
        for name, weight in WEIGHTS.items()
        if (was := getattr(stored, name)).cost(weight) < _rounded(getattr(found, name)).cost(weight)
    ]


def _entry(reference: Reference) -> dict[str, Any]:
    flights = {"fastest": reference.fastest, "smooth": reference.smooth}
    return {
        "scene": reference.scene,
        **asdict(reference.crossing),
        "path_m": round(reference.path_m, SCENE_DIGITS),
        **{
            name: {"duration_s": flight.duration_s, "control_m": flight.control_m.tolist()}
            for name, flight in flights.items()
        },
    }


def _reference(entry: Mapping[str, Any]) -> Reference:
    points = ("origin_m", "size_m", "start_m", "goal_m")
    flights = {
        name: Trajectory(
            float(entry[name]["duration_s"]),
            np.array(entry[name]["control_m"], dtype=np.float64).reshape(-1, 3),
        )
        for name in ("fastest", "smooth")
    }
    crossing = Crossing(
        boxes=tuple(tuple(box) for box in entry["boxes"]),
        **{name: tuple(entry[name]) for name in points},
        limits=Limits(**entry["limits"]),
    )
    return Reference(entry["scene"], crossing, float(entry["path_m"]), **flights)


def _rounded(flight: Trajectory) -> Trajectory:
    return Trajectory(
        round(flight.duration_s, CONTROL_DIGITS), flight.control_m.round(CONTROL_DIGITS) + 0.0
    )


def _plain(numbers: Tensor | Sequence[float]) -> tuple[float, ...]:
    """Floats as they are written; -0 is 0."""
    return tuple(round(float(number), SCENE_DIGITS) + 0.0 for number in numbers)
