"""Replanning in flight, on the map that each vehicle knows."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, Int8
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.keys import NestedKey
from resc.maps.cpu_kernels import share_out
from resc.math.route import next_two
from resc.planning import replanning_kernels
from resc.planning.control_points import released_points
from resc.planning.replanning_kernels import CLOSED_OFF, RENEWED
from resc.planning.searches.open_list import workspace
from resc.quantities import NotNegative, Positive, Within
from resc.term import Context, Replanning

LEAST = 4
"""So many vehicles are worth a second thread."""
NONE = -1
"""Steps until a route arrives, where none is on its way."""


class InFlight(Replanning):
    """Checks the route ahead `check_hz` times a second, and plans it again where it is blocked.

    The search is exact (`resc.planning.searches.exact`), from where the vehicle is to the goal, on
    the map that it knows. What is unknown counts as free, with two exceptions, each only if there
    is such a way: within `seen_m` of the vehicle, a route leads through cells that were seen, and
    elsewhere it keeps `unseen_m` more from known obstacles in cells that were not. So it is the
    shortest one that is not known to be blocked, and remains that until a new obstacle lies on it:
    nothing is gained by planning without a cause. The policy flies on by the old control points
    until the new ones arrive, `latency_steps` after the map that they are planned on. The first
    route of an episode is planned at once, on what the first look shows.

    A route that begins against the motion of the vehicle, or turns from it more sharply than
    `lateral_mps2` allows, is taken only if it is shorter by `turn_m` than the shortest one that
    does not: turning back costs time, a sharp turn near an obstacle may end in it, and as the map
    grows the shortest way may lie now on this side, now on the other.

    What a vehicle flies through within `entered_s` it has entered: this part of a route is blocked
    only where it comes within `entered_m` of a known obstacle, and is open to new routes until
    then. A gap that turns out to be a little narrower is flown through: to turn away from it at
    speed is more dangerous.

    An end inside the clearance is moved to the nearest free cell within `link_m`, and flagged.
    Where no way to the goal is known, the route has no control points but the place where that was
    found, which is never passed, and the search is tried again at each check: the vehicle hovers
    until a way opens or time is up.
    Nothing is planned for an episode that is over but flown on, as in evaluations.

    Args:
        check_hz: Checks of the route per second.
        ahead_m: How much of the route ahead is checked.
        margin_m: A route that comes nearer to a known obstacle is blocked.
        clearance_m: What a new route keeps from known obstacles; null for what the first one kept,
            or the margin where that is not known.
        link_m: How far an end may be moved out of the clearance.
        turn_m: How much longer a route may be that goes on than one that turns sharply.
        lateral_mps2: Acceleration across the motion with which a route may turn from it; 0 for any.
        seen_m: How near the vehicle a route has to lead through cells that were seen.
        unseen_m: How much more than the clearance a route keeps from known obstacles in cells that
            were not seen, if there is such a way: obstacles are thicker than their seen sides.
        entered_s: For how long ahead a route counts as entered; 0 for no part of it.
        entered_m: What that part has to keep from known obstacles.
        edge_m: How far new routes stay from the sides of the map; a nearer end is moved, as one
            inside the clearance is.
        latency_steps: Control steps from a map to the route that is planned on it.
        max_expansions: Work after which a search gives up.
        spacing_m: Least and greatest distance between control points.
        nominal_m: Distance aimed at on long lines.
        rule: How they are laid (`resc.planning.control_points`): with lines that stay free, or as
            in the released code.
        points: Control points that a route has room for.
    """

    reads = (
        keys.CLOCK,
        keys.POSITION_W,
        keys.VELOCITY_W,
        keys.SCENE_INDEX,
        keys.MAP_ORIGIN_W,
        keys.MAP_SIZE,
        keys.KNOWN_ESDF,
        keys.KNOWN_EVIDENCE,
        keys.ROUTE_W,
        keys.ROUTE_LENGTH,
        keys.ROUTE_INDEX,
        keys.REPLAN_GOAL_W,
        keys.REPLAN_CLEARANCE,
        keys.PENDING_ROUTE_W,
        keys.PENDING_LENGTH,
        keys.PENDING_STEPS,
        keys.HOVER_W,
        keys.REPLAN_STATUS,
        keys.REPLANS,
        keys.DONE,
        keys.REPLAN_OVER,
    )
    writes = (
        keys.ROUTE_W,
        keys.ROUTE_LENGTH,
        keys.ROUTE_INDEX,
        keys.CONTROL_POINTS_W,
        keys.PENDING_ROUTE_W,
        keys.PENDING_LENGTH,
        keys.PENDING_STEPS,
        keys.HOVER_W,
        keys.REPLAN_STATUS,
        keys.REPLANS,
        keys.REPLAN_MOVED,
        keys.REPLAN_OVER,
    )
    keeps = (*writes, keys.REPLAN_GOAL_W, keys.REPLAN_CLEARANCE)

    def __init__(
        self,
        *,
        check_hz: Positive = 20.0,
        ahead_m: Positive = 6.0,
        margin_m: Positive = 0.3,
        clearance_m: Positive | None = 0.4,
        link_m: NotNegative = 1.0,
        turn_m: NotNegative = 4.0,
        lateral_mps2: NotNegative = 0.0,
        seen_m: NotNegative = 1.0,
        unseen_m: NotNegative = 0.0,
        entered_s: NotNegative = 0.0,
        entered_m: NotNegative = 0.15,
        edge_m: NotNegative = 0.0,
        latency_steps: Annotated[int, Within(0, 50)] = 1,
        max_expansions: Annotated[int, Within(1, 1e9)] = 100_000,
        spacing_m: Sequence[Positive] = (1.0, 2.0),
        nominal_m: Positive = 1.5,
        rule: Literal["visible", "released"] = "visible",
        points: Annotated[int, Within(8, 512)] = 64,
    ) -> None:
        super().__init__()
        if len(spacing_m) != 2 or not 0 < spacing_m[0] < spacing_m[1]:
            raise ConfigError(f"spacing_m is {list(spacing_m)}; expected [least, greatest].")
        if clearance_m is not None and clearance_m < margin_m:
            raise ConfigError(
                f"clearance_m is {clearance_m:g}, below margin_m, {margin_m:g}: a new route would "
                "be blocked at once; raise it."
            )
        if entered_s and entered_m > margin_m:
            raise ConfigError(
                f"entered_m is {entered_m:g}, above margin_m, {margin_m:g}: what is entered "
                "keeps less than what is not; lower it."
            )
        self.check_hz = check_hz
        self.margin_m, self.clearance_m = margin_m, clearance_m
        self.latency_steps = latency_steps
        self.points = points
        limits = (float(spacing_m[0]), float(spacing_m[1]), float(nominal_m))
        turn, entered = (turn_m, lateral_mps2), (entered_s, entered_m)
        room = (ahead_m, margin_m, link_m, *turn, seen_m, unseen_m, edge_m, *entered)
        self.numbers = (*room, max_expansions)
        self.limits = limits
        self.released = rule == "released"
        # numba: once a kernel that calls it is loaded from its cache, a function that gives arrays
        # to Python lacks their type, unless it was loaded before.
        workspace(1, 1)
        released_points(np.zeros((1, 2)), limits)

    def bind(self, context: Context) -> None:
        """Takes the size of a cell, and how many steps there are between two checks."""
        self.resolution_m = context.resolution_m
        self.every = max(1, round(1 / (self.check_hz * context.dt_s)))

    def begin(self, tensors: Mapping[NestedKey, Tensor]) -> Mapping[NestedKey, Tensor]:
        """The given route, with room for longer ones; nothing is on its way."""
        route, length = tensors[keys.ROUTE_W], tensors[keys.ROUTE_LENGTH]
        if route.shape[1] > self.points:
            raise ConfigError(
                f"replanning.points is {self.points}, but the scenes have routes of up to "
                f"{route.shape[1]}; raise it."
            )
        last = (length - 1).clamp(min=0).unsqueeze(-1).expand(-1, 1, 3)
        goal = route.gather(1, last)
        room = torch.cat((route, goal.expand(-1, self.points - route.shape[1], 3)), 1)
        none = torch.zeros_like(length)
        position = tensors[keys.POSITION_W]
        first = {key: tensors[key] for key in (keys.ROUTE_INDEX, keys.CONTROL_POINTS_W)}
        return first | {
            keys.ROUTE_W: room,
            keys.ROUTE_LENGTH: length,
            keys.REPLAN_GOAL_W: goal[:, 0],
            keys.REPLAN_CLEARANCE: self._clearance(tensors),
            keys.PENDING_ROUTE_W: room,
            keys.PENDING_LENGTH: none,
            keys.PENDING_STEPS: none + NONE,
            keys.HOVER_W: position,
            keys.REPLAN_STATUS: none.to(torch.int32),
            keys.REPLANS: none.to(torch.int32),
            keys.REPLAN_MOVED: none > 0,
            keys.REPLAN_OVER: none > 0,
        }

    def _clearance(self, tensors: Mapping[NestedKey, Tensor]) -> Float[Tensor, "n 1"]:
        """What a new route keeps."""
        own = tensors[keys.ROUTE_CLEARANCE]
        if self.clearance_m is not None:
            return torch.full_like(own, self.clearance_m)
        return torch.where(own.isfinite(), own, self.margin_m).clamp(min=self.margin_m)

    def compute(
        self,
        clock: Float[Tensor, "n 1"],
        position: Float[Tensor, "n 3"],
        velocity: Float[Tensor, "n 3"],
        index: Int[Tensor, "n 1"],
        origin: Float[Tensor, "p 2"],
        size: Float[Tensor, "p 2"],
        esdf: Float[Tensor, "n h w"],
        evidence: Int8[Tensor, "n h w"],
        route: Float[Tensor, "n k 3"],
        length: Int[Tensor, "n 1"],
        ahead: Int[Tensor, "n 1"],
        goal: Float[Tensor, "n 3"],
        clearance: Float[Tensor, "n 1"],
        pending: Float[Tensor, "n k 3"],
        pending_length: Int[Tensor, "n 1"],
        steps: Int[Tensor, "n 1"],
        hover: Float[Tensor, "n 3"],
        status: Int[Tensor, "n 1"],
        replans: Int[Tensor, "n 1"],
        done: Bool[Tensor, "n 1"],
        over: Bool[Tensor, "n 1"],
    ) -> tuple[Tensor, ...]:
        first, over = clock == 0, over | done
        due = ((clock % self.every == 0) & (steps < 0) & ~over) | first
        lost = status >= CLOSED_OFF
        found, fresh, count, moved = torch.ops.resc.replan(
            due,
            first | lost,
            index,
            origin,
            size,
            position,
            velocity,
            goal,
            clearance,
            esdf,
            evidence,
            route,
            length,
            ahead,
            [
                float(number)
                for number in (self.resolution_m, *self.numbers, *self.limits, self.released)
            ],
        )
        renewed, closed = found == RENEWED, found >= CLOSED_OFF
        hover = torch.where(closed & ~lost, position, hover)
        held = hover.unsqueeze(1).expand_as(route)
        fresh = torch.where(closed.unsqueeze(-1), held, fresh)
        count = torch.where(closed, 0, count)
        planned = renewed | closed
        pending = torch.where(planned.unsqueeze(-1), fresh, pending)
        pending_length = torch.where(planned, count, pending_length)
        steps = torch.where(planned, torch.where(first, 0, self.latency_steps), steps)
        arrived = steps == 0
        route = torch.where(arrived.unsqueeze(-1), pending, route)
        length = torch.where(arrived, pending_length, length)
        ahead = torch.where(arrived, 0, ahead)
        steps = torch.where(steps >= 0, steps - 1, steps)
        status = torch.where(found >= 0, found.to(torch.int32), status)
        replans = replans + (planned & ~first)
        points = next_two(route, length, ahead)
        moved = moved & renewed
        return (
            *(route, length, ahead, points, pending, pending_length, steps),
            *(hover, status, replans, moved, over),
        )


@torch.library.custom_op("resc::replan", mutates_args=())
def _replan(
    due: Tensor,
    always: Tensor,
    index: Tensor,
    origin: Tensor,
    size: Tensor,
    position: Tensor,
    velocity: Tensor,
    goal: Tensor,
    clearance: Tensor,
    esdf: Tensor,
    evidence: Tensor,
    route: Tensor,
    length: Tensor,
    ahead: Tensor,
    numbers: list[float],
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    n, room, _ = route.shape
    status, counts = np.full(n, -1, np.int64), np.zeros(n, np.int64)
    fresh, moved = np.zeros((n, room, 2)), np.zeros(n, np.bool_)
    columns = [tensor[:, 0] for tensor in (due, always, index)]
    maps = [tensor.double() for tensor in (origin, size)]
    ends = [tensor[:, :2].double() for tensor in (position, velocity, goal)]
    of_route = [route[..., :2].double(), length[:, 0], ahead[:, 0]]
    given = (*columns, *maps, *ends, clearance[:, 0].double(), esdf, evidence, *of_route)
    arrays = [tensor.cpu().contiguous().numpy() for tensor in given]
    *others, expansions, least, most, nominal, released = numbers
    settings = (*others, int(expansions), (least, most, nominal), bool(released))
    share_out(
        replanning_kernels.renew,
        n,
        torch.get_num_threads(),
        *arrays,
        settings,
        status,
        fresh,
        counts,
        moved,
        least=LEAST,
    )
    points = torch.from_numpy(fresh).to(route)
    last = (torch.from_numpy(counts) - 1).clamp(min=0).to(route.device)
    number = torch.arange(room, device=route.device)
    points = points.gather(
        1, torch.minimum(number, last.unsqueeze(-1)).unsqueeze(-1).expand(n, room, 2)
    )
    height = goal[:, None, 2:].expand(n, room, 1)
    told = [torch.from_numpy(values).unsqueeze(-1).to(route.device) for values in (status, counts)]
    flags = torch.from_numpy(moved).unsqueeze(-1).to(route.device)
    return told[0], torch.cat((points, height), -1), told[1], flags


@_replan.register_fake
def _(*given: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    due, route, length = given[0], given[11], given[12]
    whole = torch.empty_like(length)
    return whole, torch.empty_like(route), torch.empty_like(length), torch.empty_like(due)
