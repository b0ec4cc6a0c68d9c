"""Networks, PPO and checkpoints."""
