"""One pilot on all courses of an evaluation, and what it leaves in a folder."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from resc.errors import RecordingError
from resc.evaluation.counted import Counted, counted_by
from resc.evaluation.courses import Course
from resc.evaluation.planning_calls import Calls, failing, write_calls
from resc.evaluation.references import Reference, References, crossings, digest
from resc.evaluation.setting import Rules
from resc.evaluation.statistics import SceneReport, asked, join, report_scenes, tabulate
from resc.evaluation.table import failures, markdown, write_flights, write_scenes
from resc.flying.flights import Flights, fly_recorded
from resc.flying.pilot import Pilot
from resc.planning.time_optimal import Limits

ROLLOUTS, SCENES = "rollouts", "scenes"
REPORT, SCENES_TABLE, FLIGHTS_TABLE, CALLS_TABLE, PICTURE = (
    "report.md",
    "scenes.csv",
    "flights.csv",
    "planning_calls.csv",
    "flights.png",
)


@dataclass(frozen=True)
class Contest:
    """What every pilot of an evaluation flies and is measured by.

    Args:
        courses: The scenes, laid out and planned.
        rules: What they are flown under, by whether the scenes bring their own routes.
        limits: What is asked of every flight.
        references: What flights are compared with.
        scene_files: How many flights of every course are left as 3-D scenes.
    """

    courses: Sequence[Course]
    rules: Mapping[bool, Rules]
    limits: Limits
    references: References
    scene_files: int = 0

    def rules_of(self, course: Course) -> Rules:
        """What a course is flown under."""
        return self.rules[course.own_routes]

    @property
    def counted(self) -> Counted:
        """What is counted of its flights."""
        return counted_by(self.rules_of(self.courses[0]).stages)

    def of(self, pilot: Pilot) -> "Contest":
        """The same as a pilot flies it, which may find its own way or bring parts of its own."""
        courses, rules = self.courses, self.rules
        if pilot.finds_its_way:
            courses = [course.to_the_goal() for course in courses]
        if pilot.parts:
            rules = {own: replace(rule, replaced=pilot.parts) for own, rule in rules.items()}
        return replace(self, courses=courses, rules=rules)


@dataclass(frozen=True)
class Result:
    """What came of one pilot.

    Args:
        pilot: What flew.
        table: A row per flight.
        reports: One per scene and, of several, one over all.
        frames: Steps flown.
        flying_s: What they took.
        text: The report.
        told: What to say of the 3-D scenes, nothing if there are none.
        contest: What it flew.
        flown: The flights of every scene, by its name.
        calls: Of what planned in them.
    """

    pilot: Pilot
    table: dict[str, np.ndarray]
    reports: Sequence[SceneReport]
    frames: int
    flying_s: float
    text: str
    told: str
    contest: Contest
    flown: Mapping[str, Flights]
    calls: Calls


def fly_contest(contest: Contest, pilot: Pilot, folder: Path, title: str) -> Result:
    """Flies every course, and leaves tables, pictures and recordings in the folder."""
    contest = contest.of(pilot)
    courses, limits = contest.courses, contest.limits
    flown = fly_courses(courses, pilot, contest.rules, folder)
    folder.mkdir(parents=True, exist_ok=True)
    measured_by = {c.name: references_of(c, limits, contest.references) for c in courses}
    tables = [
        tabulate(c, flown[c.name], measured_by[c.name], contest.rules_of(c).arrival_m)
        for c in courses
    ]
    tables = [{**table, **asked(limits, len(table["scene"]))} for table in tables]
    reports = report_scenes(tables, [course.redrawn for course in courses])
    _draw(contest, flown, measured_by, reports, folder)
    table = join(tables)
    write_scenes(reports, folder / SCENES_TABLE)
    write_flights(table, folder / FLIGHTS_TABLE)
    calls = {name: flights.calls for name, flights in flown.items()}
    write_calls(calls, folder / CALLS_TABLE)
    led_out = "\n".join(course.led_out for course in courses if course.led_out)
    lost = "\n".join([led_out, failures(reports), failing(calls)]).strip()
    text = f"{markdown(reports, limits, contest.counted)}\n{lost}".rstrip() + "\n"
    (folder / REPORT).write_text(f"# {title}\n\n{text}")
    return Result(
        pilot=pilot,
        table=table,
        reports=reports,
        frames=sum(flights.frames for flights in flown.values()),
        flying_s=sum({flights.wall_s for flights in flown.values()}),
        text=text,
        told=_write_scene_files(contest, folder),
        contest=contest,
        flown=flown,
        calls=calls,
    )


def references_of(course: Course, limits: Limits, references: References) -> list[Reference | None]:
    """The reference of every flight; none where nothing is stored for its scene and limits."""
    if course.own_routes:
        return [None] * len(course)
    sought = crossings(course.layout, course.nominal_w, limits)
    return [references.get(digest(crossing)) for crossing in sought]


def fly_courses(
    courses: Sequence[Course], pilot: Pilot, rules: Mapping[bool, Rules], folder: Path
) -> dict[str, Flights]:
    """The flights of every course: all at once where the same rules hold.

    Args:
        courses: What to fly.
        pilot: What flies.
        rules: What they are flown under, by whether the scenes bring their own routes.
        folder: Where the recordings go, those under each set of rules in a folder of their own.
    """
    flown: dict[str, Flights] = {}
    for directory, group in _flown_together(courses, folder).items():
        own, first = rules[group[0].own_routes], 0
        flights = fly_recorded(own.env(group), pilot, own.recorded, directory)
        for course in group:
            flown[course.name] = flights.rows(first, first + len(course))
            first += len(course)
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


def _draw(
    contest: Contest,
    flown: Mapping[str, Flights],
    measured_by: Mapping[str, Sequence[Reference | None]],
    reports: Sequence[SceneReport],
    folder: Path,
) -> None:
    """A picture of every scene, and one of all."""
    from resc.evaluation.panel import Flown  # matplotlib, once all is flown
    from resc.evaluation.picture import draw_overview, draw_scene

    pictured = []
    for course, report in zip(contest.courses, reports, strict=False):
        resolution = contest.rules_of(course).stages.context.resolution_m
        own = flown[course.name], measured_by[course.name]
        pictured.append(Flown(course, *own, report, contest.rules_of(course).arrival_m, resolution))
    for scene in pictured:
        draw_scene(scene, folder / f"flight_{scene.course.name}.png")
    draw_overview(pictured, folder / PICTURE)


def _write_scene_files(contest: Contest, folder: Path) -> str:
    """Writes the 3-D scenes; returns what to say of them, nothing if there are none."""
    from resc.evaluation.scene_files import write_scene_files  # likewise

    try:
        written = write_scene_files(
            _flown_together(contest.courses, folder),
            folder / SCENES,
            first=contest.scene_files,
            allowed=contest.rules[False].settings["allowed_targets"],
        )
    except RecordingError as error:
        return f"No (more) 3-D scenes: {error}"
    return f"{len(written)} 3-D scenes for Foxglove" if written else ""
