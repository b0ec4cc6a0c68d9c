"""The pool of scenes that environments are reset into."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.keys import DECLARED, NestedKey
from resc.maps.cells import extent_of, require_room, shape_of
from resc.maps.constants import TRUNCATION_M
from resc.maps.distance_transform import distance_transform
from resc.scenes.difficulty import eased
from resc.scenes.layout import Layout, Plan, Scene, pad, rasterize, rows, sampled

LAID_OUT = (
    keys.MAP_ORIGIN_W,
    keys.MAP_SIZE,
    keys.BOXES_W,
    keys.PILLARS_W,
    keys.MOVERS_W,
    keys.START_W,
    keys.START_MOTION,
    keys.ROUTE_W,
    keys.ROUTE_LENGTH,
    keys.ROUTE_CLEARANCE,
)
"""What the pool keeps of a layout, under the names of its fields."""
CHUNK = 32
"""Maps transformed at once: small enough for the cache."""
AHEAD, MOST = 8, 512
"""Renewals whose scenes are laid out at once, and how many scenes at most, unless one takes more:
most of what a small layout takes is dispatch."""
SLACK = 1e-4
"""Difficulties closer than this are one: float32 keeps 0.1 + 0.2 apart from 0.3."""


class ScenePool:
    """Many scenes with their distance fields, laid out once and renewed piece by piece.

    Renewal goes round the pool. The entries next in turn are closed to new episodes well before, so
    that hardly an episode is still in them. Scenes are laid out some renewals ahead.

    Scenes of every difficulty of `levels` are there from the first to the last episode, in equal
    shares and by turns, and a scene is renewed at its own. So a difficulty holds for the very next
    episode: with difficulties laid out when they are due, a pool of 2048 scenes renewed 64 at a
    time would lag behind by 32 batches, and never follow without renewal.

    Args:
        scene: What lays the scenes out.
        size: How many scenes it holds.
        resolution_m: Edge of a map cell.
        generator: Draws the scenes.
        device: Where the maps live.
        plan: Fills in routes for scenes that only know their goal.
        levels: Difficulties in [0, 1] that scenes are laid out at, in ascending order.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        size: int,
        resolution_m: float,
        generator: torch.Generator,
        device: torch.device | str = "cpu",
        plan: Plan | None = None,
        levels: Sequence[float] = (1.0,),
    ) -> None:
        if size < len(levels):
            raise ConfigError(
                f"pool_size is {size}, fewer than the {len(levels)} levels of difficulty; raise it."
            )
        self.scene = scene
        self.levels = torch.tensor(levels, dtype=torch.float32)
        self.resolution_m = resolution_m
        self.generator = generator
        self.plan = plan
        self.head = 0
        self.stock: Layout | None = None
        self.taken = 0
        layout = self._lay_out(torch.arange(size))
        self.drawn_from = generator.get_state()
        require_room(size, layout.size, resolution_m, device)
        self.shape = self._cells(layout)
        # clone: a scene may share one row among all
        kept = {key: value.clone().to(device) for key, value in _kept(layout).items()}
        self.shared: dict[NestedKey, Tensor] = {
            keys.ESDF: self._transform(layout).to(device),
            **{key: value for key, value in kept.items() if DECLARED[key].shared},
        }
        self.tasks: dict[NestedKey, Tensor] = {
            **{key: value for key, value in kept.items() if not DECLARED[key].shared},
            keys.SCENE_DIFFICULTY: self._difficulty(torch.arange(size)).to(device),
        }

    def __len__(self) -> int:
        return len(self.tasks[keys.START_W])

    @property
    def layout(self) -> Layout:
        """The scenes of now, on the CPU."""
        values = {**self.shared, **self.tasks}
        layout = layout_from({key[1]: values[key].cpu() for key in LAID_OUT})
        said = layout.clearance.where(layout.clearance.isfinite(), torch.nan)
        return replace(layout, clearance=said)

    def entry(
        self, unit: Float[Tensor, " k"], closed: int = 0, difficulty: float = 1.0
    ) -> Int[Tensor, " k"]:
        """Maps uniform numbers to open entries: all but the `closed` next in turn for renewal.

        Between two levels of difficulty, the share of the upper one is such that the mean is
        `difficulty`.
        """
        count = len(self.levels)
        if len(self) - closed < 2 * count - 1:  # fewer may leave a level without an open scene
            raise ConfigError(
                f"{closed} of {len(self)} scenes are closed for renewal; for episodes to begin, "
                f"leave {2 * count - 1} open: raise pool_size or lower renew_scenes."
            )
        open_entries = (self.head + torch.arange(closed, len(self))) % len(self)
        if count == 1:
            return _pick(open_entries, unit)
        lower, share = self._level(difficulty)
        below = _pick(open_entries[open_entries % count == lower], (unit - share) / (1 - share))
        if not share:
            return below
        above = _pick(open_entries[open_entries % count == lower + 1], unit / share)
        return torch.where(unit < share, above, below)

    def require_level(self, name: str, difficulty: float) -> None:
        """Raises ConfigError if there is not a scene at a difficulty that is asked for."""
        levels = self.levels.tolist()
        if len(levels) == 1 and abs(difficulty - levels[0]) > SLACK:
            raise ConfigError(
                f"All scenes are laid out at difficulty {levels[0]:g}, so '{name}' cannot be "
                f"{difficulty:g}; build the environment with a curriculum that has levels for it, "
                "such as curriculum=success."
            )

    def renew(self, count: int) -> Int[Tensor, " k"]:
        """Renews the next `count` scenes; returns their entries.

        A planned route longer than every first one finds no room; its scene is kept as it was.
        """
        entries = (self.head + torch.arange(count)) % len(self)
        layout = self._from_stock(count)
        self.head = (self.head + count) % len(self)
        room = self.tasks[keys.ROUTE_W].shape[1]
        fits = layout.route_length[:, 0] <= room
        fitting = rows(layout, fits)
        fitting = replace(fitting, route_w=fitting.route_w[:, :room])
        kinds = (keys.BOXES_W, keys.PILLARS_W, keys.MOVERS_W)
        boxes, pillars, movers = (self.shared[key].shape[1] for key in kinds)
        self._write(entries[fits], pad(fitting, boxes, pillars, movers, room))
        return entries[fits]

    def state(self) -> dict[str, Tensor | int]:
        """What a checkpoint needs to rebuild the pool; the distance fields are computed again."""
        values = {**self.shared, **self.tasks}
        layout = {key[1]: values[key].cpu().clone() for key in LAID_OUT}
        drawn = self.drawn_from if self.stock else self.generator.get_state()
        stock = {"stocked": len(self.stock or ()), "taken": self.taken}
        return {**layout, "head": self.head, "generator": drawn, **stock}

    def load_state(self, state: dict[str, Any]) -> None:
        """Takes a checkpoint's scenes."""
        self.generator.set_state(state["generator"])
        self.head = int(state["head"])
        self.stock, self.taken = None, int(state.get("taken", 0))
        if stocked := int(state.get("stocked", 0)):
            self._lay_in(stocked)
        self._write(torch.arange(len(self)), layout_from(state))

    def _from_stock(self, count: int) -> Layout:
        """The next scenes of those laid out ahead."""
        if self.stock is None or self.taken + count > len(self.stock):
            self.taken = 0
            self._lay_in(count * max(1, min(AHEAD, MOST // max(count, 1))))
        assert self.stock is not None
        self.taken += count
        return rows(self.stock, torch.arange(self.taken - count, self.taken))

    def _lay_in(self, count: int) -> None:
        """Lays out scenes ahead, of which `taken` are in the pool already."""
        self.drawn_from = self.generator.get_state()
        first = self.head - self.taken
        self.stock = self._lay_out((first + torch.arange(count)) % len(self))

    def _write(self, entries: Tensor, layout: Layout) -> None:
        if len(layout) and any(a > b for a, b in zip(self._cells(layout), self.shape, strict=True)):
            raise ConfigError(
                f"A renewed scene has {self._cells(layout)} rows and columns of cells, more than "
                f"the {self.shape} of the first ones; give scenes one size, or set renew_scenes=0."
            )
        there = entries.to(self.shared[keys.ESDF].device)
        fresh = _kept(layout) | {keys.ESDF: self._transform(layout)}
        for key, value in fresh.items():
            where = self.shared if key in self.shared else self.tasks
            where[key][there] = value.to(there.device)

    def _difficulty(self, entries: Int[Tensor, " k"]) -> Float[Tensor, "k 1"]:
        """The difficulty that each entry is laid out at: the levels by turns."""
        return self.levels[entries % len(self.levels)].unsqueeze(-1)

    def _level(self, difficulty: float) -> tuple[int, float]:
        """The level at or below a difficulty, and the share of the one above it."""
        levels = self.levels.tolist()
        difficulty = min(max(difficulty, levels[0]), levels[-1])
        lower = max(i for i, level in enumerate(levels) if level <= difficulty + SLACK)
        if lower + 1 == len(levels):
            return lower, 0.0
        share = (difficulty - levels[lower]) / (levels[lower + 1] - levels[lower])
        return lower, share if share > SLACK else 0.0

    def _lay_out(self, entries: Int[Tensor, " k"]) -> Layout:
        layout = sampled(self.scene, len(entries), self.generator, self.plan)
        layout = replace(layout, size=extent_of(layout.size, self.resolution_m))
        if self.levels.tolist() != [1.0]:
            layout = eased(layout, self._difficulty(entries))
        if (layout.route_length > 0).all():
            return layout
        if self.plan is None:
            raise ConfigError(
                f"{type(self.scene).__name__} knows no route, only a goal; give it a planner "
                "(search=exact)."
            )
        return self.plan(layout)

    def _cells(self, layout: Layout) -> tuple[int, int]:
        """Rows and columns that hold every map of a layout."""
        return shape_of(layout.size, self.resolution_m)

    def _transform(self, layout: Layout) -> Float[Tensor, "p h w"]:
        parts = []
        obstacles = (layout.boxes_w, layout.origin_w, layout.pillars_w)
        for boxes, origin, pillars in zip(*(part.split(CHUNK) for part in obstacles), strict=True):
            occupied = rasterize(boxes, origin, self.shape, self.resolution_m, pillars)
            parts.append(distance_transform(occupied, self.resolution_m, TRUNCATION_M))
        return torch.cat(parts)


def layout_from(arrays: Mapping[str, Any]) -> Layout:
    """The scenes that a checkpoint or a recording holds; older ones lack what came later."""
    return Layout(**{key[1]: arrays[key[1]] for key in LAID_OUT if key[1] in arrays})


def _kept(layout: Layout) -> dict[NestedKey, Tensor]:
    """A layout under the keys of the pool.

    What the routes keep is infinite, which equals itself, where the layout does not say.
    """
    kept = {key: getattr(layout, key[1]) for key in LAID_OUT}
    clearance = kept[keys.ROUTE_CLEARANCE]
    return kept | {keys.ROUTE_CLEARANCE: clearance.where(~clearance.isnan(), torch.inf)}


def _pick(entries: Int[Tensor, " o"], unit: Float[Tensor, " k"]) -> Int[Tensor, " k"]:
    """Maps uniform numbers in [0, 1) to entries."""
    return entries[(unit * len(entries)).long().clamp(0, len(entries) - 1)]
