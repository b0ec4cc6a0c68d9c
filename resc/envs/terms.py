"""What an environment is made of."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from resc.term import (
    Action,
    Estimator,
    Metric,
    Observation,
    Randomization,
    Replanning,
    Reward,
    Sensing,
    Sensor,
    Term,
    Termination,
)


@dataclass(frozen=True)
class Terms:
    """Everything an environment is made of, in the order it runs.

    Observations in the order of the policy's input; `critic_observations` are seen by the value
    function alone. Without an estimator, the policy sees the true state; without a sensing, the
    whole map.
    """

    action: Action
    rate_loop: Term
    dynamics: Term
    task: Term
    initial_state: Term
    sensors: Sequence[Sensor]
    terminations: Sequence[Termination]
    rewards: Sequence[Reward]
    observations: Sequence[Observation]
    randomizations: Sequence[Randomization] = field(default_factory=tuple)
    metrics: Sequence[Metric] = field(default_factory=tuple)
    critic_observations: Sequence[Observation] = field(default_factory=tuple)
    estimator: Estimator | None = None
    sensing: Sensing | None = None
    replanning: Replanning | None = None

    @property
    def measuring(self) -> list[Term]:
        """What sees the map, the sensors, then what estimates the state from these."""
        seeing = [self.sensing] if self.sensing else []
        return [*seeing, *self.sensors, *([self.estimator] if self.estimator else [])]

    @property
    def observed(self) -> list[Observation]:
        """What the policy sees, then what the value function sees in addition."""
        return [*self.observations, *self.critic_observations]

    def __iter__(self) -> Iterator[Term]:
        """Every term, in the order of a step, the reset's terms first."""
        yield from self.randomizations
        yield self.initial_state
        yield from (self.action, self.rate_loop, self.dynamics, self.task)
        for stage in (
            self.measuring,
            self.terminations,
            self.rewards,
            self.metrics,
            [self.replanning] if self.replanning else [],
            self.observed,
        ):
            yield from stage


def sensors_read_by(readers: Iterable[Term], sensors: Sequence[Sensor]) -> list[Sensor]:
    """The sensors that the terms read, and those that these read."""
    wanted = {key for term in readers for key in term.reads}
    found: list[Sensor] = []
    for sensor in reversed(sensors):
        if wanted.intersection(sensor.outputs):
            found.insert(0, sensor)
            wanted.update(sensor.reads)
    return found
