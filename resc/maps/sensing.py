"""What all ways of sensing the map share: the keys they read and write, their rate, evidence."""

import math
from collections.abc import Mapping
from typing import Annotated, TypedDict

import torch
from jaxtyping import Bool, Float, Int, Int64
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.keys import NestedKey
from resc.maps.constants import TRUNCATION_M
from resc.maps.known_map import UNKNOWN, Beams, Evidence, scan
from resc.maps.movers import outlines
from resc.maps.observation import MAP_KEYS
from resc.math import stream
from resc.quantities import NotNegative, Positive, Within
from resc.term import Context, Sensing

Tenths = Annotated[int, Within(-127, 127)]
"""A whole number of tenths of log odds."""


class SensingOptions(TypedDict, total=False):
    """The arguments of `MapSensing`, which a sensing with its own takes as `**options`."""

    rate_hz: Positive
    round_m: NotNegative
    hit: Tenths
    miss: Tenths
    least: Tenths
    most: Tenths
    occupied: Tenths
    fade: Annotated[int, Within(0, 127)]


class MapSensing(Sensing):
    """Keeps the map that each vehicle knows, and adds what it sees `rate_hz` times a second.

    The numbers of the evidence are tenths of log odds. By default one hit makes a cell occupied. In
    the released mapping (facts 10) a hit adds 6, so that it takes three: at 10 Hz and 3 m/s that is
    up to 0.9 m of flight.

    A vehicle has looked round before its episode begins: what is in sight within `round_m` is
    known without errors. One that knew nothing would fly its first metres into the unseen.

    Args:
        rate_hz: Scans per second, at most one for each control step.
        round_m: How far it has looked round; 0 for not at all.
        hit: Added to the evidence of a cell where a beam ends.
        miss: Added where beams pass; below zero.
        least: Greatest certainty that a cell is free.
        most: Greatest certainty that it is occupied.
        occupied: From here on a cell counts as occupied.
        fade: Taken at each scan from the evidence of an occupied cell that it does not see, until
            none is left: where obstacles move, what was seen long ago is no longer there.
    """

    reads = (
        keys.CLOCK,
        keys.POSITION_W,
        keys.ATTITUDE_WB,
        *MAP_KEYS,
        keys.MOVERS_W,
        keys.KNOWN_EVIDENCE,
        keys.KNOWN_ESDF,
    )
    writes: tuple[NestedKey, ...] = keys.KNOWN_MAP

    def __init__(
        self,
        *,
        rate_hz: Positive = 10.0,
        round_m: NotNegative = 5.0,
        hit: Tenths = 16,
        miss: Tenths = -6,
        least: Tenths = -20,
        most: Tenths = 22,
        occupied: Tenths = 14,
        fade: Annotated[int, Within(0, 127)] = 0,
    ) -> None:
        super().__init__()
        if not (hit > 0 > miss and least < 0 < occupied <= most):
            raise ConfigError(
                f"hit, miss, least, most and occupied are {hit}, {miss}, {least}, {most} and "
                f"{occupied}; expected hit > 0 > miss, and least < 0 < occupied <= most."
            )
        self.rate_hz = rate_hz
        self.round_m = round_m
        self.evidence = Evidence(hit, miss, least, most, occupied, fade)

    def bind(self, context: Context) -> None:
        """Takes the control period and the size of a cell."""
        self.resolution_m, self.dt_s = context.resolution_m, context.dt_s
        self.per_step = self.rate_hz * context.dt_s
        if self.per_step > 1 + 1e-6:
            raise ConfigError(
                f"rate_hz is {self.rate_hz:g}, but there are {1 / context.dt_s:g} control steps a "
                "second, each with one scan at most; lower it."
            )

    def begin(self, tensors: Mapping[NestedKey, Tensor]) -> Mapping[NestedKey, Tensor]:
        """What is in sight all round is known."""
        like = tensors[keys.POSITION_W]
        shape = len(like), *tensors[keys.ESDF].shape[1:]
        evidence = like.new_full(shape, UNKNOWN, dtype=torch.int8)
        esdf = like.new_full(shape, TRUNCATION_M)
        if self.round_m:
            count = math.ceil(2 * math.pi * self.round_m / self.resolution_m)
            angle = torch.arange(count, device=like.device) * (2 * math.pi / count)
            around = torch.stack((angle.cos(), angle.sin()), -1).expand(len(like), -1, -1)
            none = torch.zeros_like(around[..., 0])
            beams = Beams(like[:, :2], around, none + self.round_m, none, none)
            index, truth, origin, size = (tensors[key] for key in MAP_KEYS)
            field = (index, truth, origin, size)
            every = torch.ones_like(like[:, :1], dtype=torch.bool)
            moving = self.moving(tensors[keys.CLOCK], index, tensors[keys.MOVERS_W])
            settings = (self.evidence, self.resolution_m, moving)
            scan(field, beams, every, evidence, esdf, *settings)
        return {keys.KNOWN_EVIDENCE: evidence, keys.KNOWN_ESDF: esdf}

    def moving(
        self,
        clock: Float[Tensor, "n 1"],
        index: Int[Tensor, "n 1"],
        movers: Float[Tensor, "p o 10"],
    ) -> Float[Tensor, "n o 4"] | None:
        """Where the movers of each row are now; None where scenes have none."""
        return outlines(movers[index[:, 0]], clock * self.dt_s) if movers.shape[1] else None

    def due(self, clock: Float[Tensor, "n 1"]) -> Bool[Tensor, "n 1"]:
        """Whether a scan is due: one is in the first step."""
        late = 1e-3  # step * per_step is rounded
        now, before = clock * self.per_step + late, (clock - 1) * self.per_step + late
        return (now.floor() > before.floor()) | (clock == 0)


class NoisySensing(MapSensing):
    """A sensing with noise, which comes from the state: a replay sees what was seen.

    The sequence of an episode begins with two uniform numbers, drawn with its first look.
    """

    step_draws = 2
    reads = (*MapSensing.reads, keys.SENSING_STREAM)
    writes = (*keys.KNOWN_MAP, keys.SENSING_STREAM)
    number: Tensor

    def count(self, beams: int) -> None:
        """Numbers the beams of a scan."""
        self.register_buffer("number", torch.arange(beams), persistent=False)

    def places(self, place: Int64[Tensor, "n 1"], which: int) -> Int64[Tensor, "n b"]:
        """Where random number `which`, 0 or 1, of each beam stands: sequences of their own."""
        return (place + (2 * self.number + which) * 0x9E3779B1) & stream.WORD

    def begin(self, tensors: Mapping[NestedKey, Tensor]) -> Mapping[NestedKey, Tensor]:
        """What is in sight all round is known; the sequence begins with the first look."""
        none = torch.zeros_like(tensors[keys.SCENE_INDEX])
        return {**super().begin(tensors), keys.SENSING_STREAM: none}

    def moved_on(
        self, clock: Float[Tensor, "n 1"], place: Int64[Tensor, "n 1"], unit: Float[Tensor, "n 2"]
    ) -> Int64[Tensor, "n 1"]:
        """Where the sequence stands in this step."""
        return torch.where(clock == 0, stream.first(unit), stream.following(place))
