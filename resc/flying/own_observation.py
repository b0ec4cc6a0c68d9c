"""What a policy of another training observes of the world that is flown."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Float
from tensordict import TensorDictBase
from torch import Tensor

from resc.build import build, build_terms, plain
from resc.envs.stages import Stages, World
from resc.envs.terms import sensors_read_by
from resc.errors import ConfigError, shown
from resc.math.sampling import generator_for
from resc.setup import in_layout
from resc.term import Action, Observation, Sensor

OWN = "observation"
"""First part of the keys of what was observed before: that of the environment is another's."""


class OwnObservation:
    """The observation of a stored configuration, computed from the world of another environment.

    Terms, sensors, frame and history are the configuration's; vehicle and maps are those that are
    flown.

    Args:
        env: That of a trained policy.
        observation: What it sees.
        sensor: What that is made of.
        stages: Of the environment that is flown.
        allowed: Prefixes of `_target_` outside resc that the configuration may name.

    Raises:
        ConfigError: A term reads what the environment does not have.
    """

    def __init__(
        self,
        env: Mapping[str, Any],
        observation: Mapping[str, Any],
        sensor: Mapping[str, Any] | None,
        stages: Stages,
        allowed: Sequence[str] = (),
    ) -> None:
        context = replace(
            stages.context,
            observation_frame=env.get("observation_frame", "world"),
            history=env.get("history", 1),
        )
        observations = build_terms(observation, "observation", Observation, allowed)
        own = build_terms(sensor, "sensor", Sensor, allowed)
        sensors = {term.name: term for term in (*stages.terms.sensors, *own)}
        estimators = [stages.terms.estimator] if stages.terms.estimator else []
        needed = sensors_read_by([*observations, *estimators], list(sensors.values()))
        terms = replace(
            stages.terms,
            sensors=needed,
            observations=in_layout(observations, env.get("layout", ())),
            terminations=(),
            rewards=(),
            metrics=(),
            critic_observations=(),
        )
        self.stages = Stages(terms, context)

    def begin(self, maps: World) -> None:
        """Begins episodes; what was observed before is forgotten."""
        self.maps = maps
        self.stages.to(next(iter(maps.values())).device)
        self.last: World = {}
        draws = self.stages.step_draws
        self.generators = {name: generator_for(0, f"own/{name}") for name in draws}

    def __call__(self, world: TensorDictBase) -> Float[Tensor, "n d"]:
        """The observation of the next step."""
        count, device = world.batch_size[0], next(iter(self.maps.values())).device
        drawn = {
            name: torch.rand(count, width, generator=self.generators[name]).to(device)
            for name, width in self.stages.step_draws.items()
        }
        seen = {key: value for key, value in self.last.items() if key[0] == OWN}
        there = {key: world[key] for key in self.stages.persistent if key[0] != OWN}
        past = {key: self.last[key[1:]] for key in self.stages.memory} if self.last else {}
        tensors = {**there, **seen, **past}
        self.last, observation = self.stages.observe(tensors, self.maps, drawn, first=not self.last)
        return observation


def require_same_action(
    trained: Mapping[str, Any], stages: Stages, allowed: Sequence[str] = ()
) -> None:
    """Raises ConfigError if actions mean something else than in a stored configuration.

    They do in another time step, or under another action term or other numbers of it.
    """
    dt_s = trained["env"]["dt_s"]
    if dt_s != stages.context.dt_s:
        raise ConfigError(
            f"the policy was trained with env.dt_s={dt_s:g}, but it would fly with "
            f"{stages.context.dt_s:g}; set env.dt_s={dt_s:g}, or fly another policy."
        )
    flown = stages.terms.action
    own = build(trained["action"], "action", allowed=allowed, kind=Action).named(flown.name)
    own.bind(stages.context)
    if type(own) is not type(flown) or _numbers(own) != _numbers(flown):
        raise ConfigError(
            f"the policy was trained with another action, {shown(plain(trained['action']), 300)}; "
            "set the same, or fly another policy."
        )


def _numbers(action: Action) -> Mapping[str, object]:
    """What an action term was made with; how long commands may wait is the vehicle's."""
    own = {name: value for name, value in vars(action).items() if isinstance(value, float | tuple)}
    return own | {name: buffer.tolist() for name, buffer in action.named_buffers()}
