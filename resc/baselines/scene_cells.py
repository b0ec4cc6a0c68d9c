"""The obstacles of a scene as the cells that planners see."""

import numpy as np
from jaxtyping import Float

from resc import keys
from resc.baselines.voxel_map import columns
from resc.envs.stages import World
from resc.scenes.layout import PARKED_M


def obstacle_cells(
    maps: World, entry: int, known: dict[bytes, Float[np.ndarray, "k 3"]]
) -> Float[np.ndarray, "k 3"]:
    """Centres of the occupied cells of a scene of the pool [m].

    Args:
        maps: What all flights share.
        entry: Which scene.
        known: Those of earlier calls, so that flights of one map share them.
    """
    boxes, pillars = (
        maps[key][entry].double().cpu().numpy() for key in (keys.BOXES_W, keys.PILLARS_W)
    )
    name = boxes.tobytes() + pillars.tobytes()
    if name not in known:
        there = (part[part[:, 0] < PARKED_M / 2].round(6) for part in (boxes, pillars))
        known[name] = columns(*(part.tolist() for part in there))
    return known[name]
