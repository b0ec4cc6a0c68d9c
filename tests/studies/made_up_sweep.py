"""Sweeps that were never flown: folders as train.py -m leaves them, with numbers made up."""

import csv
import json
from pathlib import Path

import numpy as np
from omegaconf import OmegaConf

COLUMNS = ("scene", "obstacles", "density", "outcome", "success", "collided", "time_s", "energy")
CONFIG = {
    "env": {"dt_s": 0.02, "layout": ["velocity"]},
    "scene": {"boxes": 8},
    "task": {"points": 3},
    "evaluation_seed": 1_000_003,
    "held_out": {"metric": {}},
}


def make_run(
    folder: Path,
    *overrides: str,
    success: list[int],
    times: list[float] | None = None,
    density: list[float] | None = None,
    curve: list[float] | None = None,
    steps_per_s: float = 20_000.0,
    **config: object,
) -> Path:
    """A finished run with the given held-out episodes, in `folder`, named by its number."""
    folder.mkdir(parents=True)
    (folder / "job.json").write_text(json.dumps({"overrides": list(overrides)}))
    count = len(success)
    times = times or [2.0] * count
    density = density or [scene / count for scene in range(count)]
    with (folder / "evaluation.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(COLUMNS)
        for scene, (good, time_s, dense) in enumerate(zip(success, times, density, strict=True)):
            outcome = "success" if good else "collision"
            rows.writerow([scene, 3, dense, outcome, good, 1 - good, time_s, 10 * time_s])
    with (folder / "progress.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["frames", "outcome/success", "speed/steps_per_s"])
        for batch, share in enumerate(curve or [0.1, 0.5], start=1):
            rows.writerow([1000.0 * batch, share, steps_per_s])
    stored = {**CONFIG, "evaluation_episodes": count, **config}
    OmegaConf.save(OmegaConf.create(stored), folder / "config.yaml")
    (folder / "summary.json").write_text(
        json.dumps({"episodes": count, "success_rate": float(np.mean(success))})
    )
    return folder
