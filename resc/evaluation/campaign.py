"""An evaluation from beginning to end: lay out, plan, fly, report."""

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from omegaconf import OmegaConf

from resc.errors import ConfigError
from resc.evaluation.by_pilot import (
    FLIGHTS_TABLE,
    PICTURE,
    REPORT,
    ROLLOUTS,
    SCENES,
    SCENES_TABLE,
    Contest,
    Result,
    fly_contest,
)
from resc.evaluation.commanded import commanded, commanded_scenes, dial_of
from resc.evaluation.courses import lay_out
from resc.evaluation.references import STORED, limits_of, read_references
from resc.evaluation.setting import settings_for
from resc.evaluation.suites import amounts_of
from resc.evaluation.table import summary
from resc.evaluation.together import write_together
from resc.flying.pilot import Pilot, PolicyPilot
from resc.planning.route import planner_for
from resc.policies.stored import StoredPolicy
from resc.run_folder import POLICY, finish_run, provenance
from resc.setup import build_stages

NO_MATTER = ("name", "threads", "policy", "pilot")
"""Settings by which no number of an evaluation changes; of the policy and the
pilots, what they are does."""
Settings = Mapping[str, Any]


def evaluate(
    config: Settings,
    policy: StoredPolicy,
    scenes: Mapping[str, Settings],
    folder: Path,
    overrides: Sequence[str] = (),
    *,
    pilots: Sequence[Pilot] = (),
) -> str:
    """Flies every scene with every pilot; leaves tables, pictures, recordings and a summary.

    Args:
        config: Of the evaluation.
        policy: Whose vehicle, action and observation are flown.
        scenes: Their configurations, by name.
        folder: Where everything is left; with several pilots, each has a folder in it.
        overrides: Of the command, which the recordings name.
        pilots: What flies; without any, the policy.

    Returns the report, and where to find the rest.

    Raises:
        PlanningError: A flight has no path.
        CheckpointError: The policy expects another observation than its configuration describes.
        ConfigError: A number is out of range, limits are asked that the policy does not know, or a
            pilot cannot fly this environment.
    """
    began = time.perf_counter()
    if config["scene_files"] < 0:
        raise ConfigError(f"scene_files is {config['scene_files']}; expected 0 or more.")
    pilots = pilots or [PolicyPilot(policy)]
    limits = limits_of(config["limits"])
    references = read_references(Path(config["references"]) if config["references"] else None)
    stored = cast(dict[str, Any], OmegaConf.to_container(policy.config, resolve=True))
    allowed = config["allowed_targets"]
    dial = dial_of(stored.get("randomization"), stored.get("observation"), allowed)
    if dial and "clearance_m" not in (config["scene"] or {}):
        scenes = commanded_scenes(scenes, dial, limits)
    config = commanded(config, stored, dial, limits, overrides)
    rules = {own: settings_for(config, stored, own_routes=own) for own in (False, True)}
    for pilot in pilots:
        pilot.check(build_stages(rules[False]))
    # Planned as on the maps of the policy.
    env = {**stored["env"], **(config["env"] or {})}
    planner = planner_for(search=config["search"], task=config["task"], env=env, allowed=allowed)
    suite = config["suite"] if config["scenes"] is None else None
    amounts = amounts_of(scenes, suite, maps=config["maps"], flights=config["flights"])
    courses = lay_out(scenes, amounts, seed=config["seed"], planner=planner, allowed=allowed)
    folder.mkdir(parents=True, exist_ok=True)
    OmegaConf.save(OmegaConf.create(dict(config)), folder / "config.yaml")
    contest = Contest(config, courses, rules, limits, references, overrides)
    results = _fly_all(contest, pilots, folder)
    flying_s = sum(result.flying_s for result in results)
    frames = sum(result.frames for result in results)
    figures = {
        "frames": frames,
        "wall_s": time.perf_counter() - began,
        "frames_per_s": frames / flying_s,
        **_summary(results),
        "policy": str(_near(Path(config["policy"]).resolve())),
        "fingerprint": fingerprint(config, scenes, pilots),
        "seed": config["seed"],
        **provenance(),
    }
    finish_run(folder, figures, "evaluation")
    told = results[0].text if len(results) == 1 else write_together(results, limits, folder)
    return f"{told}\n{_left_in(folder, results)}"


def _fly_all(contest: Contest, pilots: Sequence[Pilot], folder: Path) -> list[Result]:
    """What comes of every pilot: several have a folder each, one leaves all in the evaluation's."""
    if len(pilots) > 1:
        return [fly_contest(contest, p, folder / p.name, p.name) for p in pilots]
    (pilot,) = pilots
    named = contest.config["policy"] if isinstance(pilot, PolicyPilot) else pilot.name
    return [fly_contest(contest, pilot, folder, named)]


def _summary(results: Sequence[Result]) -> dict[str, Any]:
    """The reports for programs; of several pilots, those of each under its name."""
    own = {r.pilot.name: {"pilot": r.pilot.facts(), **summary(r.reports)} for r in results}
    if len(results) > 1:
        return {"pilots": own}
    return {**summary(results[0].reports), "pilot": {n: dict(o["pilot"]) for n, o in own.items()}}


def fingerprint(config: Settings, scenes: Mapping[str, Settings], pilots: Sequence[Pilot]) -> str:
    """SHA-256 of all that an evaluation flies and is measured by, but for the code.

    Settings, scenes, what the pilots say of themselves, the policy's weights and the stored
    references: equal for equal evaluations.
    """
    plain = OmegaConf.to_container(OmegaConf.create(dict(config)), resolve=True)
    made = {
        key: value for key, value in cast(dict[str, Any], plain).items() if key not in NO_MATTER
    }
    made["scenes_flown"] = {name: dict(node) for name, node in scenes.items()}
    made["flown_by"] = {pilot.name: dict(pilot.facts()) for pilot in pilots}
    text = json.dumps(made, sort_keys=True, default=str).encode()
    files = [Path(config["policy"]) / POLICY, Path(config["references"] or STORED)]
    return hashlib.sha256(
        b"".join([text, *(path.read_bytes() if path.is_file() else b"" for path in files)])
    ).hexdigest()


def _left_in(folder: Path, results: Sequence[Result]) -> str:
    """The files of a run, with what they are."""
    lines = [
        ("report", folder / REPORT),
        ("numbers", folder / SCENES_TABLE),
        ("", folder / FLIGHTS_TABLE),
        ("", folder / "summary.json"),
    ]
    if len(results) > 1:
        lines += [(r.pilot.name, folder / r.pilot.name) for r in results]
    else:
        recordings = sorted(folder.glob(f"{ROLLOUTS}*"))
        lines += [("picture", folder / PICTURE)]
        lines += [("recording", directory) for directory in recordings]
        lines += [("scenes", folder / SCENES)] if (folder / SCENES).exists() else []
    width = max(10, *(len(label) + 1 for label, _ in lines))
    told = [
        f"{result.pilot.name}: {result.told}" if len(results) > 1 else result.told
        for result in results
        if result.told
    ]
    return "\n".join([*(f"{label:<{width}}{_near(path)}" for label, path in lines), *told])


def _near(path: Path) -> Path:
    """The path as seen from the working directory, if that is shorter."""
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path
