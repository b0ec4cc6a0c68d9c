"""A recording as two tables of pandas: its episodes, and the steps of those that crashed.

python examples/read_log_into_pandas.py
"""

import pandas as pd

from resc.recording import RolloutLog


def main(recording: str = "runs/latest_train/rollouts") -> pd.DataFrame:
    """Prints how episodes end; returns the last step of every collision, the fastest first."""
    log = RolloutLog(recording)
    episodes = log.episodes.to_pandas()
    print(episodes.groupby("outcome", observed=True)[["length", "return_"]].mean().round(2))
    steps = log.where(outcome="collision", complete=True).to_pandas()
    velocity = steps[[f"state.velocity_w.{axis}" for axis in "xyz"]]
    steps["speed_mps"] = velocity.pow(2).sum(axis="columns").pow(0.5)
    crashes = steps.groupby("index").last().sort_values("speed_mps", ascending=False)
    print(crashes[["speed_mps", "state.position_w.x", "state.position_w.y"]].head().round(2))
    return crashes


if __name__ == "__main__":
    main()
