"""Compiles every numba kernel, so that no later command waits half a minute for them.

`make` does it after an installation. numba keeps what is compiled beside the source, and compiles a
file again that has changed since.
"""

from resc.baselines.ego_planner import EgoPlanner
from resc.baselines.fast_planner import FastPlanner
from resc.baselines.perfect import rehearse
from resc.door import make_env
from resc.places import CONF

FLYING = (
    ("sensing=depth", "replanning=in_flight"),
    ("sensing=local",),
    ("scene=occupancy",),
    ("obstacle_observation=ray_sampling",),
)
"""Settings that between them call all kernels but those of the searches."""


def compile_kernels() -> None:
    """Flies a few steps of everything that has kernels of its own."""
    searches = ((f"search={path.stem}",) for path in sorted((CONF / "search").glob("*.yaml")))
    for overrides in (*FLYING, *searches):
        env = make_env(*overrides, num_envs=1, pool_size=8)
        env.rollout(6, auto_reset=True)
    for planner in (EgoPlanner(), FastPlanner()):
        rehearse(planner, limit_s=40.0)
