"""Wrong configurations, made from the right ones in conf/: every number, name and list, every way.

A file that is added to conf/ is mutated, too. `BOUNDS` says which numbers cannot be meant.
"""

import copy
import functools
import math
import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from resc.groups import GROUPS, names

CONF = Path(__file__).parents[1] / "conf"
LISTS = names(lambda group: group.several and group.stage)
"""Groups of several parts, which stand in the configuration under their names."""
PACKAGES = {folder: group.name for group in GROUPS if group.own_folder for folder in group.folders}
NO_PARTS = ("experiment", "study", "hydra")

POSITIVE, NONNEGATIVE, SHARE = (1e-300, math.inf), (0, math.inf), (0, 1)
COUNT, ANGLE, ANY = (1, math.inf), (0, 2 * math.pi), (-math.inf, math.inf)
BOUNDS = {
    r"threads|num_envs|total_frames|pool_size|evaluation_episodes|flights": COUNT,
    r"seed|evaluation_seed|renew_scenes|scene_files": NONNEGATIVE,
    r"checkpoint_every_s": NONNEGATIVE,
    r"action\.longest_delay_steps|randomization\..*_steps": NONNEGATIVE,
    r"action\.(rate_limit_radps|gravity_mps2)": POSITIVE,
    r"algorithm\.(steps|minibatch|epochs)": COUNT,
    r"algorithm\.(gamma|gae_lambda)": SHARE,
    r"algorithm\.(learning_rate|clip_epsilon|max_grad_norm|reward_scale|target_kl)": POSITIVE,
    r"algorithm\..*": NONNEGATIVE,
    r"curriculum\..*\.(episodes|levels)": COUNT,
    r"curriculum\..*": SHARE,
    r"dynamics\.substeps": COUNT,
    r"env\.(dt_s|resolution_m)": POSITIVE,
    r"launcher\..*": POSITIVE,
    r"model\.hidden": COUNT,
    r"algorithm\.initial_std": POSITIVE,
    r".*\.(history|beams|side|rays_per_side)": COUNT,
    r"observation\..*\.(clip|range_m|truncation_m|spacing_m|longest_guide_m)": POSITIVE,
    r"observation\..*\.dropout": SHARE,
    r"observation\..*\.scale": ANY,
    r".*\.angles_rad": (-2 * math.pi, 2 * math.pi),
    r"randomization\..*\.spread": SHARE,
    r"rate_loop\.gains": NONNEGATIVE,
    r"rate_loop\.throttle_range": SHARE,
    r"recorder\.(rotate_mb|max_gb)": POSITIVE,
    r"recorder\..*": COUNT,
    r"reward\..*\.weight": ANY,
    r"scene\.(start_m|goal_m|origin_m|boxes\[\d\])": ANY,
    r"scene\.(size_m|side_m|wall_m|spacing_m)": POSITIVE,
    r"scene\.(points|proposals)": COUNT,
    r"scene\.(occupied_thresh|free_thresh)": SHARE,
    r"scene\.occupied_at": (0, 100),
    r"scene\.((families\.map\.)?cell_m|families\.map\.height_m)": (math.inf, -math.inf),
    # of a point cloud, which the map of conf/ is not
    r"search\.(max_expansions|spacing_m|nominal_m)": POSITIVE,
    r"sensing\.(hit|miss|least|most|occupied)": ANY,
    r"sensing\.lost_share": SHARE,
    r"sensing\.(rate_hz|range_m|radius_m)": POSITIVE,
    r"replanning\.(check_hz|ahead_m|margin_m|clearance_m|spacing_m|nominal_m)": POSITIVE,
    r"sensor\.limit_violations\..*": POSITIVE,
    r"termination\.(height\.ceiling_m|time_limit\.limit_s)": POSITIVE,
    r"termination\.height\.ground_m": ANY,
    r"vehicle\.(mass_kg|inertia_kgm2|arm_x_m|arm_y_m|torque_coefficient_m)": POSITIVE,
    r"vehicle\.thrust_polynomial_n": ANY,
    r".*_rad": ANGLE,
}
"""What a number may be, by its path; the first pattern counts, and none is: from zero on."""
FREE_LENGTH = r".*\.(hidden|layout|angles_rad|boxes|fields)|scenes|allowed_targets|algorithm.*"
FREE_TEXT = r"name|launcher\.(address|partition|folder)|allowed_targets"
"""Lists of any length, and texts that may be anything."""
FRACTIONS = r"launcher\.(num_cpus|mem_gb)|recorder\.(rotate_mb|max_gb)"
"""Whole numbers in conf/ that may be fractions."""


@dataclass(frozen=True)
class Case:
    """One mutation.

    Args:
        script: train or evaluate.
        part: A file of conf/ without suffix, such as reward/progress; empty for the run's settings.
        path: Of the setting, in that file.
        value: What it is set to; `MISSING` takes it away.
        meant: Whether a user may mean it; if not, it must be refused.
    """

    script: str
    part: str
    path: tuple[str, ...]
    value: Any
    meant: bool

    def __str__(self) -> str:
        text = "nothing" if self.value is MISSING else repr(self.value)
        return f"{self.script} {self.part} {'.'.join(self.path)} = {text[:80]}"

    @property
    def number(self) -> int:
        """A random number that stays the same when others are added."""
        return zlib.crc32(str(self).encode())


MISSING = object()


def cases() -> Iterator[Case]:
    """All mutations of all parts, those that several files share once."""
    met = set()
    for file in sorted(CONF.glob("*/*.yaml")):
        group = file.parent.name
        if group in NO_PARTS:
            continue
        made_of = targets(load(group, file.stem))
        for case in cases_of_part(group, file.stem):
            key = (group, made_of, case.path, repr(case.value))
            if key not in met:
                met.add(key)
                yield case


def cases_of_part(group: str, name: str) -> Iterator[Case]:
    """All mutations of a file of conf/."""
    node, part = load(group, name), f"{group}/{name}"
    for path, value in leaves(node):
        dotted = ".".join((PACKAGES.get(group, group), *path))
        for mutant, meant in mutants(dotted, value):
            yield Case("train", part, path, mutant, meant)
    for path, mutant in broken(node):
        yield Case("train", part, path, mutant, False)


def targets(node: Any) -> tuple[str, ...]:
    """The classes that a part is made of."""
    if not isinstance(node, dict):
        return ()
    inner = sum((targets(value) for value in node.values()), ())
    return (str(node.get("_target_")), *inner)


def cases_of(script: str, settings: dict[str, Any]) -> Iterator[Case]:
    """All mutations of the run-level settings of a script."""
    for name, value in settings.items():
        if not isinstance(value, dict):
            for mutant, meant in mutants(name, value):
                yield Case(script, "", (name,), mutant, meant)


@functools.cache
def load(group: str, name: str) -> dict[str, Any]:
    """What a file of conf/ says, with the files of its group that it is made of; to be copied."""
    node = OmegaConf.load(CONF / group / f"{name}.yaml")
    own = [part for part in node.pop("defaults", []) if isinstance(part, str)]  # not of others
    parts = [part for part in own if part != "_self_"]
    whole = OmegaConf.merge(*(load(group, part) for part in parts), node)
    return OmegaConf.to_container(whole)


def mutated(node: dict[str, Any], path: tuple[str, ...], value: Any) -> dict[str, Any]:
    """A copy of a part with one setting changed or taken away."""
    if not path:
        return value
    node = copy.deepcopy(node)
    *above, last = path
    inner = node
    for key in above:
        inner = inner[key]
    if value is MISSING:
        del inner[last]
    else:
        inner[last] = value
    return node


def leaves(node: dict[str, Any], at: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every setting of a part with its path."""
    for key, value in node.items():
        if isinstance(value, dict):
            yield from leaves(value, (*at, key))
        elif key != "_target_":
            yield (*at, key), value


def broken(node: Any, at: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Structure gone wrong: keys misspelt and foreign, targets and parts that are none."""
    for key, value in node.items():
        if isinstance(value, dict):
            yield from broken(value, (*at, key))
        elif key != "_target_":
            yield (*at, f"{key[1:2]}{key[:1]}{key[2:]}"), value
    if "_target_" in node:
        yield (*at, "foo"), 1
        for target in (
            "resc.terms.Nothing",
            "resc.errors.ConfigError",
            "resc.build.build",
            "os",
            3,
        ):
            yield (*at, "_target_"), target
        for value in (3, "x", [], [1], {}):
            yield at, value


def mutants(path: str, value: Any) -> Iterator[tuple[Any, bool]]:
    """Everything that may stand in place of a value, and whether it can be meant."""
    if isinstance(value, bool):
        yield from ((wrong, False) for wrong in ("high", 3, math.nan, [], {"a": 1}))
        yield not value, True
    elif isinstance(value, int | float):
        yield from numbers(path, value)
        yield from ((wrong, False) for wrong in ("high", [], [value], {"a": value}, True))
    elif isinstance(value, str):
        free = bool(re.fullmatch(FREE_TEXT, path))
        yield from (("trash", free), ("", free), (3, free), ([], False), ({"a": 1}, False))
        yield math.nan, free
    elif isinstance(value, list):
        yield from lists(path, value)
    else:
        yield from ((wrong, False) for wrong in ([[]], {"a": 1}, True))
        yield from numbers(path, 1.0)
    yield None, True
    yield MISSING, True


def numbers(path: str, value: float) -> Iterator[tuple[Any, bool]]:
    """Numbers of other magnitudes, signs and units."""
    low, high = next((b for p, b in BOUNDS.items() if re.fullmatch(p, path)), NONNEGATIVE)
    if isinstance(value, int):
        others = (0, -1, 10**9, 10**30, -value, 10 * value)
        yield from ((number, bool(re.fullmatch(FRACTIONS, path))) for number in (0.5, 1e5 + 0.5))
    else:
        others = (0, -1, 1e-9, 1e9, 1e30, -value, 57.29578 * value, 1000 * value, 0.001 * value)
    yield from ((number, low <= number <= high) for number in others)
    yield from ((number, False) for number in (math.nan, math.inf, -math.inf))


def lists(path: str, value: list[Any]) -> Iterator[tuple[Any, bool]]:
    """Lists that are longer, shorter, of other things, or none."""
    free = bool(re.fullmatch(FREE_LENGTH, path))
    yield from (([], free), (value[:-1], free), ([*value, *value[-1:]], free))
    yield from ((wrong, False) for wrong in ("high", {"a": 1}, 3, [None], [[[]]]))
    if value:
        yield from (([wrong, *value[1:]], False) for wrong in (None, {"a": 1}, [[]], True))
        yield [value[0]] * len(value), True
        yield value[::-1], True
        if isinstance(value[0], list):
            for inner, meant in lists(f"{path}[0]", value[0]):
                yield [inner, *value[1:]], meant
        elif isinstance(value[0], int | float):
            for number, meant in numbers(path, value[0]):
                yield [number, *value[1:]], meant
            yield ["high", *value[1:]], False
        else:
            yield ["trash", *value[1:]], bool(re.fullmatch(FREE_TEXT, path))
