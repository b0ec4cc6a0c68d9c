"""TorchRL's Collector and PPO loss on the batch, which is a TorchRL environment as it is.

python examples/torchrl_collector.py
"""

import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.modules import NormalParamExtractor, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

import resc

STEPS, UPDATES, MINIBATCH, SCALE = 32, 32, 4096, 0.01


def main(num_envs: int = 1024, iterations: int = 100, compiled: bool = True) -> None:
    """Learns to fly without obstacles."""
    free = ("+experiment=obstacle_free", "reward=[progress,finish]")
    env = resc.make_env(*free, num_envs=num_envs, compile=compiled)
    width, size = env.observation_spec["observation"].shape[-1], env.action_spec.shape[-1]
    net = nn.Sequential(
        nn.Linear(width, 64), nn.Tanh(), nn.Linear(64, 2 * size), NormalParamExtractor()
    )
    actor = ProbabilisticActor(
        TensorDictModule(net, ["observation"], ["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        return_log_prob=True,
    )
    value = nn.Sequential(nn.Linear(width, 64), nn.Tanh(), nn.Linear(64, 1))
    critic = ValueOperator(value, in_keys=["observation"])
    advantage = GAE(gamma=0.99, lmbda=0.95, value_network=critic)
    loss_module = ClipPPOLoss(actor, critic, normalize_advantage=True)
    optimizer = torch.optim.Adam(loss_module.parameters(), lr=1e-3)
    frames = {"frames_per_batch": STEPS * num_envs, "total_frames": STEPS * num_envs * iterations}
    collector = Collector(env, actor, auto_register_policy_transforms=False, **frames)
    for iteration, batch in enumerate(collector):  # [num_envs, STEPS]
        ended, outcome = batch["next", "done"], batch["next", "outcome"]
        batch["next", "reward"] *= SCALE
        with torch.no_grad():
            advantage(batch)
        samples = batch.reshape(-1)
        for part in torch.randint(len(samples), (UPDATES, MINIBATCH)):
            losses = loss_module(samples[part])
            optimizer.zero_grad()
            sum(value for name, value in losses.items() if name.startswith("loss_")).backward()
            optimizer.step()
        share = float((outcome[ended] == 0).float().mean())
        print(f"{iteration}: {share:.0%} of {int(ended.sum())} flights succeed")
    collector.shutdown()


if __name__ == "__main__":
    main()
