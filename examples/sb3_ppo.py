"""PPO of Stable-Baselines3 on a batch of environments, which is one VecEnv.

python examples/sb3_ppo.py
"""

import gymnasium
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecMonitor

import resc  # noqa: F401 - tells Gymnasium of resc/Flight-v0
from resc.envs.sb3_vec_env import QuadrotorVecEnv

FREE = ["+experiment=obstacle_free", "reward=[progress,finish]"]


def main(num_envs: int = 1024, frames: int = 3_000_000, compiled: bool = True) -> float:
    """Learns to fly without obstacles; returns the mean return of 20 flights."""
    batch = gymnasium.make_vec(
        "resc/Flight-v0",
        num_envs=num_envs,
        autoreset_mode="SameStep",
        compile=compiled,
        overrides=FREE,
    )
    envs = VecMonitor(QuadrotorVecEnv(batch))
    model = PPO("MlpPolicy", envs, n_steps=32, batch_size=8 * num_envs, seed=0, verbose=1)
    model.learn(frames)
    held_out = gymnasium.make("resc/Flight-v0", seed=1, overrides=FREE)
    mean, deviation = evaluate_policy(model, held_out, n_eval_episodes=20, warn=False)
    print(f"20 flights with other seeds: return {mean:.1f} +- {deviation:.1f}")
    return float(mean)


if __name__ == "__main__":
    main()
