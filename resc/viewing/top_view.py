"""An environment from above, as it is now: obstacles, route, vehicle and the way it has come."""

import math
from collections.abc import Iterable, Sequence

import numpy as np
import torch
from jaxtyping import Float, UInt8
from matplotlib.colors import to_hex
from PIL import Image, ImageDraw
from torch import Tensor

from resc import keys
from resc.envs.quadrotor import QuadrotorEnv
from resc.maps.constants import INFLATION_M
from resc.maps.movers import motion
from resc.math.rotation import heading
from resc.scenes.layout import PARKED_M
from resc.viewing.colours import BACKGROUND, INFLATED, MOVER, OBSTACLE, PLAN, TRUE

EDGE_PX = 480
"""Of the longer side of a frame."""
SMOOTH = 2
"""Frames are drawn so many times larger and then shrunk, for Pillow draws jagged edges."""
TRAIL_STEPS = 500
VEHICLE_PX, POINT_PX, LINE_PX = 11.0, 3.0, 1.5
ARROW = ((1.0, 0.0), (-0.7, 0.65), (-0.35, 0.0), (-0.7, -0.65))
"""Outline of the vehicle, forward first, in half lengths."""
Points = Float[np.ndarray, "k 2"]
Columns = Iterable[Sequence[float]]


class TopView:
    """A camera over each environment of a batch, which shows the whole map.

    Pillow draws a frame in 2.4 ms.

    Args:
        env: What is shown.
    """

    def __init__(self, env: QuadrotorEnv) -> None:
        self.env = env
        size = env.pool.shared[keys.MAP_SIZE].amax(0).tolist()
        self.scale = SMOOTH * EDGE_PX / max(size)
        self.width, self.height = (_even(EDGE_PX * length / max(size)) for length in size)
        self._trails = torch.zeros(TRAIL_STEPS, env.num_envs, 2)

    def look(self) -> None:
        """Notes where the vehicles are."""
        step = self.env.value_of(keys.CLOCK)[:, 0].long().cpu() % TRAIL_STEPS
        position = self.env.value_of(keys.POSITION_W)[:, :2].cpu()
        self._trails[step, torch.arange(self.env.num_envs)] = position

    def frame(self, row: int) -> UInt8[np.ndarray, "h w 3"]:
        """One environment as it is now."""
        size = (SMOOTH * self.width, SMOOTH * self.height)
        image = Image.new("RGB", size, to_hex(BACKGROUND(1.0)))
        drawn = _Drawing(image, self._origin(row), self.scale)
        self._draw_scene(drawn, row)
        self._draw_flight(drawn, row)
        return np.asarray(image.reduce(SMOOTH)).copy()

    def _draw_scene(self, drawn: "_Drawing", row: int) -> None:
        boxes, pillars = (self._shared(key, row).tolist() for key in (keys.BOXES_W, keys.PILLARS_W))
        movers = self._shared(keys.MOVERS_W, row)
        time_s = self.env.value_of(keys.CLOCK)[row, None].cpu() * self.env.stages.context.dt_s
        centres, _ = motion(movers[None], time_s)
        moving = zip(centres[0].tolist(), movers[:, 4:6].tolist(), strict=True)
        there = [(x, y, half, deep) for (x, y), (half, deep) in moving]
        boxes_moving = [(x - a, y - b, 2 * a, 2 * b) for x, y, a, b in there if b]
        pillars_moving = [(x, y, radius) for x, y, radius, deep in there if not deep]
        drawn.rings([*boxes, *boxes_moving], [*pillars, *pillars_moving])
        drawn.columns(boxes, pillars, OBSTACLE)
        drawn.columns(boxes_moving, pillars_moving, MOVER)

    def _draw_flight(self, drawn: "_Drawing", row: int) -> None:
        route = self._own(keys.ROUTE_W, row)[: int(self._own(keys.ROUTE_LENGTH, row)), :2]
        step = int(self._own(keys.CLOCK, row))
        steps = torch.arange(max(0, step - TRAIL_STEPS + 1), step + 1) % TRAIL_STEPS
        trail = self._trails[steps, row].numpy()
        planned = torch.cat((self._start(row), route)).numpy()
        drawn.line(planned, PLAN, LINE_PX)
        for x, y in planned[1:-1].tolist():
            drawn.disc(x, y, drawn.metres(POINT_PX), PLAN)
        x, y = planned[-1].tolist()
        drawn.disc(x, y, drawn.metres(2.5 * POINT_PX), PLAN)
        drawn.disc(x, y, drawn.metres(1.5 * POINT_PX), "white")
        drawn.line(trail, TRUE, 2 * LINE_PX)
        x, y, _ = self._own(keys.POSITION_W, row).tolist()
        cosine, sine = heading(self._own(keys.ATTITUDE_WB, row)[None])[0].tolist()
        drawn.arrow(x, y, cosine, sine)

    def _own(self, key: keys.NestedKey, row: int) -> Tensor:
        return self.env.value_of(key)[row].cpu()

    def _shared(self, key: keys.NestedKey, row: int) -> Tensor:
        """The obstacles of a row's scene that are there."""
        some = self.env.pool.shared[key][int(self._own(keys.SCENE_INDEX, row))].cpu()
        return some[some[:, 0] < PARKED_M]

    def _start(self, row: int) -> Float[Tensor, "1 2"]:
        entry = int(self._own(keys.SCENE_INDEX, row))
        return self.env.pool.tasks[keys.START_W][entry, None, :2].cpu()

    def _origin(self, row: int) -> tuple[float, float]:
        """What the upper left pixel shows [m]: the map is in the middle."""
        entry = int(self._own(keys.SCENE_INDEX, row))
        corner, size = (
            self.env.pool.shared[key][entry].tolist() for key in (keys.MAP_ORIGIN_W, keys.MAP_SIZE)
        )
        wide, high = (SMOOTH * edge / self.scale for edge in (self.width, self.height))
        return corner[0] + (size[0] - wide) / 2, corner[1] + (size[1] + high) / 2


class _Drawing:
    """Shapes on an image, at places in metres."""

    def __init__(self, image: Image.Image, origin: tuple[float, float], scale: float) -> None:
        self.pen = ImageDraw.Draw(image)
        self.origin = origin
        self.scale = scale

    def metres(self, pixels: float) -> float:
        """So many pixels of the finished frame [m]."""
        return SMOOTH * pixels / self.scale

    def at(self, x: float, y: float) -> tuple[float, float]:
        """A place's pixel."""
        return (x - self.origin[0]) * self.scale, (self.origin[1] - y) * self.scale

    def rings(self, boxes: Columns, pillars: Columns) -> None:
        """What is within the vehicle's radius of boxes and pillars."""
        wide = INFLATION_M
        for x, y, length, depth in boxes:
            if length > 0 and depth > 0:
                corners = self.at(x - wide, y + depth + wide), self.at(x + length + wide, y - wide)
                self.pen.rounded_rectangle(corners, wide * self.scale, INFLATED)
        for x, y, radius in pillars:
            if radius > 0:
                self.disc(x, y, radius + wide, INFLATED)

    def columns(self, boxes: Columns, pillars: Columns, colour: str) -> None:
        """Boxes, by their least corner and edges, and pillars."""
        for x, y, length, depth in boxes:
            if length > 0 and depth > 0:
                self.pen.rectangle((self.at(x, y + depth), self.at(x + length, y)), colour)
        for x, y, radius in pillars:
            self.disc(x, y, radius, colour)

    def disc(self, x: float, y: float, radius: float, colour: str) -> None:
        """A disc around a place."""
        if radius > 0:
            low, high = self.at(x - radius, y + radius), self.at(x + radius, y - radius)
            self.pen.ellipse((low, high), colour)

    def line(self, points: Points, colour: str, pixels: float) -> None:
        """A line through places."""
        if len(points) > 1:
            places = [self.at(x, y) for x, y in points.tolist()]
            self.pen.line(places, colour, round(SMOOTH * pixels), joint="curve")

    def arrow(self, x: float, y: float, cosine: float, sine: float) -> None:
        """The vehicle, with its nose forward."""
        size = self.metres(VEHICLE_PX)
        outline = [
            self.at(x + size * (a * cosine - b * sine), y + size * (a * sine + b * cosine))
            for a, b in ARROW
        ]
        self.pen.polygon(outline, TRUE, "white", SMOOTH)


def _even(pixels: float) -> int:
    """A number of pixels that films can have: even, and two at least."""
    return max(2, 2 * math.ceil(pixels / 2))
