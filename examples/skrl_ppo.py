"""PPO of skrl on Gymnasium's VectorEnv.

python examples/skrl_ppo.py
"""

import gymnasium
import torch
from skrl.agents.torch.ppo import PPO, PPO_CFG
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.trainers.torch import SequentialTrainer
from torch import Tensor, nn

import resc  # noqa: F401 - tells Gymnasium of resc/Flight-v0

FREE = {"overrides": ["+experiment=obstacle_free", "reward=[progress,finish]"]}


class Policy(GaussianMixin, Model):
    """Mean and spread of the actions."""

    def __init__(self, **spaces: object) -> None:
        Model.__init__(self, **spaces)
        GaussianMixin.__init__(self)
        hidden = (nn.Linear(self.num_observations, 64), nn.Tanh())
        self.net = nn.Sequential(*hidden, nn.Linear(64, self.num_actions))
        self.log_std = nn.Parameter(torch.full((self.num_actions,), -0.5))

    def compute(self, inputs: dict[str, Tensor], role: str) -> tuple[Tensor, dict[str, Tensor]]:
        return self.net(inputs["observations"]), {"log_std": self.log_std}


class Value(DeterministicMixin, Model):
    """The return to come."""

    def __init__(self, **spaces: object) -> None:
        Model.__init__(self, **spaces)
        DeterministicMixin.__init__(self)
        self.net = nn.Sequential(nn.Linear(self.num_observations, 64), nn.Tanh(), nn.Linear(64, 1))

    def compute(self, inputs: dict[str, Tensor], role: str) -> tuple[Tensor, dict[str, Tensor]]:
        return self.net(inputs["observations"]), {}


def main(num_envs: int = 1024, steps: int = 3200) -> None:
    """Learns to fly without obstacles."""
    env = wrap_env(gymnasium.make_vec("resc/Flight-v0", num_envs, **FREE), wrapper="gymnasium")
    spaces = {"observation_space": env.observation_space, "action_space": env.action_space}
    models = {"policy": Policy(device="cpu", **spaces), "value": Value(device="cpu", **spaces)}
    memory = RandomMemory(memory_size=32, num_envs=num_envs, device="cpu")
    config = PPO_CFG(rollouts=32, rewards_shaper=lambda reward, *_: 0.01 * reward)
    config.experiment.write_interval = config.experiment.checkpoint_interval = 0
    agent = PPO(models=models, memory=memory, cfg=config, device="cpu", **spaces)
    SequentialTrainer(env=env, agents=agent, cfg={"timesteps": steps, "headless": True}).train()


if __name__ == "__main__":
    main()
