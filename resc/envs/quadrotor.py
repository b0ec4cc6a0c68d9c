"""The TorchRL environment: a batch of quadrotors, each in a scene of the pool."""

from collections.abc import Sequence

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from resc import keys
from resc.cuda_graph import CudaGraph, copy_each
from resc.envs.calls import bad_action, blamed, require_action, require_measured, require_rows
from resc.envs.stages import Stages, StepOutput, World
from resc.envs.torchrl_face import TorchRlFace
from resc.envs.trial import check_terms, require_torch
from resc.errors import CallError, ConfigError
from resc.kept_program import compiled as compiled_program
from resc.process import require_memory
from resc.scenes.pool import ScenePool

BYTES_PER_ENVIRONMENT = 2048
"""At least: the world, the observation and what a step holds in between."""


class QuadrotorEnv(TorchRlFace):
    """`num_envs` quadrotors flying through scenes of a pool, one compiled control step at a time.

    Two faces of one simulation: TorchRL's `step` and `reset`, and, without their overhead of
    milliseconds a step, `advance` and `restart`, which training uses. All mutable state is `world`;
    a seed fixes every draw.

    Args:
        stages: The compiled-to-be functions.
        pool: Scenes to reset into.
        num_envs: Batch size.
        seed: Seed of every drawing term.
        device: Where the tensors live.
        compiled: Whether the step and the reset are compiled, and on a GPU replayed as graphs; the
            numbers agree to rounding. (TorchRL keeps the argument name `compile` for itself.)
        in_order: Resets walk through the pool, row i starting at entry i, instead of drawing
            entries: for evaluation.
        closed: Entries of the pool, next in turn for renewal, that no episode starts in.
        tried: Whether every term is tried first (`resc.envs.trial`); false for terms that were.
        facts: What step and reset depend on, so that their programs can be kept
            (`resc.kept_program`); empty where they are not.

    Episodes begin at full difficulty, or the greatest that scenes are laid out at, unless
    `set_difficulty` says otherwise.
    """

    def __init__(
        self,
        stages: Stages,
        pool: ScenePool,
        *,
        num_envs: int,
        seed: int = 0,
        device: torch.device | str = "cpu",
        compiled: bool = True,
        in_order: bool = False,
        closed: int = 0,
        tried: bool = True,
        facts: str = "",
    ) -> None:
        if num_envs < 1:
            raise ConfigError(f"num_envs is {num_envs}; expected at least 1.")
        require_memory(
            num_envs * BYTES_PER_ENVIRONMENT, f"num_envs is {num_envs}", "lower it", device
        )
        super().__init__(stages, num_envs, device)
        self.pool = pool
        self.in_order = in_order
        self.closed = closed
        self.visits = torch.zeros(num_envs, dtype=torch.int64)
        self.steps_taken = 0
        self.chunk = max(min(num_envs, 8), num_envs // 32)
        self._step_function = stages.step
        self._restart_function = stages.restart_rows
        if compiled:
            require_torch(stages)
            self._step_function = compiled_program(stages.step, facts)
            self._restart_function = compiled_program(stages.restart_rows, facts)
        self.graphed = compiled and self.device.type == "cuda" and not stages.waits
        if self.graphed:
            self._step_graph = CudaGraph(self._step_in_place)
            self._restart_graph = CudaGraph(self._restart_in_place)
        if tried:
            check_terms(self.stages, pool)
        self.difficulties = {
            name: torch.ones(1, 1, device=self.device) for name in stages.difficulties
        }
        self.scene_difficulty = pool.levels.tolist()[-1]
        if stages.scene_difficulty:
            self.difficulties[stages.scene_difficulty].fill_(self.scene_difficulty)
        self._world: World = {}
        self.before: World = {}
        self.set_seed(seed)

    @property
    def world(self) -> TensorDict:
        """All mutable state of the batch, as views."""
        return TensorDict(self._world, batch_size=[self.num_envs], device=self.device)

    @world.setter
    def world(self, value: TensorDictBase) -> None:
        self._take({key: value[key] for key in self.stages.persistent})

    @property
    def tensors(self) -> World:
        """The same by key, without a TensorDict around it."""
        return dict(self._world)

    def value_of(self, key: tuple[str, ...]) -> Tensor:
        """One entry of the world, a view."""
        self._require_reset()
        return self._world[key]

    def world_of(self, rows: Tensor) -> World:
        """State of some rows [k, ...], copied: all but the maps that they know."""
        kept = self._world.keys() - keys.KNOWN_MAP
        return {key: value[rows] for key, value in self._world.items() if key in kept}

    @property
    def flown_difficulties(self) -> dict[str, Tensor]:
        """Difficulties of the present episodes [n, 1], by name: views."""
        return {name: self.value_of(keys.difficulty(name)) for name in self.difficulties}

    @torch.no_grad()
    def advance(self, action: Tensor) -> StepOutput:
        """One control step of all environments; rows that are done wait for `restart`.

        `before` is then the world before it. On a GPU, where the step is a graph, the next step
        writes over that and over what is returned.

        Args:
            action: float32 [n, a] on the environment's device, clipped to [-1, 1].

        Raises:
            CallError: Nothing was reset yet, or the action is of another shape, type or device.
            TermError: A term cannot be computed.
            NumericalError: The action, a reading or an estimate holds a number that is not finite.
        """
        self._require_reset()
        require_action(action, (self.num_envs, self.stages.terms.action.width), self.device)
        if not action.isfinite().all():
            columns = self.stages.observation_columns
            raise bad_action(action, self.observation, self._world[keys.CLOCK], columns)
        drawn = self._draw(self.step_draws, self.num_envs)
        try:
            out = self._fly(action, drawn)
        except Exception as error:  # what a term of one's own raises is told with its name
            raise blamed(error, f"step {self.steps_taken + 1}") from error
        if self.stages.devices:
            require_measured(self.stages.devices, self._world)
        self.steps_taken += 1
        return out

    @torch.no_grad()
    def restart(self, rows: Tensor) -> Tensor:
        """Begins new episodes in the given rows [k]; returns the observation of all [n, width].

        Raises:
            CallError: The rows are no numbers of environments.
        """
        rows = rows.cpu() if isinstance(rows, Tensor) else rows
        require_rows(rows, self.num_envs)
        if not self._world:
            self._allocate()
        if not len(rows):
            return self.observation
        if not self.graphed:
            # A copy: the caller keeps the last observation of the episode. Strides are always the
            # same, of an empty part too, so that nothing is compiled twice.
            own, critic = self.observation, self.observation_critic
            self.observation = own.clone(memory_format=torch.contiguous_format)
            self.observation_critic = critic.clone(memory_format=torch.contiguous_format)
        for part in rows.split(self.chunk):
            filled = torch.arange(self.chunk).clamp(max=len(part) - 1)
            where = torch.stack((part, self._entries(part)))[:, filled].to(self.device)
            drawn = self._draw(self.draws, len(part), filled)
            restart = self._restart_graph if self.graphed else self._restart_in_place
            restart(*where, *drawn.values())
        return self.observation

    @torch.no_grad()
    def begin(self, world: TensorDictBase) -> Tensor:
        """Begins an episode with the given world in every row; returns its observation.

        `world` [n] holds some keys of `world`; the others are as after a restart, but a map that
        is known: the vehicle looks again from where it is.
        """
        self.restart(torch.arange(self.num_envs))
        given = {key: world[key].to(self.device) for key in self._world if key in world.keys(True)}
        drawn = self._draw(self.step_draws, self.num_envs)
        begun = self._world | given
        if self.stages.terms.sensing and not given.keys() & keys.KNOWN_MAP:
            begun |= self.stages.look_again(begun, self.pool.shared)
        as_begun, seen = self.stages.begin(begun, self.pool.shared, drawn)
        self._take(as_begun)
        self.show(*seen.split(self.stages.widths, -1))
        return self.observation

    def show(self, own: Tensor, critic: Tensor) -> None:
        """Makes this what is observed: what the policy [n, width] and the value function see."""
        if self.graphed:
            self.observation.copy_(own)
            self.observation_critic.copy_(critic)
        else:
            self.observation, self.observation_critic = own, critic

    def renew(self, count: int) -> Tensor:
        """Renews `count` scenes of the pool; returns the rows still flying in them [k].

        These must restart.
        """
        self._require_reset()
        entries = self.pool.renew(count).to(self.device)
        return torch.isin(self._world[keys.SCENE_INDEX][:, 0], entries).nonzero()[:, 0]

    def set_difficulty(self, name: str, value: float) -> None:
        """Eases the episodes that begin from now on; 1 is full difficulty.

        Raises:
            ConfigError: Nothing reads it, or scenes are laid out at another difficulty only.
        """
        if name not in self.difficulties:
            raise ConfigError(
                f"Nothing reads a difficulty '{name}'; there are: "
                f"{', '.join(self.difficulties) or 'none'}."
            )
        if name == self.stages.scene_difficulty:
            self.pool.require_level(name, value)
            self.scene_difficulty = value
        self.difficulties[name].fill_(value)  # in place: an input of the compiled reset

    def _entries(self, rows: Tensor) -> Tensor:
        """Pool entries for new episodes of the given rows."""
        if self.in_order:
            entries = (rows + self.visits[rows] * self.num_envs) % len(self.pool)
            self.visits[rows] += 1
            return entries
        unit = torch.rand(len(rows), generator=self.generators["scene"])
        return self.pool.entry(unit, self.closed, self.scene_difficulty)

    def _fly(self, action: Tensor, drawn: dict[str, Tensor]) -> StepOutput:
        if self.graphed:
            return self._step_graph(action, *drawn.values())
        self.before = self._world
        world, out = self._step_function(self._world, self.pool.shared, action, drawn)
        self._world = _separate(world)
        self.show(out.observation, out.observation_critic)
        return out

    def _step_in_place(self, action: Tensor, *drawn: Tensor) -> StepOutput:
        """The step as it is captured: the worlds before and after it stay where they are."""
        _copy(self._world, self.before)
        blocks = dict(zip(self.step_draws, drawn, strict=True))
        world, out = self._step_function(self.before, self.pool.shared, action, blocks)
        _copy(world, self._world)
        self.show(out.observation, out.observation_critic)
        return out

    def _restart_in_place(self, rows: Tensor, entry: Tensor, *drawn: Tensor) -> None:
        self._restart_function(
            self._world,
            (self.observation, self.observation_critic),
            rows,
            entry.unsqueeze(-1),
            self.pool.tasks,
            self.pool.shared,
            dict(zip(self.draws, drawn, strict=True)),
            self.difficulties,
        )

    def _take(self, world: World) -> None:
        """Makes this the world, which a graph finds where it was captured."""
        if self.graphed and self._world:
            _copy(world, self._world)
            return
        self._world = {key: world[key].clone() for key in self.stages.persistent}
        if self.graphed:
            self.before = {key: value.clone() for key, value in self._world.items()}

    def _allocate(self) -> None:
        """An empty world of the right shapes."""
        drawn = {
            name: torch.zeros(1, width, device=self.device) for name, width in self.draws.items()
        }
        entry = torch.zeros(1, 1, dtype=torch.int64, device=self.device)
        fresh, _ = self.stages.restart(
            self.pool.tasks, entry, self.pool.shared, drawn, self.difficulties
        )
        self._take(
            {key: value.new_zeros(self.num_envs, *value.shape[1:]) for key, value in fresh.items()}
        )

    def _require_reset(self) -> None:
        if not self._world:
            raise CallError("The environment has not been reset; call reset (or restart) first.")

    def _set_seed(self, seed: int | None) -> None:
        super()._set_seed(seed)
        self.visits.zero_()


def layout_of(stages: Stages) -> Sequence[tuple[str, int]]:
    """Names and widths of the observation's blocks: what a policy must agree with."""
    return tuple((term.name, term.width) for term in stages.terms.observations)


def _copy(world: World, there: World) -> None:
    """Copies every tensor of a world to where another one is."""
    copy_each([world[key] for key in there], there.values())


def _separate(world: World) -> World:
    """The world, with no tensor under two keys: a reset writes rows of each in place.

    An estimate may be a reading as it is; compiled, equal outputs are one tensor.
    """
    own: World = {}
    seen: set[int] = set()
    for key, value in world.items():
        own[key] = value.clone() if id(value) in seen else value
        seen.add(id(value))
    return own
