"""Maps of ROS's map_server: an image of cells, and a YAML file that says where they are."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from jaxtyping import Bool, Float
from PIL import Image, UnidentifiedImageError

from resc.errors import ConfigError, nearest
from resc.scenes.grid_map import GridMap, number_of, require_cells
from resc.scenes.turned import turned

NEEDED = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
MODES = ("trinary", "scale", "raw")
SUFFIXES = (".yaml", ".yml")
IMAGES = (".pgm", ".png", ".bmp", ".jpg", ".jpeg", ".tif", ".tiff", ".ppm")
OPAQUE = 255


@dataclass(frozen=True)
class Reading:
    """What of an image is occupied.

    Args:
        occupied_thresh: A cell is occupied above this probability; null is what the YAML says.
        free_thresh: A cell is free below this probability; null is what the YAML says.
        occupied_at: Least value from 0 to 100 that counts as occupied, in the modes scale and raw.
        unknown_occupied: Whether unknown cells count as occupied.
    """

    occupied_thresh: float | None = None
    free_thresh: float | None = None
    occupied_at: float = 50.0
    unknown_occupied: bool = True


def read_map_server(path: Path, reading: Reading) -> GridMap:
    """The map that a YAML file and its image describe, by the rules of ROS's map_server.

    A turned map (`origin` with a yaw) is laid onto cells along the axes.

    Raises:
        ConfigError: A file is missing or damaged, or holds what no map can be read from.
    """
    node = _described(path)
    cell_m = number_of(f"resolution in {path}", node["resolution"])
    origin = node["origin"]
    if not isinstance(origin, list) or len(origin) != 3:
        raise ConfigError(f"origin in {path} is {origin!r}; expected [x, y, yaw].")
    x, y, yaw = (number_of(f"origin in {path}", value) for value in origin)
    value, opaque = _image(path, str(node["image"]), cell_m)
    unknown, occupied = _classified(path, node, value, opaque, reading)
    cells = (occupied | unknown if reading.unknown_occupied else occupied)[::-1]
    if yaw == 0:
        return GridMap(np.ascontiguousarray(cells), cell_m, (x, y))
    return turned(GridMap(cells, cell_m, (x, y)), yaw, outside=reading.unknown_occupied)


def image_of(path: Path) -> Path | None:
    """The image that a map's YAML file names; None of another file, or one that names none."""
    if path.suffix.lower() not in SUFFIXES:
        return None
    try:
        return path.parent / str(_described(path)["image"])
    except ConfigError:
        return None


def refuse_image(path: Path) -> None:
    """Says of an image that its YAML is what to name."""
    if path.suffix.lower() in IMAGES:
        beside = path.with_suffix(".yaml")
        there = f"name {beside}" if beside.is_file() else "give it a YAML file, as map_saver writes"
        raise ConfigError(
            f"file is '{path}', an image, which does not say how large its cells are; {there}."
        )


def _described(path: Path) -> dict[str, Any]:
    """What the YAML file says; all that is needed is there."""
    try:
        node = yaml.safe_load(path.read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        cause = " ".join(str(error).split())
        raise ConfigError(f"file: {path} cannot be read as YAML ({cause}).") from None
    if not isinstance(node, Mapping):
        raise ConfigError(f"file: {path} is no map; expected {', '.join(NEEDED)}.")
    for name in NEEDED:
        if name not in node:
            others = [str(key) for key in node if key not in NEEDED]
            raise ConfigError(f"{path} lacks '{name}'.{nearest(name, others)}")
    return dict(node)


def _image(
    path: Path, name: str, cell_m: float
) -> tuple[Float[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """How bright each pixel is, from 0 to 255, and whether it is opaque; row 0 is the top."""
    file = path.parent / name
    if not file.is_file():
        raise ConfigError(f"{path} names the image '{name}', and there is no file {file}.")
    try:
        with Image.open(file) as image:
            require_cells(file, (image.height, image.width), cell_m)
            if image.mode.startswith(("I", "F")):
                raise ConfigError(f"{file} has more than 8 bits per pixel; save it with 8.")
            clear = "A" in image.getbands() or "transparency" in image.info
            pixels = np.asarray(image.convert("RGBA" if clear else "RGB"), float)
    except (UnidentifiedImageError, Image.DecompressionBombError, OSError, ValueError) as error:
        raise ConfigError(f"{file} cannot be read as an image ({error}).") from None
    opaque = pixels[..., 3] == OPAQUE if clear else np.ones(pixels.shape[:2], bool)
    return pixels[..., :3].mean(-1), opaque


def _classified(
    path: Path,
    node: Mapping[str, Any],
    value: Float[np.ndarray, "h w"],
    opaque: Bool[np.ndarray, "h w"],
    reading: Reading,
) -> tuple[Bool[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Which cells are unknown, and which occupied."""
    mode, negate = node.get("mode", "trinary"), node["negate"]
    if mode not in MODES:
        raise ConfigError(f"mode in {path} is {mode!r}; expected one of {', '.join(MODES)}.")
    if negate not in (0, 1):
        raise ConfigError(f"negate in {path} is {negate!r}; expected 0 or 1.")
    if mode == "raw":
        if negate:
            raise ConfigError(
                f"{path} has negate: 1 with mode: raw, which ROS 1 heeds and ROS 2 does not; "
                "negate the image itself."
            )
        return (value > 100) | ~opaque, (value <= 100) & (value >= reading.occupied_at) & opaque
    above, below = _thresholds(path, node, reading)
    chance = (value if negate else 255 - value) / 255
    between = (chance <= above) & (chance >= below) & opaque
    occupied = (chance > above) & opaque
    if mode == "trinary":
        return between | ~opaque, occupied
    percent = 100 * (chance - below) / (above - below)
    return ~opaque, occupied | (between & (percent >= reading.occupied_at))


def _thresholds(path: Path, node: Mapping[str, Any], reading: Reading) -> tuple[float, float]:
    """Above which probability a cell is occupied, and below which it is free."""
    values = []
    for name in ("occupied_thresh", "free_thresh"):
        set_here = getattr(reading, name)
        value = number_of(f"{name} in {path}", node[name]) if set_here is None else set_here
        if not 0 <= value <= 1:
            raise ConfigError(f"{name} in {path} is {value:g}; expected a number from 0 to 1.")
        values.append(value)
    above, below = values
    if below >= above:
        raise ConfigError(
            f"free_thresh of {path} is {below:g} and occupied_thresh {above:g}; expected "
            "free_thresh below occupied_thresh."
        )
    return above, below
