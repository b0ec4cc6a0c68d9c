"""Soft actor-critic of TorchRL on the batch: its collector, replay buffer and loss.

python examples/sac.py
"""

import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.modules import MLP, NormalParamExtractor, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import SACLoss, SoftUpdate

import resc

STEPS, UPDATES, MINIBATCH, SCALE = 8, 16, 512, 0.01


def main(num_envs: int = 64, iterations: int = 1000, compiled: bool = True) -> None:
    """Learns to fly without obstacles."""
    free = ("+experiment=obstacle_free", "reward=[progress,finish]")
    env = resc.make_env(*free, num_envs=num_envs, compile=compiled)
    width, size = env.observation_spec["observation"].shape[-1], env.action_spec.shape[-1]
    net = nn.Sequential(MLP(width, 2 * size, num_cells=[64, 64]), NormalParamExtractor())
    actor = ProbabilisticActor(
        TensorDictModule(net, ["observation"], ["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
    )
    value = MLP(width + size, 1, num_cells=[64, 64])
    critic = ValueOperator(value, in_keys=["observation", "action"])
    loss_module = SACLoss(actor, critic, num_qvalue_nets=2, target_entropy=-float(size))
    loss_module.make_value_estimator(gamma=0.99)
    target = SoftUpdate(loss_module, tau=0.01)
    optimizer = torch.optim.Adam(loss_module.parameters(), lr=1e-3)
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(10**6), batch_size=MINIBATCH)
    frames = {"frames_per_batch": STEPS * num_envs, "total_frames": STEPS * num_envs * iterations}
    collector = Collector(env, actor, auto_register_policy_transforms=False, **frames)
    arrived = ended = 0
    for iteration, batch in enumerate(collector):  # [num_envs, STEPS]
        done = batch["next", "done"]
        ended += int(done.sum())
        arrived += int((batch["next", "outcome"][done] == 0).sum())
        batch["next", "reward"] *= SCALE
        buffer.extend(batch.reshape(-1))
        for _ in range(UPDATES):
            losses = loss_module(buffer.sample())
            optimizer.zero_grad()
            sum(value for name, value in losses.items() if name.startswith("loss_")).backward()
            optimizer.step()
            target.step()
        if iteration % 100 == 99:
            print(f"{iteration + 1}: {arrived} of {ended} flights succeed")
            arrived = ended = 0
    collector.shutdown()


if __name__ == "__main__":
    main()
