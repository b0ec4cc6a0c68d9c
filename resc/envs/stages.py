"""The control step and the reset as pure functions of tensors, assembled from terms."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor, nn

from resc import keys
from resc.envs.terms import Terms, sensors_read_by
from resc.envs.wiring import check_wiring
from resc.errors import ConfigError
from resc.keys import DECLARED, NestedKey, previous
from resc.math import stream
from resc.math.repeat import repeated
from resc.math.rotation import heading
from resc.simulation import gyro
from resc.term import (
    Context,
    Device,
    Estimator,
    Term,
)

World = dict[NestedKey, Tensor]

SUCCESS = "success"


class StepOutput(NamedTuple):
    """What a step tells the learner.

    Rows that are done still show the last observation of their episode.
    """

    observation: Tensor
    observation_critic: Tensor
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
        self.drawn = tuple(key for term in terms.randomizations for key in term.outputs)
        planned = terms.replanning.keeps if terms.replanning else ()
        for term in terms:
            term.vary({*self.drawn, *planned})
        self._bind_terms(terms)
        for term in terms.observed:
            term.history = term.history or context.history
        for name, value in context.vehicle.parameters().items():
            self.register_buffer(_buffer_name(name), value, persistent=False)
        own = {key for t in terms for key in (*t.outputs, *t.initial, *t.keeps)}
        read = {key for term in terms for key in term.reads}
        wanted = {key for key in read if key[0] == "memory" and key not in own}
        if terms.metrics:
            wanted.add(previous(keys.FINISHED))
        self.memory = sorted(wanted)
        self.functions = [t for t in terms.sensors if not isinstance(t, Device)]
        self.devices = [t for t in terms.measuring if isinstance(t, Device | Estimator)]
        self.functions_seen = sensors_read_by(terms.observations, self.functions)
        self.outcomes = (SUCCESS, *(term.name for term in terms.terminations if not term.success))
        past = {key for key in self.memory if key[1:] in set(self.persistent)}
        check_wiring(terms, at_begin={*self.persistent, *past}, functions=self.functions)

    @property
    def observation_columns(self) -> list[str]:
        """Names of the observation's numbers: term.column."""
        return [
            f"{term.name}.{column}"
            for term in self.terms.observations
            for column in term.column_names
        ]

    @property
    def widths(self) -> tuple[int, int]:
        """Numbers that the policy sees, and those that the value function sees beside them."""
        own = sum(term.width for term in self.terms.observations)
        return own, sum(term.width for term in self.terms.critic_observations)

    @property
    def waits(self) -> bool:
        """Whether a step asks for numbers of tensors on its way, as scans and searches do."""
        return self.terms.sensing is not None or self.terms.replanning is not None

    @property
    def reset_draws(self) -> dict[str, int]:
        """Widths of the uniform blocks drawn at every reset alone, by generator."""
        drawing = (*self.terms.randomizations, self.terms.initial_state)
        return {term.name: term.draws for term in drawing if term.draws}

    @property
    def step_draws(self) -> dict[str, int]:
        """Widths of the uniform blocks drawn at every step and reset, by generator."""
        return {name: width for term in self.terms for name, width in term.blocks.items()}

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
        _run(terms.action, tensors, drawn)
        self.move(tensors, drawn)
        for term in (terms.task, *terms.measuring, *terms.terminations):
            _run(term, tensors, drawn)
        self._finish(tensors)
        for term in (*terms.rewards, *terms.metrics):
            _run(term, tensors, drawn)
        reward_terms = torch.cat([term.weighted(tensors) for term in terms.rewards], -1)
        self._replan(tensors)
        observation, critic = self._observe(tensors, drawn).split(self.widths, -1)
        out = StepOutput(
            observation=observation,
            observation_critic=critic,
            reward=reward_terms.sum(-1, keepdim=True),
            terminated=tensors[keys.TERMINATED],
            truncated=tensors[keys.TRUNCATED],
            done=tensors[keys.DONE],
            outcome=tensors[("outcome",)],
            reward_terms=reward_terms,
        )
        return {key: tensors[key] for key in world} | self._measured(tensors), out

    def _measured(self, tensors: World) -> World:
        """All that is measured and estimated, with the strides that it has after a reset.

        What is compiled holds for one stride only.
        """
        return {key: tensors[key].contiguous() for term in self.devices for key in term.outputs}

    def restart(
        self,
        tasks: World,
        index: Tensor,
        shared: World,
        drawn: Mapping[str, Tensor],
        difficulties: Mapping[str, Tensor],
    ) -> tuple[World, Tensor]:
        """World and observations of episodes that begin in the pool's entries `index` [k, 1].

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
        zero = tensors[keys.POSITION_W][:, :1] * 0
        tensors |= {keys.CLOCK: zero, keys.FINISHED: torch.zeros_like(zero, dtype=torch.bool)}
        for term in terms:
            for key, value in term.initial.items():
                tensors[key] = zero.new_full((count, *_shape(key, term)), value)
            tensors |= term.begin(self._sensed(tensors) if term is terms.rate_loop else tensors)
        self._require_begun(tensors)
        self._measure_first(tensors, drawn)
        return self.begin(tensors, shared, drawn)

    def restart_rows(
        self,
        world: World,
        observations: tuple[Tensor, Tensor],
        rows: Tensor,
        entry: Tensor,
        tasks: World,
        shared: World,
        drawn: dict[str, Tensor],
        difficulties: dict[str, Tensor],
    ) -> None:
        """Begins episodes as `restart` does, in some rows of a world and of what is observed."""
        fresh, seen = self.restart(tasks, entry, shared, drawn, difficulties)
        for key, value in fresh.items():
            world[key].index_copy_(0, rows, value)
        for observation, part in zip(observations, seen.split(self.widths, -1), strict=True):
            observation.index_copy_(0, rows, part)

    def begin(
        self, world: World, shared: World, drawn: Mapping[str, Tensor]
    ) -> tuple[World, Tensor]:
        """World and first observation of episodes that begin with the given world."""
        return self.observe(world, shared, drawn, first=True)

    def look_again(self, world: World, shared: World) -> World:
        """The maps that were known where episodes began, of worlds that lack them.

        They are what the first look shows, with the noise that the world tells.
        """
        sensing = self.terms.sensing
        assert sensing is not None, "nothing is seen of the map"
        tensors = {**world, **shared}
        place = tensors.get(keys.SENSING_STREAM)
        tensors |= sensing.begin(tensors)
        _run(sensing, tensors, {} if place is None else {sensing.path: stream.units(place)})
        return {key: tensors[key] for key in keys.KNOWN_MAP}

    def observe(
        self, world: World, shared: World, drawn: Mapping[str, Tensor], *, first: bool
    ) -> tuple[World, Tensor]:
        """The world and all that is observed of it, `first` in an episode or later.

        Later, `world` may hold what was remembered of the step before, under `memory`; by default
        that is as now. What devices read, and what is estimated from it, is in the world.
        """
        tensors = {**world, **shared}
        for key in self.memory:
            tensors.setdefault(key, tensors[key[1:]])
        for term in self.terms.observed if first else ():
            tensors.pop(term.outputs[0], None)  # an episode that begins has no past
        for term in self.functions:
            if all(key in tensors for key in term.reads):
                _run(term, tensors, drawn)
        observation = self._observe(tensors, drawn)
        return {key: tensors[key] for key in self.persistent}, observation

    @property
    def persistent(self) -> list[NestedKey]:
        """Keys of the world: what one step hands to the next."""
        state = [key for key in DECLARED if key[0] in ("state", "params")]
        task = [*self.terms.task.keeps, keys.FINISHED]
        kept = [key for term in self.terms for key in (*term.initial, *term.keeps)]
        eased = [keys.difficulty(name) for name in self.difficulties]
        every = [*state, keys.CLOCK, keys.SCENE_INDEX, *task, *self.drawn, *kept, *eased]
        return list(dict.fromkeys(every))

    def _bind_terms(self, terms: Terms) -> None:
        """Gives every term its surroundings; the dynamics get the part of a step between runs."""
        for term in terms:
            if term is not terms.dynamics:
                _bind(term, self.context)
        runs = terms.rate_loop.runs
        part = replace(self.context, dt_s=self.context.dt_s / runs, runs=runs)
        _bind(terms.dynamics, part)

    def move(self, tensors: World, drawn: Mapping[str, Tensor]) -> None:
        """Rate loop and dynamics, as often as the rate loop runs in a control step."""
        loop, dynamics = self.terms.rate_loop, self.terms.dynamics
        if loop.runs == 1:
            self._control(tensors, drawn)
            _run(dynamics, tensors, drawn)
            return
        moved = tuple(dict.fromkeys((*loop.outputs, *dynamics.outputs, *self._noise)))

        def run(values: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
            now = tensors | dict(zip(moved, values, strict=True))
            self._control(now, drawn)
            _run(dynamics, now, drawn)
            return tuple(now[key].clone(memory_format=torch.contiguous_format) for key in moved)

        before = tensors[keys.VELOCITY_W]
        start = (tensors.get(key, _none_yet(key, before)) for key in moved)
        tensors |= zip(moved, repeated(run, tuple(start), loop.runs), strict=True)
        gained = tensors[keys.VELOCITY_W] - before
        tensors[keys.ACCELERATION_W] = gained / self.context.dt_s  # of the step, not of its parts

    def _control(self, tensors: World, drawn: Mapping[str, Tensor]) -> None:
        """A run of the rate loop, on the body rate that its gyroscope reads."""
        loop = self.terms.rate_loop
        seen = self._sensed(tensors)
        _run(loop, seen, drawn)
        if seen is not tensors:
            tensors |= {key: seen[key] for key in (*loop.outputs, *self._noise)}

    def _sensed(self, tensors: World) -> World:
        """The tensors with the body rate as the gyroscope reads it, where its errors are drawn."""
        if not self._noise:
            return tensors
        names = (keys.BODY_RATE_B, keys.GYRO_BIAS_B, keys.GYRO_NOISE, keys.GYRO_STREAM)
        reading, stream = gyro.reading(*(tensors[key] for key in names))
        return tensors | {keys.BODY_RATE_B: reading, keys.GYRO_STREAM: stream}

    @property
    def _noise(self) -> list[NestedKey]:
        """What the gyroscope's noise moves on, where it is drawn."""
        return [key for key in (keys.GYRO_STREAM,) if key in self.drawn]

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

    def _observe(self, tensors: World, drawn: Mapping[str, Tensor]) -> Tensor:
        """All blocks side by side, the policy's first [n, width]: it sees the estimated state."""
        believed = self._believed(tensors, drawn)
        blocks = []
        for seen, terms in (
            (believed, self.terms.observations),
            (tensors, self.terms.critic_observations),
        ):
            if self.context.observation_frame == "heading":
                seen[keys.AHEAD] = heading(seen[keys.ATTITUDE_WB])
            for term in terms:
                _run(term, seen, drawn)
                blocks.append(seen[term.outputs[0]])
        if believed is not tensors:
            tensors |= {t.outputs[0]: believed[t.outputs[0]] for t in self.terms.observations}
        return torch.cat(blocks, -1)

    def _believed(self, tensors: World, drawn: Mapping[str, Tensor]) -> World:
        """What the policy goes by: the estimated state and the known map for the true ones.

        With them goes what sensors make of them.
        Numbers that are not finite, which the environment refuses after the step, are 0: they would
        be looked up anywhere in the map.
        """
        if self.terms.estimator is None and self.terms.sensing is None:
            return tensors
        believed = dict(tensors)
        if self.terms.estimator:
            for true, key in keys.ESTIMATES.items():
                believed[true] = torch.nan_to_num(tensors[key], nan=0.0, posinf=0.0, neginf=0.0)
        if self.terms.sensing:
            believed |= _known_map(tensors)
        for term in self.functions_seen:
            _run(term, believed, drawn)
        return believed

    def _measure_first(self, tensors: World, drawn: Mapping[str, Tensor]) -> None:
        """First look at the map, first readings, first estimate, and first route of an episode."""
        if self.devices:
            tensors |= {key: tensors[key[1:]] for key in self.memory}
        for term in [*([self.terms.sensing] if self.terms.sensing else []), *self.devices]:
            _run(term, tensors, drawn)
        self._replan(tensors)

    def _replan(self, tensors: World) -> None:
        """Renews the routes, by the state that is estimated."""
        if term := self.terms.replanning:
            estimates = keys.ESTIMATES if self.terms.estimator else {}
            going_on = torch.zeros_like(tensors[keys.FINISHED])
            seen = {keys.DONE: going_on} | tensors
            seen |= {true: tensors[key] for true, key in estimates.items()}
            term.run(seen)
            tensors |= {key: seen[key] for key in term.outputs}

    def _require_begun(self, tensors: World) -> None:
        """What the world holds must have a value where an episode begins."""
        seen = {key for term in self.terms.observed for key in term.outputs}
        for key in self.persistent:
            if key not in tensors and key not in seen:
                makers = [term for term in self.terms if key in (*term.outputs, *term.keeps)]
                raise ConfigError(
                    f"{makers[0].path if makers else 'dynamics'} does not say what "
                    f"{'.'.join(key)} is at the beginning of an episode; add it to its begin()."
                )


def _bind(term: Term, context: Context) -> None:
    try:
        term.bind(context)
    except ConfigError as error:
        raise ConfigError(f"{term.path}: {error}") from None


def _run(term: Term, tensors: World, drawn: Mapping[str, Tensor]) -> None:
    """Runs a term with the blocks that it takes at every step."""
    term.run(tensors, *(drawn[name] for name in term.blocks))


def _known_map(tensors: World) -> World:
    """The map that each row knows, under the keys of the pool's: one entry for each row."""
    entry = tensors[keys.SCENE_INDEX][:, 0]
    own = torch.arange(len(entry), device=entry.device).unsqueeze(-1)
    corner = {key: tensors[key][entry] for key in (keys.MAP_ORIGIN_W, keys.MAP_SIZE)}
    if tensors[keys.MOVERS_W].shape[1]:
        corner[keys.MOVERS_W] = tensors[keys.MOVERS_W][entry]
    return {keys.ESDF: tensors[keys.KNOWN_ESDF], keys.SCENE_INDEX: own, **corner}


def _none_yet(key: NestedKey, like: Tensor) -> Tensor:
    """Zeros of the declared shape for every environment."""
    return like.new_zeros([len(like), *map(int, DECLARED[key].shape)])


def _buffer_name(key: NestedKey) -> str:
    return "nominal_" + "_".join(key)


def _shape(key: NestedKey, term: Term) -> tuple[int, ...]:
    """Shape per environment of a key that a term keeps."""
    declared = DECLARED[key].shape if key in DECLARED else (1,)
    return tuple(term.dims[d] if isinstance(d, str) else d for d in declared)
