"""Compiles every numba kernel, so that no later command waits half a minute for them.

`make` does it after an installation. numba keeps what is compiled beside the source, and compiles a
file again that has changed since.
"""

import numpy as np
from omegaconf import OmegaConf

from resc.baselines.perfect import fly_perfectly
from resc.baselines.planner import Planner
from resc.baselines.voxel_map import columns
from resc.build import build
from resc.door import make_env
from resc.places import CONF

FLYING = (
    ("sensing=depth", "replanning=in_flight"),
    ("sensing=local",),
    ("scene=occupancy",),
    ("obstacle_observation=ray_sampling",),
)
"""Settings that between them call all kernels but those of the searches."""
PLANNERS = ("ego_planner", "fast_planner")
"""Pilots with kernels of their own."""
SECONDS = 9.0
"""What they fly."""


def compile_kernels() -> None:
    """Flies a few steps of everything that has kernels of its own."""
    searches = ((f"search={path.stem}",) for path in sorted((CONF / "search").glob("*.yaml")))
    for overrides in (*FLYING, *searches):
        env = make_env(*overrides, num_envs=1, pool_size=8)
        env.rollout(6, auto_reset=True)
    scene = OmegaConf.load(CONF / "scene" / "paper1_map11.yaml")
    for name in PLANNERS:
        node = OmegaConf.load(CONF / "pilot" / f"{name}.yaml")[name].planner
        planner = build(node, f"pilot.{name}.planner", kind=Planner)
        ends = np.array(scene.start_m), np.array(scene.goal_m)
        fly_perfectly(planner, columns(scene.boxes, []), *ends, limit_s=SECONDS)
