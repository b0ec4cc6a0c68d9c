"""An evaluation from beginning to end: lay out, plan, fly, report."""

import hashlib
import json
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, cast

from omegaconf import OmegaConf

from resc.envs.terms_table import write_terms
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
from resc.evaluation.commanded import Dial, commanded_scenes, dial_of, require_own, turned
from resc.evaluation.counted import counted_by
from resc.evaluation.courses import lay_out
from resc.evaluation.references import files_of, limits_of, read_references
from resc.evaluation.setting import Rules
from resc.evaluation.suites import amounts_of
from resc.evaluation.table import summary
from resc.flying.pilot import Pilot, PolicyPilot
from resc.planning.route import planner_for
from resc.planning.time_optimal import Limits
from resc.policies.stored import StoredPolicy
from resc.run_folder import POLICY, finish_run, near, provenance
from resc.scenes.files_named import content_of

NO_MATTER = ("name", "threads", "policy", "pilot")
"""Settings by which no number of an evaluation changes; of the policy and the
pilots, what they are does."""
Settings = Mapping[str, Any]


@dataclass(frozen=True)
class Evaluation:
    """Every scene flown by every pilot.

    Args:
        config: Of the evaluation.
        policy: Whose vehicle, action and observation are flown.
        scenes: Their configurations, by name.
        overrides: Of the command, which the recordings name.
        given_pilots: What flies; without any, the policy.
    """

    config: Settings
    policy: StoredPolicy
    scenes: Mapping[str, Settings]
    overrides: Sequence[str] = ()
    given_pilots: Sequence[Pilot] = ()

    def fly(self, folder: Path) -> str:
        """Leaves tables, pictures, recordings and a summary in the folder.

        With several pilots, each has a folder in it. Returns the report, and where to find the
        rest.

        Raises:
            PlanningError: A flight has no path.
            CheckpointError: The policy expects another observation than its configuration
                describes.
            ConfigError: A number is out of range, limits are asked that the policy does not know,
                or a pilot cannot fly this environment.
        """
        began = time.perf_counter()
        contest, fingerprint = self.contest(), self.fingerprint  # of the files as they are now
        folder.mkdir(parents=True, exist_ok=True)
        OmegaConf.save(OmegaConf.create(dict(self.asked)), folder / "config.yaml")
        write_terms(self._rules[contest.courses[0].own_routes].stages, folder)
        results = self._fly_all(contest, folder)
        flying_s = sum(result.flying_s for result in results)
        frames = sum(result.frames for result in results)
        figures = {
            "frames": frames,
            "wall_s": time.perf_counter() - began,
            "frames_per_s": frames / flying_s,
            **_summary(results),
            "policy": str(near(Path(self.config["policy"]).resolve())),
            "fingerprint": fingerprint,
            "seed": self.config["seed"],
            **provenance(),
        }
        finish_run(folder, figures, "evaluation")
        told = results[0].text
        if len(results) > 1:
            from resc.evaluation.together import write_together  # matplotlib, once all is flown

            told = write_together(results, contest.limits, folder)
        return f"{told}\n{_left_in(folder, results)}"

    @cached_property
    def pilots(self) -> Sequence[Pilot]:
        """What flies."""
        given = self.given_pilots or [PolicyPilot(self.policy)]
        return [variant for pilot in given for variant in pilot.variants()]

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 of all that is flown and what it is measured by, but for the code.

        Settings, scenes and the files that they name, what the pilots say of themselves, the
        policy's weights and the stored references: equal for equal evaluations.
        """
        config = self.config
        plain = OmegaConf.to_container(OmegaConf.create(dict(config)), resolve=True)
        made = {
            key: value for key, value in cast(dict[str, Any], plain).items() if key not in NO_MATTER
        }
        made["scenes_flown"] = {name: dict(node) for name, node in self.scenes.items()}
        made["flown_by"] = {pilot.name: dict(pilot.facts()) for pilot in self.pilots}
        text = json.dumps(made, sort_keys=True, default=str).encode()
        named = Path(config["references"]) if config["references"] else None
        files = [Path(config["policy"]) / POLICY, *files_of(named)]
        stored = (path.read_bytes() if path.is_file() else b"" for path in files)
        maps = content_of(list(self.scenes.values()))
        return hashlib.sha256(b"".join([text, *stored, maps])).hexdigest()

    @cached_property
    def limits(self) -> Limits:
        """What is asked of every flight.

        Raises:
            ConfigError: A number is out of range.
        """
        return limits_of(self.config["limits"])

    @cached_property
    def asked(self) -> dict[str, Any]:
        """The configuration, its limits asked of the policy if it can be asked.

        Raises:
            ConfigError: A limit is outside of what was trained, or the policy does not know it.
        """
        config, trained = self.config, self._trained
        if self._dial is None:
            sensors, terminations = trained.get("sensor"), trained.get("termination")
            require_own(self.limits, config.get("sensor"), sensors, terminations)
            return dict(config)
        given = [text.lstrip("+").partition("=")[0] for text in self.overrides]
        groups = turned(
            self._dial,
            self.limits,
            trained=trained["randomization"],
            clearance_given="search.clearance_m" in given,
            **{group: config[group] for group in ("randomization", "sensor", "search")},
        )
        return {**config, **groups}

    @cached_property
    def _trained(self) -> dict[str, Any]:
        """The configuration that the policy was trained with."""
        return cast(dict[str, Any], OmegaConf.to_container(self.policy.config, resolve=True))

    @cached_property
    def _dial(self) -> Dial | None:
        """What the policy can be asked for."""
        trained = self._trained
        drawn, seen = trained.get("randomization"), trained.get("observation")
        return dial_of(drawn, seen, self.config["allowed_targets"])

    @cached_property
    def _rules(self) -> dict[bool, Rules]:
        """What is flown under, by whether the scenes bring their own routes."""
        return {own: Rules(self.asked, self._trained, own, self.overrides) for own in (False, True)}

    def check(self) -> None:
        """Looks at all that can be wrong before any scene is laid out.

        Raises:
            ConfigError: A number or a combination is wrong, or a pilot cannot fly this environment.
            CheckpointError: The policy expects another observation than its configuration
                describes.
        """
        if self.config["scene_files"] < 0:
            raise ConfigError(f"scene_files is {self.config['scene_files']}; expected 0 or more.")
        _require_one_choice(self.overrides)
        for pilot in self.pilots:
            rules = self._rules[False]
            own = replace(rules, replaced=pilot.parts) if pilot.parts else rules
            pilot.check(own.stages)

    def contest(self) -> Contest:
        """What the pilots fly: everything checked, laid out and planned."""
        self.check()
        config, scenes, allowed = self.config, self.scenes, self.config["allowed_targets"]
        references = read_references(Path(config["references"]) if config["references"] else None)
        for rules in self._rules.values():
            counted_by(rules.stages)
        if self._dial and "clearance_m" not in (config["scene"] or {}):
            scenes = commanded_scenes(scenes, self._dial, self.limits)
        asked, trained = self.asked, self._trained
        # Planned as on the maps of the policy.
        env = {**trained["env"], **(asked["env"] or {})}
        planner = planner_for(search=asked["search"], task=asked["task"], env=env, allowed=allowed)
        suite = config["suite"] if config["scenes"] is None else None
        amounts = amounts_of(scenes, suite, maps=config["maps"], flights=config["flights"])
        courses = lay_out(scenes, amounts, seed=config["seed"], planner=planner, allowed=allowed)
        for course in courses:
            if course.led_out:
                print(course.led_out, file=sys.stderr)
        return Contest(courses, self._rules, self.limits, references, config["scene_files"])

    def _fly_all(self, contest: Contest, folder: Path) -> list[Result]:
        """What comes of every pilot: several have a folder each, one leaves all in `folder`."""
        if len(self.pilots) > 1:
            return [fly_contest(contest, p, folder / p.name, p.name) for p in self.pilots]
        (pilot,) = self.pilots
        named = self.config["policy"] if isinstance(pilot, PolicyPilot) else pilot.name
        return [fly_contest(contest, pilot, folder, named)]


def _require_one_choice(overrides: Sequence[str]) -> None:
    """A simulator chooses the dynamics; a second choice beside it would win without a word."""
    given = {text.lstrip("+").partition("=")[0]: text for text in overrides}
    if {"simulator", "dynamics"} <= given.keys() and given["simulator"] != "simulator=own":
        raise ConfigError(
            f"{given['simulator']} chooses the dynamics, and so does {given['dynamics']}; leave "
            "one of them out."
        )


def _summary(results: Sequence[Result]) -> dict[str, Any]:
    """The reports for programs; of several pilots, those of each under its name."""
    own = {r.pilot.name: {"pilot": r.pilot.facts(), **summary(r.reports)} for r in results}
    if len(results) > 1:
        return {"pilots": own}
    return {**summary(results[0].reports), "pilot": {n: dict(o["pilot"]) for n, o in own.items()}}


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
    return "\n".join([*(f"{label:<{width}}{near(path)}" for label, path in lines), *told])
