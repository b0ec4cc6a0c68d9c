"""What flies: the protocol of a pilot, and a trained policy as one."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from jaxtyping import Float
from tensordict import TensorDictBase
from torch import Tensor

from resc import keys
from resc.build import build
from resc.envs.stages import Stages, World
from resc.errors import ConfigError
from resc.flying.own_observation import OwnObservation, require_same_action
from resc.policies.stored import StoredPolicy, load_policy, policy_folder
from resc.recording.rollouts import digest
from resc.schema import folder_name


class PlanningCall(NamedTuple):
    """A call of what plans for a pilot in flight.

    Args:
        flight: Row of the batch.
        time_s: When, on the clock of the flight.
        took_s: What it took on the clock of the computer.
        failed: The stage that failed and why; empty if none did.
    """

    flight: int
    time_s: float
    took_s: float
    failed: str


class Pilot(ABC):
    """Something that flies: from the world and the observation of every step to its actions.

    Flights are rows of a batch. A pilot treats each row for itself, and may keep a state of its own
    for each of them, which `begin` resets. `name` is that of its configuration.

    One that `finds_its_way` is asked for the goal alone, not for the control points of a route.
    `parts` are nodes of the configuration, by their groups, that take the place of the
    environment's.
    """

    name: str = ""
    finds_its_way: bool = False
    parts: Mapping[str, Any] = {}

    def named(self, name: str) -> "Pilot":
        """Gives the pilot its configured name."""
        self.name = name
        return self

    def check(self, stages: Stages) -> None:
        """Raises a RescError, before any work is done, if it cannot fly such an environment."""
        del stages

    def begin(self, flights: int, stages: Stages, maps: World) -> None:
        """Takes up so many flights, and forgets all earlier ones.

        Args:
            flights: Rows of every batch to come.
            stages: The constants and the parts of the environment.
            maps: What all flights share: the keys under `map`, indexed by `("scene", "index")`.
        """
        del flights, stages, maps

    @abstractmethod
    def act(self, world: TensorDictBase, observation: Float[Tensor, "n d"]) -> Float[Tensor, "n a"]:
        """The actions in [-1, 1] of one step, in the order of the rows.

        Args:
            world: The keys that the environment keeps between two steps, see `resc.keys`: state,
                task, clock, params. They are the environment's own and must not be changed.
            observation: What the environment shows of it.
        """

    def facts(self) -> Mapping[str, str]:
        """What says which pilot it is: the digest of its weights, its numbers."""
        return {}

    def variants(self) -> Sequence["Pilot"]:
        """The pilots that an evaluation flies in its place."""
        return [self]

    def measured(self) -> Mapping[str, Float[Tensor, " n"]]:
        """Numbers of its own of every flight since it began, up to their finish."""
        return {}

    def calls(self) -> Sequence[PlanningCall]:
        """The calls of what plans for it since it began."""
        return []


def build_pilots(group: Mapping[str, Any], allowed: Sequence[str] = ()) -> list[Pilot]:
    """The pilots of the group `pilot`, in its order.

    Raises:
        ConfigError: There is none, or one cannot be built.
    """
    nodes = {str(name): node for name, node in group.items() if node is not None}
    if not nodes:
        raise ConfigError("pilot is empty; name at least one file of conf/pilot: pilot=policy.")
    return [
        build(node, f"pilot.{name}", allowed=allowed, kind=Pilot).named(folder_name(name))
        for name, node in nodes.items()
    ]


class PolicyPilot(Pilot):
    """A trained policy that flies by the observation of the environment.

    Args:
        policy: It and the configuration it was trained with.
    """

    def __init__(self, policy: StoredPolicy) -> None:
        self.policy = policy
        self.state: Tensor | None = None
        self.name = "policy"

    def check(self, stages: Stages) -> None:
        """Raises CheckpointError if the environment shows another observation."""
        self.policy.require_layout(stages)

    def begin(self, flights: int, stages: Stages, maps: World) -> None:
        """Forgets what it remembered of earlier flights."""
        del flights, stages, maps
        self.state = None

    def act(self, world: TensorDictBase, observation: Float[Tensor, "n d"]) -> Float[Tensor, "n a"]:
        """The most likely action."""
        del world
        action, self.state = self.policy.policy.decide(observation, self.state)
        return action

    def facts(self) -> Mapping[str, str]:
        """The digest of its weights."""
        return {"policy_sha256": digest(self.policy.policy)}


class FolderPilot(PolicyPilot):
    """The policy in a folder.

    Args:
        folder: Of a run or a shipped policy; `latest` is the last run that was trained.
        own_observation: Whether it flies by the observation of its own training, computed from the
            world, instead of the environment's.
        allowed_targets: Prefixes of `_target_` outside resc that its configuration may name.
    """

    def __init__(
        self,
        *,
        folder: str,
        own_observation: bool = False,
        allowed_targets: Sequence[str] = (),
    ) -> None:
        super().__init__(load_policy(policy_folder(folder, "policy"), allowed=allowed_targets))
        self.own_observation = own_observation
        self.allowed = allowed_targets

    def check(self, stages: Stages) -> None:
        """Raises a RescError if it cannot observe or act there as in its training."""
        if self.own_observation:
            try:
                require_same_action(self.policy.config, stages, self.allowed)
                stages = self._own(stages).stages
            except ConfigError as error:
                raise ConfigError(f"pilot.{self.name}: {error}") from None
        super().check(stages)

    def begin(self, flights: int, stages: Stages, maps: World) -> None:
        """Takes the network to where the maps are."""
        super().begin(flights, stages, maps)
        self.policy.to(maps[keys.ESDF].device)
        if self.own_observation:
            self.observe = self._own(stages)
            self.observe.begin(maps)

    def act(self, world: TensorDictBase, observation: Float[Tensor, "n d"]) -> Float[Tensor, "n a"]:
        """The mean action, by the observation that is its own."""
        return super().act(world, self.observe(world) if self.own_observation else observation)

    def _own(self, stages: Stages) -> OwnObservation:
        stored = self.policy.config
        nodes = (stored["env"], stored["observation"], stored.get("sensor"))
        return OwnObservation(*nodes, stages, self.allowed)
