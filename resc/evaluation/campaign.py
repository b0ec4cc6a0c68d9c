"""An evaluation from beginning to end: lay out, plan, fly, report."""

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from omegaconf import OmegaConf

from resc.errors import ConfigError, RecordingError
from resc.evaluation.commanded import commanded, commanded_scenes
from resc.evaluation.courses import Course, lay_out
from resc.evaluation.panel import Flown
from resc.evaluation.picture import draw_overview, draw_scene
from resc.evaluation.references import (
    STORED,
    Reference,
    References,
    crossings,
    digest,
    limits_of,
    read_references,
)
from resc.evaluation.scene_files import write_scene_files
from resc.evaluation.setting import build_flying_env, settings_for
from resc.evaluation.statistics import asked, join, report_scenes, tabulate
from resc.evaluation.suites import amounts_of
from resc.evaluation.table import failures, markdown, summary, write_flights, write_scenes
from resc.flying.flights import Flights, fly_recorded
from resc.flying.pilot import Pilot, PolicyPilot
from resc.planning.route import planner_for
from resc.planning.time_optimal import Limits
from resc.policies.stored import Policy
from resc.run_folder import POLICY, finish_run, provenance

ROLLOUTS, SCENES = "rollouts", "scenes"
NO_MATTER = ("name", "threads", "policy")
"""Settings by which no number of an evaluation changes; of the policy, its weights do."""
Settings = Mapping[str, Any]


def evaluate(
    config: Settings,
    policy: Policy,
    scenes: Mapping[str, Settings],
    folder: Path,
    overrides: Sequence[str] = (),
) -> str:
    """Flies every scene and leaves tables, pictures, recording and summary in the folder.

    The recording names the `overrides` that the command gave.

    Returns the report, and where to find the rest.

    Raises:
        PlanningError: A flight has no path.
        CheckpointError: The policy expects another observation than its configuration describes.
        ConfigError: A number is out of range, or limits are asked that the policy does not know.
    """
    began = time.perf_counter()
    if config["scene_files"] < 0:
        raise ConfigError(f"scene_files is {config['scene_files']}; expected 0 or more.")
    limits = limits_of(config)
    references = read_references(Path(config["references"]) if config["references"] else None)
    stored = cast(dict[str, Any], OmegaConf.to_container(policy.config, resolve=True))
    scenes = commanded_scenes(scenes, config, stored, limits)
    config = commanded(config, stored, limits, overrides)
    allowed = config["allowed_targets"]
    env = {**stored["env"], **(config["env"] or {})}
    planner = planner_for(search=config["search"], task=config["task"], env=env, allowed=allowed)
    amounts = amounts_of(config, list(scenes))
    courses = lay_out(scenes, amounts, seed=config["seed"], planner=planner, allowed=allowed)
    folder.mkdir(parents=True, exist_ok=True)
    OmegaConf.save(OmegaConf.create(dict(config)), folder / "config.yaml")
    rules = {own: settings_for(config, stored, own_routes=own) for own in (False, True)}
    flown = fly_courses(courses, PolicyPilot(policy), rules, folder, overrides)
    measured_by = {course.name: references_of(course, limits, references) for course in courses}
    arrival = {own: radius_of(rules[own]) for own in rules}
    tables = [
        tabulate(c, flown[c.name], measured_by[c.name], arrival[c.own_routes]) for c in courses
    ]
    tables = [{**table, **asked(limits, len(table["scene"]))} for table in tables]
    reports = report_scenes(tables, [course.redrawn for course in courses])
    pictured = []
    for course, report in zip(courses, reports, strict=False):
        resolution = rules[course.own_routes]["env"]["resolution_m"]
        own = flown[course.name], measured_by[course.name]
        pictured.append(Flown(course, *own, report, arrival[course.own_routes], resolution))
    for scene in pictured:
        draw_scene(scene, folder / f"flight_{scene.course.name}.png")
    draw_overview(pictured, folder / "flights.png")
    write_scenes(reports, folder / "scenes.csv")
    write_flights(join(tables), folder / "flights.csv")
    text = f"{markdown(reports, limits)}\n{failures(reports)}".rstrip() + "\n"
    (folder / "report.md").write_text(f"# {config['policy']}\n\n{text}")
    told = _write_scenes(config, courses, folder)
    frames = sum(flights.frames for flights in flown.values())
    flying_s = {flights.wall_s for flights in flown.values()}
    figures = {
        "frames": frames,
        "wall_s": time.perf_counter() - began,
        "frames_per_s": frames / sum(flying_s),
        **summary(reports),
        "policy": str(_near(Path(config["policy"]).resolve())),
        "fingerprint": fingerprint(config, scenes),
        "seed": config["seed"],
        **provenance(),
    }
    finish_run(folder, figures, "evaluation")
    return f"{text}\n{_left_in(folder, told)}"


def fingerprint(config: Settings, scenes: Mapping[str, Settings]) -> str:
    """SHA-256 of all that an evaluation flies and is measured by, but for the code.

    Settings, scenes, the policy's weights and the stored references: the same evaluation, whoever
    asks for it.
    """
    plain = OmegaConf.to_container(OmegaConf.create(dict(config)), resolve=True)
    made = {
        key: value for key, value in cast(dict[str, Any], plain).items() if key not in NO_MATTER
    }
    made["scenes_flown"] = {name: dict(node) for name, node in scenes.items()}
    text = json.dumps(made, sort_keys=True, default=str).encode()
    files = [Path(config["policy"]) / POLICY, Path(config["references"] or STORED)]
    return hashlib.sha256(
        b"".join([text, *(path.read_bytes() if path.is_file() else b"" for path in files)])
    ).hexdigest()


def radius_of(settings: Settings) -> float:
    """How near to a control point a flight reaches it [m]."""
    return float(settings["task"]["control_points"].get("radius_m", 0.5))


def references_of(course: Course, limits: Limits, references: References) -> list[Reference | None]:
    """The reference of every flight; none where nothing is stored for its scene and limits."""
    if course.own_routes:
        return [None] * len(course)
    sought = crossings(course.layout, course.nominal_w, limits)
    return [references.get(digest(crossing)) for crossing in sought]


def fly_courses(
    courses: Sequence[Course],
    pilot: Pilot,
    rules: Mapping[bool, Settings],
    folder: Path,
    overrides: Sequence[str] = (),
) -> dict[str, Flights]:
    """The flights of every course: all at once where the same rules hold.

    Args:
        courses: What to fly.
        pilot: What flies.
        rules: Settings of the environment, by whether the scenes bring their own routes.
        folder: Where the recordings go, each set of rules in one of its own.
        overrides: Of the command, for the recordings.
    """
    flown: dict[str, Flights] = {}
    for directory, group in _flown_together(courses, folder).items():
        settings = rules[group[0].own_routes]
        flown |= _fly_together(group, pilot, settings, directory, overrides)
    return flown


def _flown_together(courses: Sequence[Course], folder: Path) -> dict[Path, list[Course]]:
    """The courses that share their rules, by where they are recorded."""
    groups = {}
    for own_routes in (False, True):
        group = [course for course in courses if course.own_routes == own_routes]
        if group:
            mixed = len(group) < len(courses) and own_routes
            groups[folder / (f"{ROLLOUTS}_own_routes" if mixed else ROLLOUTS)] = group
    return groups


def _fly_together(
    courses: Sequence[Course],
    pilot: Pilot,
    settings: Settings,
    directory: Path,
    overrides: Sequence[str],
) -> dict[str, Flights]:
    env = build_flying_env(courses, settings)
    flights = fly_recorded(env, pilot, settings, directory, overrides)
    flown, first = {}, 0
    for course in courses:
        flown[course.name] = flights.rows(first, first + len(course))
        first += len(course)
    return flown


def _write_scenes(config: Settings, courses: Sequence[Course], folder: Path) -> str:
    """Writes the 3-D scenes; returns what to say of them, nothing if there are none."""
    try:
        written = write_scene_files(
            _flown_together(courses, folder),
            folder / SCENES,
            first=config["scene_files"],
            allowed=config["allowed_targets"],
        )
    except RecordingError as error:
        return f"No (more) 3-D scenes: {error}"
    return f"{len(written)} 3-D scenes for Foxglove" if written else ""


def _left_in(folder: Path, told: str) -> str:
    """The files of a run, with what they are; `told` is about the 3-D scenes."""
    recordings = sorted(folder.glob(f"{ROLLOUTS}*"))
    lines = [
        ("report", folder / "report.md"),
        ("numbers", folder / "scenes.csv"),
        ("", folder / "flights.csv"),
        ("", folder / "summary.json"),
        ("picture", folder / "flights.png"),
        *(("recording", directory) for directory in recordings),
    ]
    if (folder / SCENES).exists():
        lines.append(("scenes", folder / SCENES))
    listed = [f"{label:<10}{_near(path)}" for label, path in lines]
    return "\n".join([*listed, *([told] if told else [])])


def _near(path: Path) -> Path:
    """The path as seen from the working directory, if that is shorter."""
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path
