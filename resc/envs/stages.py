"""The control step and the reset as pure functions of tensors, assembled from terms."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor, nn

from resc import keys
from resc.errors import ConfigError
from resc.keys import DECLARED, NestedKey, previous
from resc.math.rotation import heading
from resc.math.route import next_two
from resc.simulation.vehicle import GRAVITY_MPS2
from resc.term import (
    Action,
    Context,
    Metric,
    Observation,
    Randomization,
    Reward,
    Sensor,
    Term,
    Termination,
)

World = dict[NestedKey, Tensor]

SUCCESS = "success"


@dataclass(frozen=True)
class Terms:
    """Everything an environment is made of, in the order it runs.

    Observations in the order of the policy's input.
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

    def __iter__(self) -> Iterator[Term]:
        """Every term, in the order of a step, the reset's terms first."""
        yield from self.randomizations
        yield self.initial_state
        yield from (self.action, self.rate_loop, self.dynamics, self.task)
        for stage in (
            self.sensors,
            self.terminations,
            self.rewards,
            self.metrics,
            self.observations,
        ):
            yield from stage


class StepOutput(NamedTuple):
    """What a step tells the learner.

    Rows that are done still show the last observation of their episode.
    """

    observation: Tensor
    reward: Tensor
    terminated: Tensor
    truncated: Tensor
    done: Tensor
    outcome: Tensor
    reward_terms: Tensor


class Stages(nn.Module):
    """Runs terms in the order of the architecture's stages, on flat dicts of tensors.

    Args:
        terms: The terms.
        context: Constants of their surroundings.
        scene_difficulty: Name of the difficulty that scenes are laid out at, if one eases them.

    Raises:
        ConfigError: A term reads a key that nothing before it writes.
    """

    def __init__(self, terms: Terms, context: Context, scene_difficulty: str | None = None) -> None:
        super().__init__()
        self.terms = terms
        self.scene_difficulty = scene_difficulty
        readers = {"scene": scene_difficulty}
        readers |= {term.path: term.difficulty for term in terms}
        self.eased = {path: name for path, name in readers.items() if name}
        self.difficulties = tuple(dict.fromkeys(self.eased.values()))
        self.modules_of_terms = nn.ModuleList(
            list(terms)
        )  # so that .to(device) reaches their buffers
        self.context = context
        for term in terms:
            _bind(term, context)
        for term in terms.observations:
            term.history = term.history or context.history
        for name, value in context.vehicle.parameters().items():
            self.register_buffer(_buffer_name(name), value, persistent=False)
        own = {key for term in terms for key in (*term.outputs, *term.initial)}
        read = {key for term in terms for key in term.reads}
        wanted = {key for key in read if key[0] == "memory" and key not in own}
        if terms.metrics:
            wanted.add(previous(keys.FINISHED))
        self.memory = sorted(wanted)
        self.outcomes = (SUCCESS, *(term.name for term in terms.terminations if not term.success))
        self._check_wiring()

    @property
    def observation_columns(self) -> list[str]:
        """Names of the observation's numbers: term.column."""
        return [
            f"{term.name}.{column}"
            for term in self.terms.observations
            for column in term.column_names
        ]

    @property
    def reset_draws(self) -> dict[str, int]:
        """Widths of the uniform blocks drawn at every reset alone, by generator."""
        drawing = (*self.terms.randomizations, self.terms.initial_state)
        return {term.name: term.draws for term in drawing if term.draws}

    @property
    def step_draws(self) -> dict[str, int]:
        """Widths of the uniform blocks drawn anew at every step and reset, by generator.

        An observation's noise has a generator of its own, so that it leaves its other draws alone.
        """
        own = {_draws(term): term.step_draws for term in self.terms.observations}
        noise = {_noise(term): len(term.columns) for term in self.terms.observations if term.noise}
        return {name: width for name, width in (own | noise).items() if width}

    def step(
        self, world: World, shared: World, action: Tensor, drawn: Mapping[str, Tensor]
    ) -> tuple[World, StepOutput]:
        """One control step of every environment: the next world and what the learner sees of it.

        `drawn` holds the blocks [n, width] that `step_draws` names.
        """
        terms = self.terms
        tensors = {**world, **shared, keys.ACTION: action, keys.CLOCK: world[keys.CLOCK] + 1}
        for key in self.memory:
            tensors[key] = world[key[1:]]
        for term in (
            terms.action,
            terms.rate_loop,
            terms.dynamics,
            terms.task,
            *terms.sensors,
            *terms.terminations,
        ):
            term.run(tensors)
        self._finish(tensors)
        for term in terms.rewards:
            term.run(tensors)
        reward_terms = torch.cat([term.weighted(tensors) for term in terms.rewards], -1)
        for term in terms.metrics:
            self._advance_metric(term, tensors)
        out = StepOutput(
            observation=self._observe(tensors, drawn, first=False),
            reward=reward_terms.sum(-1, keepdim=True),
            terminated=tensors[keys.TERMINATED],
            truncated=tensors[keys.TRUNCATED],
            done=tensors[keys.DONE],
            outcome=tensors[("outcome",)],
            reward_terms=reward_terms,
        )
        return {key: tensors[key] for key in world}, out

    def restart(
        self,
        tasks: World,
        index: Tensor,
        shared: World,
        drawn: Mapping[str, Tensor],
        difficulties: Mapping[str, Tensor],
    ) -> tuple[World, Tensor]:
        """World and observation of episodes that begin in the pool's entries `index` [k, 1].

        They keep the `difficulties` [1, 1] of now, that of the scene as the entry was laid out.
        """
        terms = self.terms
        count = index.shape[0]
        tensors = {**shared, keys.SCENE_INDEX: index}
        for key, value in tasks.items():
            tensors[key] = value[index[:, 0]]
        for name in self.difficulties:
            own = name == self.scene_difficulty
            level = tensors[keys.SCENE_DIFFICULTY] if own else difficulties[name]
            tensors[keys.difficulty(name)] = level.expand(count, 1)
        for key in self.context.vehicle.parameters():
            tensors[key] = getattr(self, _buffer_name(key)).expand(count, -1)
        for term in (*terms.randomizations, terms.initial_state):
            term.run(tensors, *([drawn[term.name]] if term.draws else []))
        start = tensors[keys.POSITION_W]
        zero = start[:, :1] * 0
        hover = tensors[keys.MASS] * (GRAVITY_MPS2 / 4)
        length = tensors[keys.ROUTE_LENGTH]
        tensors |= {
            keys.CLOCK: zero,
            keys.ACCELERATION_W: torch.zeros_like(start),
            keys.ROTOR_THRUST: hover.expand(-1, 4),
            keys.ROUTE_INDEX: torch.zeros_like(length),
            keys.FINISHED: torch.zeros_like(length, dtype=torch.bool),
            keys.CONTROL_POINTS_W: next_two(
                tensors[keys.ROUTE_W], length, torch.zeros_like(length)
            ),
        }
        for term in terms:
            for key, value in term.initial.items():
                tensors[key] = start.new_full((count, *_shape(key, term)), value)
        for term in terms.metrics:
            tensors[term.outputs[0]] = zero + term.start
        return self.begin(tensors, shared, drawn)

    def begin(
        self, world: World, shared: World, drawn: Mapping[str, Tensor]
    ) -> tuple[World, Tensor]:
        """World and first observation of episodes that begin with the given world."""
        tensors = {**world, **shared}
        for key in self.memory:
            tensors[key] = tensors[key[1:]]
        for term in self.terms.sensors:
            if all(key in tensors for key in term.reads):
                term.run(tensors)
        observation = self._observe(tensors, drawn, first=True)
        return {key: tensors[key] for key in self.persistent}, observation

    @property
    def persistent(self) -> list[NestedKey]:
        """Keys of the world: what one step hands to the next."""
        state = [key for key in DECLARED if key[0] in ("state", "params")]
        task = [
            keys.ROUTE_W,
            keys.ROUTE_LENGTH,
            keys.ROUTE_INDEX,
            keys.CONTROL_POINTS_W,
            keys.FINISHED,
        ]
        drawn = [key for term in self.terms.randomizations for key in term.outputs]
        kept = [key for term in self.terms for key in term.initial]
        metrics = [term.outputs[0] for term in self.terms.metrics]
        seen = [t.outputs[0] for t in self.terms.observations if t.width > len(t.columns)]
        eased = [keys.difficulty(name) for name in self.difficulties]
        kept = list(dict.fromkeys([*(key for key in drawn if key not in state), *kept]))
        return [*state, keys.CLOCK, keys.SCENE_INDEX, *task, *kept, *metrics, *seen, *eased]

    def _finish(self, tensors: World) -> None:
        """Combines the terminations into terminated, truncated, done and the outcome's number."""
        finished = tensors[keys.FINISHED]
        none = torch.zeros_like(finished)
        terminated, truncated = none, none
        outcome = torch.zeros_like(finished, dtype=torch.int64)
        failures = [term for term in self.terms.terminations if not term.success]
        for term in self.terms.terminations:
            happened = tensors[term.outputs[0]]
            if term.truncates:
                truncated = truncated | happened
            else:
                terminated = terminated | happened
        for number, term in reversed(list(enumerate(failures, start=1))):
            outcome = torch.where(tensors[term.outputs[0]], number, outcome)
        tensors[keys.TERMINATED] = terminated
        tensors[keys.TRUNCATED] = truncated & ~terminated
        tensors[keys.DONE] = terminated | truncated
        tensors[("outcome",)] = torch.where(finished, 0, outcome)

    def _advance_metric(self, term: Metric, tensors: World) -> None:
        key = term.outputs[0]
        value = term.compute(tensors[key], *(tensors[k] for k in term.reads))
        if term.freezes_at_finish:
            value = torch.where(tensors[previous(keys.FINISHED)], tensors[key], value)
        tensors[key] = value

    def _observe(self, tensors: World, drawn: Mapping[str, Tensor], *, first: bool) -> Tensor:
        """All blocks [n, width]; those with a history are kept in the world under their key."""
        turning = self.context.observation_frame == "heading"
        ahead = heading(tensors[keys.ATTITUDE_WB]) if turning else None
        blocks = []
        for term in self.terms.observations:
            own = [drawn[_draws(term)]] if term.step_draws else []
            block = term.compute(*(tensors[key] for key in term.reads), *own)
            if ahead is not None:
                block = term.turned(block, ahead)
            block = term.shaped(block, drawn[_noise(term)] if term.noise else None)
            one = len(term.columns)
            if term.width > one:
                (key,) = term.outputs
                past = block.repeat(1, term.width // one - 1) if first else tensors[key][:, :-one]
                block = tensors[key] = torch.cat((block, past), -1)
            blocks.append(block)
        return torch.cat(blocks, -1)

    def _check_wiring(self) -> None:
        """Every key a term reads must be there before it runs, for observations at a reset too."""
        kept = set(self.persistent)
        past = {key for key in self.memory if key[1:] in kept}
        shared = {key for key, declared in DECLARED.items() if declared.shared}
        of_scene = {keys.START_W, keys.START_MOTION, keys.ROUTE_CLEARANCE}
        at_reset = shared | kept | past | of_scene | {keys.CLOCK}
        known = at_reset | {keys.ACTION}
        for term in self.terms:
            if isinstance(term, Reward):
                known |= {keys.TERMINATED, keys.TRUNCATED, keys.DONE}
            _require(term, known, "which nothing before it writes")
            known |= set(term.outputs)
        for term in self.terms.sensors:
            at_reset |= set(term.outputs) if at_reset.issuperset(term.reads) else set()
        for term in self.terms.observations:
            _require(term, at_reset, "which an episode does not begin with")


def _bind(term: Term, context: Context) -> None:
    try:
        term.bind(context)
    except ConfigError as error:
        raise ConfigError(f"{term.path}: {error}") from None


def _require(term: Term, known: set[NestedKey], fact: str) -> None:
    for key in term.reads:
        if not isinstance(key, tuple):
            raise ConfigError(
                f"{term.path} reads {key!r}, which is no key; reads is a tuple of keys such as "
                "(keys.POSITION_W,) with its comma."
            )
        if key not in known:
            raise ConfigError(
                f"{term.path} reads {'.'.join(key)}, {fact}; "
                "add a term that writes it, or drop this one."
            )


def _draws(term: Observation) -> str:
    """Name of the generator of an observation's own draws."""
    return f"observation.{term.name}"


def _noise(term: Observation) -> str:
    """Name of the generator of an observation's noise."""
    return f"observation.{term.name}.noise"


def _buffer_name(key: NestedKey) -> str:
    return "nominal_" + "_".join(key)


def _shape(key: NestedKey, term: Term) -> tuple[int, ...]:
    """Shape per environment of a key that a term keeps."""
    dims = getattr(term, "dims", {})
    declared = DECLARED[key].shape if key in DECLARED else (1,)
    return tuple(dims[d] if isinstance(d, str) else d for d in declared)
