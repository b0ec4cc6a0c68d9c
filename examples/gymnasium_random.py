"""Random actions through Gymnasium's interface, and how each flight ended.

python examples/gymnasium_random.py
"""

import gymnasium

import resc  # noqa: F401 - tells Gymnasium of resc/Flight-v0


def main(flights: int = 10, **settings: object) -> list[str]:
    """Flies in one environment; returns how each flight ended."""
    env = gymnasium.make("resc/Flight-v0", obstacle_observation="ray_sampling", **settings)
    env.action_space.seed(0)
    env.reset(seed=0)
    outcomes, rewards = [], 0.0
    while len(outcomes) < flights:
        _, reward, terminated, truncated, info = env.step(env.action_space.sample())
        rewards += float(reward)
        if terminated or truncated:
            outcomes.append(info["outcome"])
            print(f"flight {len(outcomes)}: {info['outcome']}, return {rewards:.1f}")
            env.reset()
            rewards = 0.0
    return outcomes


if __name__ == "__main__":
    main()
