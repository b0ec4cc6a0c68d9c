"""How fast physics allows a scene to be flown: references, which every evaluation compares with.

python -m resc.evaluation.bound                                  the paper's four maps
python -m resc.evaluation.bound 'scenes=[mine]'                  any scene that knows its goal
python -m resc.evaluation.bound suite=forest maps=30             the first 30 maps of each density
python -m resc.evaluation.bound limits.speed_mps=2.0             other limits
python -m resc.evaluation.bound suite=field missing=true         only maps without a reference
python -m resc.evaluation.bound 'scenes=[paper1_map11]' '+scene.goal_m=[9.0,8.75,1.0]'

Finds the fastest flight and a smooth one, prints them as a table, draws them, and stores them where
`python evaluate.py` finds them. It needs casadi: pip install -e '.[bound]'.
"""

import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from resc import schema
from resc.console import logged
from resc.errors import ConfigError, PlanningError
from resc.evaluation.courses import drawn
from resc.evaluation.reference_picture import draw_references
from resc.evaluation.references import (
    OWN,
    Reference,
    crossings,
    digest,
    keep,
    limits_of,
    outdone,
    read_references,
)
from resc.evaluation.suites import Amount, amounts_of, scenes_to_fly
from resc.evaluation.table import aligned
from resc.planning.route import RoutePlanner, planner_for
from resc.planning.searches.search import PlannedPath
from resc.planning.time_optimal import Crossing, Limits, solve, solver
from resc.process import prepare_process
from resc.run_folder import finish_run, provenance
from resc.settings import check_settings
from resc.starting.composed import compose_scenes, given
from resc.starting.launch import launch_here

REPORT, PICTURE = "report.md", "bound.png"
HEADER = ("scene", "path [m]", "bound [s]", "energy", "smooth [s]", "energy", "solved in [s]")
NOTE = """\
Bound: the fastest flight found for a point mass, from rest to within 0.5 m of the goal. Smooth: the
one that pays a millisecond for a unit of energy, the integral of squared jerk [m^2/s^5]. Both keep
to the limits of `limits` and are local optima, found from the shortest path of the search.
"""

Task = tuple[str, Crossing, PlannedPath]


@dataclass(frozen=True)
class Bounding:
    """The references of some scenes: solved, stored, drawn, reported.

    Args:
        config: Of bound.yaml.
        folder: Where the report goes.
    """

    config: DictConfig
    folder: Path

    def __call__(self) -> None:
        """Solves every task, or says what cannot be."""
        config = self.config
        check_settings(config, schema.BoundSchema)
        prepare_process(config["threads"], config["device"])
        solver()
        tasks = list(self.tasks())
        with logged(self.folder / "bound.log"):
            OmegaConf.save(config, self.folder / "config.yaml")
            stored = Path(config["references"]) if config["references"] else None
            if config["missing"]:
                tasks = missing(tasks, stored)
            print(bound(tasks, stored, self.folder))

    def tasks(self) -> Iterator[Task]:
        """Every map that a reference is sought for."""
        config, allowed = self.config, self.config["allowed_targets"]
        nodes = {name: config[name] for name in ("search", "task", "env")}
        planner = planner_for(**nodes, allowed=allowed)
        if planner is None:
            raise ConfigError(
                "search is none, but the solver starts from a planned path; set search=exact."
            )
        names = scenes_to_fly(config["scenes"], config["suite"], given())
        scenes = compose_scenes(names, config["scene"])
        suite = config["suite"] if config["scenes"] is None else None
        amounts = amounts_of(scenes, suite, maps=config["maps"], flights=config["flights"])
        limits = limits_of(config["limits"])
        return find_tasks(scenes, amounts, planner, limits, seed=config["seed"], allowed=allowed)


def find_tasks(
    scenes: Mapping[str, Mapping[str, Any]],
    amounts: Mapping[str, Amount],
    planner: RoutePlanner,
    limits: Limits,
    *,
    seed: int,
    allowed: Iterable[str] = (),
) -> Iterator[Task]:
    """Every different map of the scenes, named, and the shortest path from its nominal start.

    Raises:
        ConfigError: There is no scene, or one lays out its own routes.
        PlanningError: A start or goal is impossible, or no path joins them.
    """
    if not scenes:
        raise ConfigError("scenes is empty; name at least one file of conf/scene.")
    for name, node in scenes.items():
        amount = amounts[name]
        maps = drawn(
            name,
            node,
            Amount(1, amount.drawn) if amount.maps else amount,
            seed=seed,
            planner=planner,
            allowed=allowed,
        )
        if (maps.layout.route_length > 0).any():
            raise ConfigError(
                f"scene {name} lays out its own routes; a bound needs a scene that only knows "
                "its goal, such as paper1_map11."
            )
        planned = planner(replace(maps.layout, start_w=maps.nominal_w), name)
        different: dict[str, Task] = {}
        for number, crossing in enumerate(crossings(planned, maps.nominal_w, limits)):
            called = name if maps.redrawn is None else f"{name}, map {maps.number[number]}"
            called = f"{called}, flight {number}" if maps.redrawn is None and different else called
            different.setdefault(digest(crossing), (called, crossing, planner.paths[number]))
        yield from different.values()


def missing(tasks: list[Task], stored: Path | None) -> list[Task]:
    """Those without a stored reference.

    Raises:
        ConfigError: There are none.
    """
    known = read_references(stored) if stored is None or stored.exists() else {}
    left = [task for task in tasks if digest(task[1]) not in known]
    if not left:
        raise ConfigError(
            f"missing is true, and all {len(tasks)} maps have a reference; ask for more maps, or "
            "leave it out to look for better ones."
        )
    return left


def bound(tasks: list[Task], stored: Path | None, folder: Path) -> str:
    """Solves every task and stores each result at once; the report.

    Raises:
        PlanningError: Some have no solution; the others are stored and reported.
    """
    rows: list[list[str]] = [[*HEADER]]
    found: list[Reference] = []
    failed: list[str] = []
    began = time.perf_counter()
    for name, crossing, path in tasks:
        try:
            solved = solve(crossing, path.points_m)
        except PlanningError as error:
            failed.append(f"{name}: {error}")
            continue
        reference = Reference(name, crossing, path.length_m, solved.fastest, solved.smooth)
        found.append(keep(reference, stored))
        rows.append([*_cells(found[-1]), f"{solved.wall_s:.1f}"])
        notes = [f"{reference.fastest.duration_s:.2f} s, after {solved.wall_s:.1f} s of work"]
        print(f"{name}: " + "; ".join(notes + outdone(reference, found[-1])), flush=True)
    if not found:
        raise PlanningError(failed[0])
    draw_references(found, folder / PICTURE)
    report = f"{aligned(rows)}\n{NOTE}"
    (folder / REPORT).write_text(report)
    figures = {
        "scenes": {
            r.scene: {
                "digest": r.digest,
                "path_m": r.path_m,
                "bound_s": r.fastest.duration_s,
                "bound_energy_m2ps5": r.fastest.energy_m2ps5,
                "smooth_s": r.smooth.duration_s,
                "smooth_energy_m2ps5": r.smooth.energy_m2ps5,
            }
            for r in found
        },
        "wall_s": time.perf_counter() - began,
        **provenance(),
    }
    finish_run(folder, figures, "bound")
    if failed:
        more = f" (and {len(failed) - 1} more)" if failed[1:] else ""
        raise PlanningError(f"{failed[0]}{more}; the other {len(found)} are stored.")
    left = {"references": stored or OWN, "report": folder / REPORT, "picture": folder / PICTURE}
    return "\n".join([report, *(f"{name:<12}{path}" for name, path in left.items())])


def _cells(reference: Reference) -> list[str]:
    flights = (reference.fastest, reference.smooth)
    pairs = [(f"{flight.duration_s:.2f}", f"{flight.energy_m2ps5:.0f}") for flight in flights]
    return [reference.scene, f"{reference.path_m:.2f}", *pairs[0], *pairs[1]]


if __name__ == "__main__":
    schema.register()
    launch_here(Bounding, "bound")
