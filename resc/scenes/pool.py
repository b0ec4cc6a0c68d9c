"""The pool of scenes that environments are reset into."""

from collections.abc import Callable
from dataclasses import fields
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.keys import NestedKey
from resc.maps.distance_transform import distance_transform
from resc.scenes.layout import Layout, Scene, pad, rasterize

TRUNCATION_M = 3.0
"""The published distance field ends here (facts 4.2)."""
CHUNK = 32
"""Maps transformed at once: small enough for the cache."""


class ScenePool:
    """Many scenes with their distance fields, laid out once and renewed piece by piece.

    Renewal goes round the pool. The entries next in turn are closed to new episodes well before, so
    that hardly an episode is still in them; `retired` tells which are.

    Args:
        scene: What lays the scenes out.
        size: How many scenes it holds.
        resolution_m: Edge of a map cell.
        generator: Draws the scenes.
        device: Where the maps live.
        plan: Fills in routes for scenes that only know their goal.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        size: int,
        resolution_m: float,
        generator: torch.Generator,
        device: torch.device | str = "cpu",
        plan: Callable[[Layout], Layout] | None = None,
    ) -> None:
        self.scene = scene
        self.resolution_m = resolution_m
        self.generator = generator
        self.plan = plan
        self.head = 0
        self.layout = self._lay_out(size)
        cells = (self.layout.size.amax(0) / resolution_m).round().int().tolist()
        self.shape = (cells[1], cells[0])
        esdf = self._transform(self.layout)
        self.shared: dict[NestedKey, Tensor] = {
            keys.ESDF: esdf.to(device),
            # clone: a scene may share one row among all
            keys.MAP_ORIGIN_W: self.layout.origin_w.clone().to(device),
            keys.MAP_SIZE: self.layout.size.clone().to(device),
            keys.BOXES_W: self.layout.boxes_w.clone().to(device),
        }
        self.tasks: dict[NestedKey, Tensor] = {
            keys.START_W: self.layout.start_w.clone().to(device),
            keys.ROUTE_W: self.layout.route_w.clone().to(device),
            keys.ROUTE_LENGTH: self.layout.route_length.clone().to(device),
        }

    def __len__(self) -> int:
        return len(self.layout)

    def entry(self, unit: Float[Tensor, " k"], closed: int = 0) -> Int[Tensor, " k"]:
        """Maps uniform numbers to open entries: all but the `closed` next in turn for renewal."""
        open_entries = len(self) - closed
        if open_entries < 1:
            raise ConfigError(
                f"closed is {closed} of {len(self)} scenes; expected fewer, for episodes to begin."
            )
        offset = (unit * open_entries).long().clamp(max=open_entries - 1)
        return (self.head + closed + offset) % len(self)

    def renew(self, count: int) -> Int[Tensor, " k"]:
        """Lays the next `count` scenes out anew; returns their entries.

        A planned route longer than every first one finds no room; its scene is kept as it was.
        """
        layout, entries = self._lay_out(count), (self.head + torch.arange(count)) % len(self)
        self.head = (self.head + count) % len(self)
        room = self.tasks[keys.ROUTE_W].shape[1]
        fits = layout.route_length[:, 0] <= room
        rows = {f.name: getattr(layout, f.name)[fits] for f in fields(Layout)}
        rows["route_w"] = rows["route_w"][:, :room]
        self._write(entries[fits], pad(Layout(**rows), self.shared[keys.BOXES_W].shape[1], room))
        return entries[fits]

    def state(self) -> dict[str, Tensor | int]:
        """What a checkpoint needs to rebuild the pool; the distance fields are computed again."""
        names = ("boxes_w", "origin_w", "size", "start_w", "route_w", "route_length")
        shared = {**self.shared, **self.tasks}
        by_name = {key[1]: value for key, value in shared.items()}
        layout = {name: by_name[name].cpu().clone() for name in names}
        return {**layout, "head": self.head, "generator": self.generator.get_state()}

    def load_state(self, state: dict[str, Any]) -> None:
        """Takes a checkpoint's scenes."""
        self.generator.set_state(state["generator"])
        self.head = int(state["head"])
        fields = {
            name: state[name]
            for name in ("boxes_w", "origin_w", "size", "start_w", "route_w", "route_length")
        }
        self._write(torch.arange(len(self)), Layout(**fields))

    def _write(self, entries: Tensor, layout: Layout) -> None:
        rows = entries.to(self.shared[keys.ESDF].device)
        fresh = {
            keys.ESDF: self._transform(layout),
            keys.MAP_ORIGIN_W: layout.origin_w,
            keys.MAP_SIZE: layout.size,
            keys.BOXES_W: layout.boxes_w,
            keys.START_W: layout.start_w,
            keys.ROUTE_W: layout.route_w,
            keys.ROUTE_LENGTH: layout.route_length,
        }
        for key, value in fresh.items():
            where = self.shared if key in self.shared else self.tasks
            where[key][rows] = value.to(rows.device)

    def _lay_out(self, count: int) -> Layout:
        layout = self.scene.sample(count, self.generator)
        if (layout.route_length > 0).all():
            return layout
        if self.plan is None:
            raise ConfigError(
                f"{type(self.scene).__name__} knows no route, only a goal; give it a planner "
                "(search=visibility)."
            )
        return self.plan(layout)

    def _transform(self, layout: Layout) -> Float[Tensor, "p h w"]:
        parts = []
        for boxes, origin in zip(
            layout.boxes_w.split(CHUNK), layout.origin_w.split(CHUNK), strict=True
        ):
            occupied = rasterize(boxes, origin, self.shape, self.resolution_m)
            parts.append(distance_transform(occupied, self.resolution_m, TRUNCATION_M))
        return torch.cat(parts)
