"""The world as planners see it: arrays, the obstacles of a scene, and the cells of them."""

from typing import cast

import numpy as np
from jaxtyping import Float
from tensordict import TensorDictBase
from torch import Tensor

from resc import keys
from resc.baselines.voxel_map import columns
from resc.envs.stages import World
from resc.scenes.layout import PARKED_M


def array(world: TensorDictBase, key: keys.NestedKey) -> Float[np.ndarray, "n d"]:
    """An entry of the world [n, d], flattened beyond the first axis, in double precision."""
    return cast(Tensor, world[key]).flatten(1).double().cpu().numpy()


def standing(maps: World, entry: int) -> tuple[Float[np.ndarray, "k 4"], Float[np.ndarray, "m 3"]]:
    """Boxes `[x, y, len_x, len_y]` and pillars `[x, y, radius]` of a scene [m], without spares.

    Args:
        maps: What all flights share.
        entry: Which scene.
    """
    boxes, pillars = (
        maps[key][entry].double().cpu().numpy().round(6) for key in (keys.BOXES_W, keys.PILLARS_W)
    )
    return boxes[boxes[:, 0] < PARKED_M / 2], pillars[pillars[:, 0] < PARKED_M / 2]


def obstacle_cells(
    maps: World, entry: int, known: dict[bytes, Float[np.ndarray, "k 3"]]
) -> Float[np.ndarray, "k 3"]:
    """Centres of the occupied cells of a scene [m].

    Args:
        maps: What all flights share.
        entry: Which scene.
        known: Those of earlier calls, so that flights of one map share them.
    """
    boxes, pillars = standing(maps, entry)
    name = boxes.tobytes() + pillars.tobytes()
    if name not in known:
        known[name] = columns(boxes.tolist(), pillars.tolist())
    return known[name]
