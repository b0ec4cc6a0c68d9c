"""TorchRL's face of an environment: its specs and seeds, and `step` and `reset` within them."""

from abc import abstractmethod

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase, TransformedEnv

from resc.envs.stages import Stages, StepOutput
from resc.errors import CallError
from resc.math.sampling import generator_for, require_seed


class TorchRlFace(EnvBase):
    """What TorchRL asks of an environment, by what is flown with: `advance` and `restart`.

    Args:
        stages: The step and the reset.
        num_envs: Batch size.
        device: Where the tensors live.
    """

    graphed: bool
    """Whether the next step writes over what `advance` returns."""

    def __init__(self, stages: Stages, num_envs: int, device: torch.device | str) -> None:
        super().__init__(device=torch.device(device), batch_size=torch.Size((num_envs,)))
        self.stages = stages.to(device)
        self.num_envs = num_envs
        own, critic = stages.widths
        self.observation = torch.zeros(num_envs, own, device=self.device)
        self.observation_critic = torch.zeros(num_envs, critic, device=self.device)
        self._make_specs()

    @abstractmethod
    def advance(self, action: Tensor) -> StepOutput:
        """One control step of all environments, for actions [n, a]."""

    @abstractmethod
    def restart(self, rows: Tensor) -> Tensor:
        """Begins new episodes in the given rows [k]; returns the observation of all [n, width]."""

    @property
    def observation_width(self) -> int:
        """Number of columns the policy sees."""
        return len(self.stages.observation_columns)

    def set_seed(self, seed: int | None = None, static_seed: bool = False) -> int | None:
        """Restarts every random sequence; returns a seed for another environment."""
        require_seed(0 if seed is None else seed)
        return super().set_seed(seed, static_seed)

    def _set_seed(self, seed: int | None) -> None:
        self.seed_value = 0 if seed is None else seed
        self.step_draws = self.stages.step_draws
        self.draws = self.stages.reset_draws | self.step_draws
        names = ["scene", *self.draws]
        self.generators = {name: generator_for(self.seed_value, name) for name in names}

    def generator_states(self) -> dict[str, Tensor]:
        """States of all generators, for a checkpoint."""
        return {name: generator.get_state() for name, generator in self.generators.items()}

    def load_generator_states(self, states: dict[str, Tensor]) -> None:
        """Takes a checkpoint's generator states."""
        for name, state in states.items():
            self.generators[name].set_state(state)

    def _draw(
        self, widths: dict[str, int], count: int, rows: Tensor | None = None
    ) -> dict[str, Tensor]:
        """Uniform numbers in [0, 1) [count, width] from each named generator; some `rows` of them.

        Drawn on the CPU, so that every device sees the same bits, and sent to it in one piece.
        """
        if not widths:
            return {}
        drawn = [torch.rand(count, w, generator=self.generators[n]) for n, w in widths.items()]
        blocks = drawn if rows is None else [block[rows] for block in drawn]
        if self.device.type != "cpu":
            blocks = torch.cat(blocks, -1).to(self.device).split([*widths.values()], -1)
        return dict(zip(widths, blocks, strict=True))

    def _make_specs(self) -> None:
        n, device = self.num_envs, self.device
        width, column = self.observation_width, torch.Size((n, 1))
        actions = torch.Size((n, self.stages.terms.action.width))
        seen = {
            "observation": Unbounded(torch.Size((n, width)), device=device),
            "outcome": Unbounded(column, dtype=torch.int64, device=device),
        }
        if critic := self.observation_critic.shape[-1]:
            seen["observation_critic"] = Unbounded(torch.Size((n, critic)), device=device)
        self.observation_spec = Composite(seen, shape=(n,))
        self.action_spec = Bounded(-1.0, 1.0, actions, device=device)
        self.reward_spec = Unbounded(column, device=device)
        flag = Categorical(2, shape=column, dtype=torch.bool, device=device)
        self.done_spec = Composite(
            done=flag.clone(), terminated=flag.clone(), truncated=flag.clone(), shape=(n,)
        )

    def _critic(self) -> dict[str, Tensor]:
        """What the value function alone sees, if there is anything."""
        seen = self.observation_critic
        return {"observation_critic": seen.clone()} if seen.shape[-1] else {}

    def _reset(self, tensordict: TensorDictBase | None = None, **_: object) -> TensorDict:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        rows = torch.arange(self.num_envs) if mask is None else mask[:, 0].nonzero()[:, 0]
        observation = self.restart(rows) if len(rows) else self.observation
        outcome = torch.zeros(self.num_envs, 1, dtype=torch.int64, device=self.device)
        return TensorDict(
            {"observation": observation.clone(), "outcome": outcome, **self._critic()},
            batch_size=self.batch_size,
            device=self.device,
        )

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        if "action" not in tensordict:
            raise CallError("The tensordict given to step has no 'action'; set one for every row.")
        out = self.advance(tensordict["action"])
        if self.graphed:
            out = StepOutput(*(tensor.clone() for tensor in out))
        return TensorDict(
            {
                "observation": out.observation,
                **self._critic(),
                "outcome": out.outcome,
                "reward": out.reward,
                "done": out.done,
                "terminated": out.terminated,
                "truncated": out.truncated,
            },
            batch_size=self.batch_size,
            device=self.device,
        )


def require_untransformed(env: EnvBase) -> None:
    """Raises CallError for TorchRL's transforms, which `advance` and `restart` would go round."""
    if isinstance(env, TransformedEnv):
        raise CallError(
            f"The environment has the transform {type(env.transform).__name__}, which only "
            "TorchRL's step and reset apply; give env.base_env, or use TorchRL's Collector."
        )
