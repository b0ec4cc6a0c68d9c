"""What flies: the protocol of a pilot, and a trained policy as one."""

from abc import ABC, abstractmethod
from collections.abc import Mapping

from jaxtyping import Float
from tensordict import TensorDictBase
from torch import Tensor

from resc.envs.stages import Stages, World
from resc.policies.stored import Policy
from resc.recording.rollouts import digest


class Pilot(ABC):
    """Something that flies: from the world and the observation of every step to its actions.

    Flights are rows of a batch. A pilot treats each row for itself, and may keep a state of its own
    for each of them, which `begin` resets. `name` is that of its configuration.
    """

    name: str = ""

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


class PolicyPilot(Pilot):
    """A trained policy that flies by the observation of the environment.

    Args:
        policy: It and the configuration it was trained with.
    """

    def __init__(self, policy: Policy) -> None:
        self.policy = policy
        self.name = "policy"

    def check(self, stages: Stages) -> None:
        """Raises CheckpointError if the environment shows another observation."""
        self.policy.require_layout(stages)

    def act(self, world: TensorDictBase, observation: Float[Tensor, "n d"]) -> Float[Tensor, "n a"]:
        """The mean action."""
        del world
        return self.policy(observation)

    def facts(self) -> Mapping[str, str]:
        """The digest of its weights."""
        return {"policy_sha256": digest(self.policy.head)}
