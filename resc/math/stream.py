"""Random sequences that each row of a batch carries along, as part of its state."""

import torch
from jaxtyping import Float, Int64
from torch import Tensor

WORD = 0xFFFFFFFF


def first(unit: Float[Tensor, "n d"]) -> Int64[Tensor, "n _"]:
    """Where sequences begin, from two uniform numbers in [0, 1) for each."""
    high, low = unit.chunk(2, -1)
    return (high * 2**24).long() * 2**8 + (low * 2**8).long()


def units(place: Int64[Tensor, "n d"]) -> Float[Tensor, "n _"]:
    """Uniform numbers with which sequences begin there, the inverse of `first`."""
    high, low = place >> 8, place & 0xFF
    return torch.cat((high * 2.0**-24, low * 2.0**-8), -1)


def following(place: Int64[Tensor, "n d"]) -> Int64[Tensor, "n d"]:
    """The next place of each sequence: a linear congruential generator of 32 bits."""
    return (place * 1664525 + 1013904223) & WORD


def uniform(place: Int64[Tensor, "n d"]) -> Float[Tensor, "n d"]:
    """The uniform number in [0, 1) at a place, a multiple of 2^-24.

    The permutation RXS-M-XS, without which low bits would repeat soon and neighbouring places would
    give similar numbers. Source: O'Neill, PCG, Harvey Mudd College HMC-CS-2014-0905.
    """
    word = ((place >> ((place >> 28) + 4)) ^ place) * 277803737 & WORD
    return (((word >> 22) ^ word) >> 8).to(torch.float32) * 2.0**-24
