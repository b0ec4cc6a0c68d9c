"""Maps out of point clouds: a cell with a point at flight height is occupied."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from resc.errors import ConfigError
from resc.scenes.grid_map import GridMap, require_cells


def read_cloud(path: Path, *, cell_m: float | None, height_m: Sequence[float] | None) -> GridMap:
    """The map of a .pcd or .ply file, as wide as all its points; those that are NaN are left out.

    Args:
        path: The file.
        cell_m: Edge of a cell.
        height_m: Least and greatest z of the points that are obstacles.

    Raises:
        ConfigError: The file is damaged or has no points at this height, a setting or the library
            that reads the format is missing.
    """
    for name, value in (("cell_m", cell_m), ("height_m", height_m)):
        if value is None:
            raise ConfigError(f"{name} is missing; a point cloud such as {path} needs it.")
    assert cell_m is not None
    assert height_m is not None
    if len(height_m) != 2 or not height_m[0] < height_m[1]:
        raise ConfigError(f"height_m is {list(height_m)}; expected [least, greatest].")
    points = _points(path)
    points = points[np.isfinite(points).all(1)]
    if not len(points):
        raise ConfigError(f"file: {path} has not a single point that is finite.")
    low, high = (np.floor(edge / cell_m) for edge in (points[:, :2].min(0), points[:, :2].max(0)))
    columns, rows = (int(count) for count in high - low + 1)
    require_cells(path, (rows, columns), cell_m)
    flown = points[(points[:, 2] >= height_m[0]) & (points[:, 2] <= height_m[1])]
    if not len(flown):
        raise ConfigError(
            f"file: {path} has no point from {height_m[0]:g} to {height_m[1]:g} m high, but from "
            f"{points[:, 2].min():g} to {points[:, 2].max():g} m; change height_m."
        )
    occupied = np.zeros((rows, columns), bool)
    column, row = (np.floor(flown[:, :2] / cell_m) - low).astype(int).T
    occupied[row, column] = True
    x, y = (float(at * cell_m) for at in low)
    return GridMap(occupied, cell_m, (x, y))


def _points(path: Path) -> Float[np.ndarray, "points 3"]:
    try:
        return _from_pcd(path) if path.suffix.lower() == ".pcd" else _from_ply(path)
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"The package '{error.name}' is not installed; it comes with the extra 'maps': "
            "pip install 'resc[maps]'."
        ) from None
    except ConfigError:
        raise
    except Exception as error:  # of whatever kind the two libraries raise for damaged bytes
        cause = str(error).partition("\n")[0]
        raise ConfigError(f"file: {path} cannot be read as a point cloud ({cause}).") from None


def _from_pcd(path: Path) -> Float[np.ndarray, "points 3"]:
    from pypcd4.pypcd4 import PointCloud

    return PointCloud.from_path(path).numpy(("x", "y", "z")).astype(float)


def _from_ply(path: Path) -> Float[np.ndarray, "points 3"]:
    import trimesh

    cloud = trimesh.load(path, file_type="ply")
    if not isinstance(cloud, trimesh.PointCloud):
        raise ConfigError(
            f"file: {path} is a {type(cloud).__name__.lower()}; expected points alone: sample its "
            "surface."
        )
    return np.asarray(cloud.vertices, float)
