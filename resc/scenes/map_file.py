"""One map out of a file, with a start and a goal."""

from collections.abc import Sequence
from typing import Annotated, Literal

from jaxtyping import Float
from torch import Tensor

from resc.errors import ConfigError
from resc.math.geometry import box_distance
from resc.quantities import NotNegative, Number, Positive, Share, Within
from resc.scenes.grid_map import GridMap, found, read_npz, require_free, settings_without
from resc.scenes.map_server import Reading, read_map_server, refuse_image
from resc.scenes.named import NamedScene
from resc.scenes.point_cloud import read_cloud

KINDS = {
    ".yaml": "map_server",
    ".yml": "map_server",
    ".npz": "npz",
    ".pcd": "cloud",
    ".ply": "cloud",
}
CELLS = ("cell_m", "height_m")
THRESHOLDS = ("occupied_thresh", "free_thresh")


Percent = Annotated[float, Within(0, 100)]


class MapFile(NamedScene):
    """The obstacles of a map file; every sample starts within `jitter_m` of the start in x and y.

    Its coordinates are those of the map. The occupied cells become boxes that cover just these
    cells, whatever the cells are that flights are planned on.

    Args:
        file: The YAML file of a map of ROS's map_server, an .npz file, or a point cloud (.pcd,
            .ply). What the working directory lacks is looked for beside RESC's `conf`.
        start_m: x, y, z of the start.
        goal_m: x, y, z of the goal.
        jitter_m: Greatest offset of the start along each axis.
        room_m: Least distance of the start and the goal from occupied cells.
        unknown: What unknown cells of a map_server map count as.
        occupied_thresh: In place of that of the YAML file.
        free_thresh: Likewise.
        occupied_at: Least value from 0 to 100 that counts as occupied, in the modes scale and raw.
        cell_m: Edge of the cells that a point cloud is sorted into.
        height_m: Least and greatest z of its points that are obstacles.
    """

    def __init__(
        self,
        *,
        file: str,
        start_m: Sequence[Number],
        goal_m: Sequence[Number],
        jitter_m: NotNegative = 0.0,
        room_m: NotNegative = 0.0,
        unknown: Literal["occupied", "free"] = "occupied",
        occupied_thresh: Share | None = None,
        free_thresh: Share | None = None,
        occupied_at: Percent = 50.0,
        cell_m: Positive | None = None,
        height_m: Sequence[Number] | None = None,
    ) -> None:
        reading = Reading(occupied_thresh, free_thresh, occupied_at, unknown == "occupied")
        self.grid = read_map(file, reading, cell_m=cell_m, height_m=height_m)
        super().__init__(
            boxes=self.grid.boxes(),
            start_m=start_m,
            goal_m=goal_m,
            origin_m=self.grid.corner_m,
            size_m=self.grid.size_m,
            jitter_m=jitter_m,
        )
        for name, point in (("start_m", self.start_m), ("goal_m", self.goal_m)):
            _require_room(name, point, self.boxes, room_m)


def read_map(
    file: str, reading: Reading, *, cell_m: float | None, height_m: Sequence[float] | None
) -> GridMap:
    """The map of a file, by its suffix.

    Raises:
        ConfigError: There is no such file, it is damaged, or a setting does not fit it.
    """
    path = found(file)
    refuse_image(path)
    kind = KINDS.get(path.suffix.lower())
    given = {"cell_m": cell_m, "height_m": height_m, **vars(reading)}
    if kind == "map_server":
        settings_without(given, f"the map {path}", *CELLS)
        grid = read_map_server(path, reading)
    elif kind == "npz":
        settings_without(given, f"the map {path}", *CELLS, *THRESHOLDS)
        grid = read_npz(path)
    elif kind == "cloud":
        settings_without(given, f"the point cloud {path}", *THRESHOLDS)
        grid = read_cloud(path, cell_m=cell_m, height_m=height_m)
    else:
        raise ConfigError(f"file is '{file}'; expected a map of the kinds {', '.join(KINDS)}.")
    require_free(path, grid)
    return grid


def _require_room(name: str, point: Tensor, boxes: Float[Tensor, "k 4"], room_m: float) -> None:
    """Refuses a start or a goal in an obstacle or too near to one."""
    if not len(boxes):
        return
    away_m = float(box_distance(point[None, :2], boxes[None]).amin())
    if away_m <= 0 or away_m < room_m:
        where = "inside an occupied cell"
        if away_m > 0:
            where = f"{away_m:.2f} m from an occupied cell, nearer than room_m, {room_m:g} m"
        raise ConfigError(
            f"{name} is {[round(value, 3) for value in point.tolist()]}, {where}; "
            "move it to a free place."
        )
