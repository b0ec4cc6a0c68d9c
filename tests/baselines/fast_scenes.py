"""Scenes on which the original Fast-Planner was measured, as its port sees them from the start."""

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np

from resc.baselines.fast_planner.distance_field import DistanceField
from resc.baselines.fast_planner.limits import Limits
from resc.baselines.planner import State
from resc.baselines.voxel_map import Sensing, VoxelMap, columns

DATA = Path(__file__).parents[1] / "data" / "planner_scenes"
GOLDEN = json.loads((DATA / "golden.json").read_text())
SCENES = {
    scene["name"]: scene for scene in json.loads((DATA / "scenes.json").read_text())["scenes"]
}
LIMITS = Limits(3.0, 6.0, 0.7, 1.3)
NAMES = ("B1_sparse", "A1_author11")


class Seen(NamedTuple):
    """A scene, what is known of it at the start, and the numbers of the original."""

    golden: dict
    obstacles: np.ndarray
    state: State
    goal: np.ndarray
    voxels: VoxelMap
    field: DistanceField


def seen(name):
    """All round and 5 m far; the goal of the first map was another for the recorded numbers."""
    golden = GOLDEN[f"fp_{name}"]
    scene = SCENES["paper1_map11" if name == "A1_author11" else name]
    obstacles = columns(scene["boxes"], scene["cylinders"])
    start = np.array(scene["start"], float)
    goal = np.array([9.0, 8.75, 1.0] if name == "A1_author11" else scene["goal"], float)
    held = np.vstack((obstacles, start, goal))[:, :2]
    voxels = VoxelMap(held.min(0) - 2.0, held.max(0) + 2.0, inflation_m=0.3)
    voxels.see(obstacles, start, np.array([1.0, 0.0]), Sensing())
    near = obstacles[np.linalg.norm(obstacles[:, :2] - start[:2], axis=1) <= 5.0, :2]
    field = DistanceField(voxels)
    low, high = np.vstack((near - 0.3, start[:2])).min(0), np.vstack((near + 0.3, start[:2])).max(0)
    field.update(low, high)
    state = State(start, np.array(golden["search"]["v0"], float), np.array(golden["search"]["a0"]))
    return Seen(golden, obstacles, state, goal, voxels, field)
