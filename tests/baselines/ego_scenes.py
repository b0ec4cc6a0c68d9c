"""What the original EGO-Planner printed, and ours in the same place."""

import json
from pathlib import Path

import numpy as np

from resc.baselines.ego_planner.initial import Target, from_polynomial
from resc.baselines.ego_planner.numbers import Numbers, Quirks, Weights
from resc.baselines.ego_planner.reference import LocalTarget, reference
from resc.baselines.planner import State
from resc.baselines.voxel_map import Sensing, VoxelMap, columns

DATA = Path(__file__).parents[1] / "data" / "planner_scenes"
GOLDEN = json.loads((DATA / "golden.json").read_text())
SCENES = {
    scene["name"]: scene for scene in json.loads((DATA / "scenes.json").read_text())["scenes"]
}
SPARSE, AUTHOR = "ego_B1_sparse", "ego_A1_author11"
PLACES = {SPARSE: ("B1_sparse", (12.0, 0.0, 1.0)), AUTHOR: ("paper1_map11", (9.0, 8.75, 1.0))}
"""Scene and goal; that of map 11 is not the scene's."""
PAPER = Numbers(3.0, 6.0, 7.5, 0.4, 0.5, 0.1, 50, 1.05, Weights(), Quirks())
STILL = np.zeros(3)


def cells(name):
    scene = SCENES[name]
    return columns(scene["boxes"], scene["cylinders"])


def ends(name):
    """Start and goal of what was printed."""
    scene, goal = PLACES[name]
    return np.array(SCENES[scene]["start"], dtype=float), np.array(goal)


def space(name):
    """What the planner has seen at the start, all round."""
    voxels = VoxelMap(np.array((-20.0, -20.0)), np.array((20.0, 20.0)), inflation_m=0.3)
    voxels.see(cells(PLACES[name][0]), ends(name)[0], np.array((1.0, 0.0)), Sensing())
    return voxels.cells, voxels.corner, voxels.per_m, 0.7, 1.3


def local_target(name, numbers=PAPER):
    start, goal = ends(name)
    course = LocalTarget(reference(start, STILL, goal, numbers.velocity), goal)
    return Target(*course.advance(start, numbers))


def initial(name, numbers=PAPER, slip_mps=STILL):
    """The trajectory before obstacles push it; `slip_mps` is added to its first velocity."""
    velocity = np.array((1.0, 0.0, 0.0)) + slip_mps
    start = State(ends(name)[0], velocity, np.array((0.5, 0.0, 0.0)))
    return from_polynomial(start, local_target(name, numbers), numbers)
