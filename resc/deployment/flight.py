"""One flight of a vehicle behind a link: prepared as an evaluation, flown, recorded."""

import gc
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from omegaconf import DictConfig, OmegaConf
from torch import Tensor

from resc import keys
from resc.deployment.geofence import Geofence
from resc.deployment.link import Link
from resc.deployment.vehicle import LinkedVehicle, MeasuredStart
from resc.deployment.wire import mavlink, now_s, parsed
from resc.envs.quadrotor import QuadrotorEnv
from resc.errors import ConfigError
from resc.evaluation.campaign import Evaluation
from resc.evaluation.courses import Course
from resc.evaluation.setting import Rules
from resc.evaluation.suites import scenes_to_fly
from resc.flying.flight_log import FlightLog
from resc.flying.flights import require_time_limit
from resc.flying.loop import flown
from resc.flying.pilot import PolicyPilot
from resc.policies.stored import load_policy, policy_folder
from resc.process import prepare_process
from resc.schema import FlySchema
from resc.settings import check_settings
from resc.starting.composed import compose_scenes, given

PARTS = {
    "dynamics": "resc.deployment.vehicle.LinkedVehicle",
    "rate_loop": "resc.deployment.vehicle.FlightControllersLoop",
}
START = "resc.deployment.vehicle.MeasuredStart"
STOPPED = {"_target_": "resc.deployment.vehicle.LinkStopped"}
ARRIVED = "arrived"
BATCH_STEPS = 10
"""Steps recorded at once: to record a hundred would take half a control period."""
REHEARSED = 10
"""Steps before a flight, of a vehicle that stands."""


def linked(evaluation: Evaluation) -> Evaluation:
    """The same evaluation, but the vehicle is the one behind a link.

    Raises:
        ConfigError: Settings ask for another vehicle than that.
    """
    config = evaluation.config
    for name in (*PARTS, "randomization", "estimator"):
        if config[name]:
            raise ConfigError(f"{name} is the real vehicle's here; leave out {name}=.")
    if config["compile"]:
        raise ConfigError(
            "compile is true, but a vehicle behind a link is not compiled; leave it out."
        )
    parts = {name: {"_target_": target} for name, target in PARTS.items()}
    task = {**config["task"], "initial_state": {"_target_": START}}
    termination = {"link": STOPPED, **config["termination"]}
    return replace(evaluation, config={**config, **parts, "task": task, "termination": termination})


@dataclass(frozen=True)
class Prepared:
    """What a flight needs, all of it checked.

    Args:
        course: The scene, laid out and planned.
        rules: What it is flown under.
        env: One row, in the scene.
        pilot: The policy.
    """

    course: Course
    rules: Rules
    env: QuadrotorEnv
    pilot: PolicyPilot

    @property
    def start_w(self) -> np.ndarray:
        """Where the flight begins, without jitter [m]."""
        return self.course.nominal_w[0].double().numpy()

    def geofence(self, height_m: tuple[float, float]) -> Geofence:
        """The sides of the map, and heights."""
        layout = self.course.layout
        low, size = layout.origin_w[0].tolist(), layout.size[0].tolist()
        high = [side + length for side, length in zip(low, size, strict=True)]
        return Geofence((*low, height_m[0]), (*high, height_m[1]))


def one_flight(evaluation: Evaluation) -> tuple[Course, Rules]:
    """The one flight of an evaluation, and what it is flown under.

    Raises:
        ConfigError: It is of several scenes, or of one that brings its own route.
    """
    contest = evaluation.contest()
    flights = sum(len(course) for course in contest.courses)
    if flights != 1:
        raise ConfigError(
            f"{flights} flights are asked for; name one scene, such as 'scenes=[paper4_map15]', "
            "and leave flights at 1."
        )
    (course,) = contest.courses
    if course.own_routes:
        raise ConfigError(
            f"scene {course.name} brings its own route, and begins in flight; give one that knows "
            "its start and its goal, such as paper4_map15."
        )
    return course, contest.rules_of(course)


def prepare(evaluation: Evaluation) -> Prepared:
    """What the one flight of an evaluation needs.

    Raises:
        ConfigError: See `one_flight`; or nothing ends a flight that hovers for ever.
    """
    course, rules = one_flight(evaluation)
    require_time_limit(rules.stages)
    return Prepared(course, rules, rules.env([course]), PolicyPilot(evaluation.policy))


@dataclass(frozen=True)
class Command:
    """What the commands of this room begin with.

    Args:
        config: Of fly.yaml.
        folder: Where what it leaves goes.
    """

    config: DictConfig
    folder: Path

    def check(self) -> None:
        """Looks at what can be wrong before anything is laid out.

        Raises:
            ConfigError: A setting is wrong, or pymavlink is not installed.
        """
        check_settings(self.config, FlySchema)
        OmegaConf.resolve(self.config)
        prepare_process(self.config["threads"], self.config["device"])
        mavlink()
        parsed(self.config["connection"])

    def evaluation(self, **changes: object) -> Evaluation:
        """The evaluation that a flight is prepared as; `changes` are settings."""
        config = self.config
        names = scenes_to_fly(config["scenes"], config["suite"], given())
        scenes = compose_scenes(names, config["scene"])
        folder = str(policy_folder(config["policy"], "policy"))
        policy = load_policy(Path(folder), config["device"], config["allowed_targets"])
        plain = {str(name): config[name] for name in config if name not in ("link", "peer")}
        return Evaluation({**plain, "policy": folder, **changes}, policy, scenes, given())


@torch.no_grad()
def fly_linked(prepared: Prepared, link: Link, directory: Path, *, arm: bool) -> dict[str, Any]:
    """Engages and flies until the flight is over; returns what came of it.

    Whatever ends the flight, the recording holds all steps before.

    Raises:
        LinkError: The vehicle does not go into OFFBOARD, or something stops it before it does.
    """
    env, pilot, rules = prepared.env, prepared.pilot, prepared.rules
    recorder = rules.recorded.open(
        env.stages, directory=directory, num_envs=1, facts={"pilot": "policy", **pilot.facts()}
    )
    vehicle, start = env.stages.terms.dynamics, env.stages.terms.initial_state
    assert isinstance(vehicle, LinkedVehicle)
    assert isinstance(start, MeasuredStart)
    try:
        _rehearse(env, pilot)
        gc.collect()
        gc.freeze()  # for good: or the collector looks through all that was imported, in flight
        link.engage(arm=arm)
        vehicle.link = start.link = link
        env.restart(torch.arange(1))
        pilot.begin(1, env.stages, env.pool.shared)
        log = None if recorder is None else FlightLog(recorder, env, BATCH_STEPS)
        try:
            return _steps(env, pilot, link, log)
        finally:
            if log is not None:
                log.flush()
    finally:
        link.hand_over()
        vehicle.link = start.link = None
        if recorder is not None:
            recorder.close()


def _rehearse(env: QuadrotorEnv, pilot: PolicyPilot) -> None:
    """Does once what a flight does, with a vehicle that stands: first times are slow."""
    env.restart(torch.arange(1))
    pilot.begin(1, env.stages, env.pool.shared)
    for _ in range(REHEARSED):
        env.advance(pilot.act(env.world, env.observation))


def _steps(
    env: QuadrotorEnv, pilot: PolicyPilot, link: Link, log: FlightLog | None
) -> dict[str, Any]:
    flying, began_s = torch.ones(1, 1, dtype=torch.bool), now_s()

    def actions() -> Iterator[Tensor]:
        while True:
            yield pilot.act(env.world, env.observation)

    for before, action, out in flown(env, actions()):
        done = bool(out.done)
        if done:
            link.hand_over()
        if log is not None:
            log.step(before, action, out, flying)
        if done:
            code = int(out.outcome)
            metrics = {t.name: float(env.value_of(t.outputs[0])) for t in env.stages.terms.metrics}
            outcome = env.stages.outcomes[code] if code else ARRIVED
            steps = int(env.value_of(keys.CLOCK))
            return {"outcome": outcome, "flown_s": now_s() - began_s, "steps": steps, **metrics}
    raise AssertionError("actions never end")
