"""Closed-loop flights: every row of an environment flies exactly one episode."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Bool, Float, Int
from tensordict import TensorDict
from torch import Tensor

from resc import keys
from resc.console import progress
from resc.envs.quadrotor import QuadrotorEnv
from resc.envs.stages import Stages
from resc.errors import ConfigError
from resc.flying.flight_log import FlightLog
from resc.flying.loop import flown
from resc.flying.pilot import Pilot, PlanningCall
from resc.recording.rollouts import RecordedRun
from resc.recording.writer import RolloutRecorder


@dataclass(frozen=True)
class Flights:
    """What came of one episode per row; all on the CPU.

    `position_w` and `velocity_w` begin with the start, and stay at their last value once a flight
    is over. `counted` is the number of steps up to the finish, over which the metrics run; with
    them go the numbers that the pilot measures itself. `calls` are those of what plans for it.
    """

    outcomes: tuple[str, ...]
    outcome: Int[Tensor, " n"]
    collided: Bool[Tensor, " n"]
    steps: Int[Tensor, " n"]
    counted: Int[Tensor, " n"]
    dt_s: float
    metrics: dict[str, Float[Tensor, " n"]]
    position_w: Float[Tensor, "t n 3"]
    velocity_w: Float[Tensor, "t n 3"]
    wall_s: float
    calls: Sequence[PlanningCall] = ()

    def __len__(self) -> int:
        return len(self.outcome)

    @property
    def success(self) -> Bool[Tensor, " n"]:
        """Which flights reached their goal."""
        return self.outcome == 0

    @property
    def success_rate(self) -> float:
        """Share of flights that reached their goal."""
        return float(self.success.double().mean())

    @property
    def collision_rate(self) -> float:
        """Share of flights that ended in an obstacle."""
        return float(self.collided.double().mean())

    @property
    def rates(self) -> dict[str, float | int]:
        """How many flights there are, and both shares."""
        rates = {"success_rate": self.success_rate, "collision_rate": self.collision_rate}
        return {"episodes": len(self), **rates}

    @property
    def names(self) -> list[str]:
        """The outcome of each flight."""
        return [self.outcomes[number] for number in self.outcome.tolist()]

    @property
    def frames(self) -> int:
        """Steps flown by all flights together."""
        return int(self.steps.sum())

    def rows(self, start: int, stop: int) -> "Flights":
        """Some of the flights."""
        of = slice(start, stop)
        columns = ("outcome", "collided", "steps", "counted")
        single = {name: getattr(self, name)[of] for name in columns}
        traces = {name: getattr(self, name)[:, of] for name in ("position_w", "velocity_w")}
        metrics = {name: values[of] for name, values in self.metrics.items()}
        calls = [
            c._replace(flight=c.flight - start) for c in self.calls if start <= c.flight < stop
        ]
        return replace(self, **single, **traces, metrics=metrics, calls=calls)


@torch.no_grad()
def fly(
    env: QuadrotorEnv,
    pilot: Pilot,
    *,
    trace: bool = True,
    recorder: RolloutRecorder | None = None,
) -> Flights:
    """Flies one episode in every row, all at once; rows that are done wait in their last state.

    Raises:
        ConfigError: No termination ends a flight that hovers for ever.
    """
    require_time_limit(env.stages)
    began = time.perf_counter()
    env.restart(torch.arange(env.num_envs))
    pilot.begin(env.num_envs, env.stages, env.pool.shared)
    log = None if recorder is None else FlightLog(recorder, env)
    over = torch.zeros(env.num_envs, 1, dtype=torch.bool, device=env.device)
    outcome, steps, counted = (torch.zeros_like(over, dtype=torch.int64) for _ in range(3))
    traces, dt_s = [_state_of(env)], env.stages.context.dt_s

    def actions() -> Iterator[Tensor]:
        while not over.all():
            # A row that waits hovers: its state is put back, but must stay finite until then.
            yield torch.where(over, 0.0, pilot.act(env.world, env.observation))

    with progress(env.num_envs, desc="flying", unit="flight") as bar:
        for before, action, out in flown(env, actions()):
            counted += ~(over | before[keys.FINISHED])
            if log is not None:
                log.step(before, action, out, ~over)
            if over.any():
                old = TensorDict(before, batch_size=[env.num_envs])
                env.world = TensorDict.where(old, over[:, 0], env.world)
            steps += ~over
            ended = out.done & ~over
            outcome = torch.where(ended, out.outcome, outcome)
            over = over | ended
            if trace:
                traces.append(_state_of(env))
            bar.set_postfix_str(f"{int(steps.max()) * dt_s:.1f} s flown", refresh=False)
            bar.update(int(ended.sum()))
    if log is not None:
        log.flush()
    position, velocity = (torch.stack(part) for part in zip(*traces, strict=True))
    metrics = {t.name: env.value_of(t.outputs[0])[:, 0].cpu() for t in env.stages.terms.metrics}
    return Flights(
        outcomes=env.stages.outcomes,
        outcome=outcome[:, 0].cpu(),
        collided=_is_collision(env)[outcome[:, 0].cpu()],
        steps=steps[:, 0].cpu(),
        counted=counted[:, 0].cpu(),
        dt_s=dt_s,
        metrics={**metrics, **pilot.measured()},
        calls=pilot.calls(),
        position_w=position,
        velocity_w=velocity,
        wall_s=time.perf_counter() - began,
    )


def fly_recorded(
    env: QuadrotorEnv,
    pilot: Pilot,
    recorded: RecordedRun,
    directory: Path,
    *,
    trace: bool = True,
) -> Flights:
    """`fly`, recorded.

    Args:
        env: What is flown.
        pilot: What flies.
        recorded: How; its configuration is what the environment was built from.
        directory: Where the recording goes.
        trace: Whether positions and velocities are kept.

    Raises:
        RescError: The pilot cannot fly this environment.
    """
    pilot.check(env.stages)
    facts = {"pilot": pilot.name, **pilot.facts()}
    recorder = recorded.open(env.stages, directory=directory, num_envs=env.num_envs, facts=facts)
    try:
        return fly(env, pilot, trace=trace, recorder=recorder)
    finally:
        if recorder is not None:
            recorder.close()


def require_time_limit(stages: Stages) -> None:
    """Raises ConfigError if no termination ends a flight that hovers for ever."""
    if not any(term.truncates for term in stages.terms.terminations):
        raise ConfigError(
            "termination has no time limit, so a flight may never end; add time_limit."
        )


def _state_of(env: QuadrotorEnv) -> tuple[Tensor, Tensor]:
    return env.value_of(keys.POSITION_W).cpu().clone(), env.value_of(keys.VELOCITY_W).cpu().clone()


def _is_collision(env: QuadrotorEnv) -> Bool[Tensor, " o"]:
    """For each outcome, whether it is a collision with an obstacle."""
    failures = [term for term in env.stages.terms.terminations if not term.success]
    return torch.tensor([False, *(term.collision for term in failures)])
