"""Obstacles that move: how many, how large, how fast and along which ways."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from resc.errors import ConfigError
from resc.math.sampling import uniform
from resc.quantities import CountOrNone, NotNegative, Positive, Share
from resc.scenes.family import require_ranges, whole
from resc.scenes.layout import NO_MOVER, Layout

FULL = 0.5
"""Share of a map that its movers may cover, were they all as large as they may be."""
TRIES = 100
"""How often a mover that begins too near the start is drawn again."""
ALONG = (0.2, 0.9)
"""Part of the route that movers cross."""
ASLANT_RAD = 0.5
"""Greatest angle of a crossing mover's way to the normal of the route."""


class Movers:
    """Columns that move, each with a way, a speed and a size of its own, the same for ever.

    Of those of a map, a share is *crossing*: to and fro along a straight line across the route,
    which runs from the start through the control points (straight to the goal of a scene without a
    route). A share moves at a *constant* velocity, and leaves the map where it ends. All others are
    *bouncing* from side to side of the map. None begins within `keep_clear_m` of the start: it is
    drawn again. Movers pass through obstacles and each other.

    Args:
        count: Least and greatest number on a map.
        size_m: Least and greatest edge of a box, or diameter of a round one.
        speed_mps: Least and greatest speed.
        crossing: Share that crosses the route.
        constant: Share that goes on at a constant velocity.
        round: Share of round ones; the others are boxes along the axes.
        reach_m: Least and greatest way of a crossing mover to each side of the route.
        keep_clear_m: Least distance from the start to a surface at the beginning.
    """

    def __init__(
        self,
        *,
        count: Sequence[CountOrNone],
        size_m: Sequence[Positive] = (0.4, 0.8),
        speed_mps: Sequence[NotNegative] = (1.0, 1.0),
        crossing: Share = 0.5,
        constant: Share = 0.0,
        round: Share = 0.5,
        reach_m: Sequence[Positive] = (1.5, 3.5),
        keep_clear_m: NotNegative = 1.5,
    ) -> None:
        require_ranges(count=count, size_m=size_m, speed_mps=speed_mps, reach_m=reach_m)
        if crossing + constant > 1:
            raise ConfigError(
                f"crossing and constant are {crossing:g} and {constant:g}, more than all movers; "
                "lower one of them."
            )
        self.count = count
        self.size_m = size_m
        self.speed_mps = speed_mps
        self.crossing = crossing
        self.constant = constant
        self.round = round
        self.reach_m = reach_m
        self.keep_clear_m = keep_clear_m

    def on(self, layout: Layout, generator: torch.Generator) -> Layout:
        """The scenes with movers, of which each has room for as many.

        Raises:
            ConfigError: There is no room for them.
        """
        if not self.count[1]:
            return layout
        self._require_room(layout)
        number = whole(len(layout), self.count, generator)
        movers = self._drawn(layout, number, generator)
        for _ in range(TRIES):
            offset = movers[..., :2] - layout.start_w[:, None, :2]
            reach = torch.linalg.vector_norm(movers[..., 4:6], dim=-1)  # that of a box's corner
            near = torch.linalg.vector_norm(offset, dim=-1) - reach < self.keep_clear_m
            if not near.any():
                break
            movers = torch.where(near.unsqueeze(-1), self._drawn(layout, number, generator), movers)
        else:
            raise ConfigError(
                f"movers.keep_clear_m is {self.keep_clear_m:g}, and a mover began nearer to the "
                f"start in each of {TRIES} tries; lower it."
            )
        there = torch.arange(self.count[1]) < number
        return replace(
            layout, movers_w=torch.where(there.unsqueeze(-1), movers, movers.new_tensor(NO_MOVER))
        )

    def _require_room(self, layout: Layout) -> None:
        """Movers that cover most of a map leave no way, and one larger than it no place."""
        width, height = layout.size.amin(0).tolist()
        number, size = self.count[1], self.size_m[1]
        if size >= min(width, height):
            raise ConfigError(
                f"movers.size_m is {list(self.size_m)}, as large as the map of {width:g} x "
                f"{height:g} m; lower it."
            )
        if number * size**2 > FULL * width * height:
            raise ConfigError(
                f"movers.count is {list(self.count)}, but {number} of {size:g} m would cover more "
                f"than half of the map of {width:g} x {height:g} m; lower count or size_m."
            )

    def _drawn(
        self, layout: Layout, number: Int[Tensor, "p 1"], generator: torch.Generator
    ) -> Float[Tensor, "p o 10"]:
        """As many movers as there may be, of which the first `number` count."""
        shape = len(layout), self.count[1]
        half = uniform((*shape, 2), *self.size_m, generator=generator) / 2
        is_round = uniform(shape, 0, 1, generator) < self.round
        speed = uniform((*shape, 1), *self.speed_mps, generator=generator)
        reach = torch.where(is_round.unsqueeze(-1), half[..., :1], half)
        low = layout.origin_w.unsqueeze(1) + reach
        high = (layout.origin_w + layout.size).unsqueeze(1) - reach
        place = low + uniform((*shape, 2), 0, 1, generator) * (high - low)
        way = _direction(uniform(shape, 0, 2 * torch.pi, generator))
        crossing = self._crossing(layout, low, high, generator)
        kind = self._kinds(number)
        ways = torch.stack(
            (
                torch.cat(crossing, -1),
                torch.cat((place, way, place, place), -1),
                torch.cat((place, way, low, high), -1),
            )
        )
        chosen = ways.gather(0, kind[None, ..., None].expand(1, *shape, 8))[0]
        place, way, low, high = chosen.split(2, -1)
        half[..., 1] = half[..., 1].where(~is_round, 0)
        return torch.cat((place, way * speed, half, low, high), -1)

    def _kinds(self, number: Int[Tensor, "p 1"]) -> Int[Tensor, "p o"]:
        """What each is: 0 crossing, 1 constant, 2 bouncing, in this order."""
        share = (torch.arange(self.count[1]) + 0.5) / number.clamp(min=1)
        return (share > self.crossing).long() + (share > self.crossing + self.constant).long()

    def _crossing(
        self,
        layout: Layout,
        low: Float[Tensor, "p o 2"],
        high: Float[Tensor, "p o 2"],
        generator: torch.Generator,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Places, directions and ends of lines across the routes, within the map."""
        shape = low.shape[:2]
        point, along = _on_routes(layout, uniform(shape, *ALONG, generator))
        aslant = uniform(shape, -ASLANT_RAD, ASLANT_RAD, generator)
        side = torch.where(uniform(shape, 0, 1, generator) < 0.5, -torch.pi / 2, torch.pi / 2)
        way = _direction(along + side + aslant)
        point = point.maximum(low).minimum(high)
        reach = uniform((*shape, 1), *self.reach_m, generator=generator)
        slope = torch.where(way.abs() < 1e-3, 1e-3, way)
        one, other = (low - point) / slope, (high - point) / slope
        first = torch.minimum(one, other).amax(-1, keepdim=True).maximum(-reach)
        last = torch.maximum(one, other).amin(-1, keepdim=True).minimum(reach)
        ends = torch.stack((point + first * way, point + last * way))
        place = ends[0] + uniform((*shape, 1), 0, 1, generator) * (ends[1] - ends[0])
        return place, way, ends.amin(0), ends.amax(0)


def _direction(angle: Float[Tensor, "*n"]) -> Float[Tensor, "*n 2"]:
    return torch.stack((angle.cos(), angle.sin()), -1)


def _on_routes(
    layout: Layout, share: Float[Tensor, "p o"]
) -> tuple[Float[Tensor, "p o 2"], Float[Tensor, "p o"]]:
    """Points at these shares of the lengths of the routes, and the routes' angles there."""
    way = torch.cat((layout.start_w.unsqueeze(1), layout.route_w), 1)[..., :2]
    legs = way.diff(dim=1)
    there: Bool[Tensor, "p r"] = torch.arange(legs.shape[1]) < layout.route_length.clamp(min=1)
    lengths = torch.linalg.vector_norm(legs, dim=-1) * there
    ends = lengths.cumsum(1)
    aim = share * ends[:, -1:]
    leg = (ends.unsqueeze(1) < aim.unsqueeze(-1)).sum(-1)
    leg = leg.minimum(layout.route_length.clamp(min=1) - 1)
    pick = leg.unsqueeze(-1).expand(-1, -1, 2)
    run, begin = legs.gather(1, pick), way.gather(1, pick)
    length = lengths.gather(1, leg)
    part = (aim - ends.gather(1, leg) + length) / length.clamp(min=1e-6)
    return begin + part.unsqueeze(-1) * run, torch.atan2(run[..., 1], run[..., 0])


def movers_of(movers: object) -> Movers | None:
    """What a setting says that moves.

    Raises:
        ConfigError: It is neither nothing nor `Movers`.
    """
    if not isinstance(movers, Movers | None):
        raise ConfigError(
            f"movers is {movers!r}; expected null, or a node such as "
            "{_target_: resc.scenes.moving.Movers, count: [10, 10]}."
        )
    return movers
