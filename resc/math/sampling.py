"""Random generators by seed and name: removing one part does not reshuffle another."""

import hashlib

import torch


def generator_for(seed: int, path: str, device: torch.device | str = "cpu") -> torch.Generator:
    """The generator of the part at configuration path `path`."""
    digest = hashlib.sha256(f"{seed}/{path}".encode()).digest()
    return torch.Generator(device=device).manual_seed(int.from_bytes(digest[:8], "little") >> 1)


def gaussian(unit: torch.Tensor) -> torch.Tensor:
    """Standard normal numbers from uniform float32 numbers in [0, 1), one from each.

    z = sqrt(2) erfinv(2 u - 1), the inverse of the distribution: unlike `randn`, whose bits depend
    on the size of the batch, a row drawn alone is the row drawn among others. u is a multiple of
    2^-24, so half of that moves 2 u - 1 off -1 and makes it symmetric, exactly; |z| < 5.5.
    """
    return 2**0.5 * torch.erfinv(2 * unit - 1 + 2**-24)


def uniform(
    shape: tuple[int, ...], low: float | int, high: float | int, generator: torch.Generator
) -> torch.Tensor:
    """Uniform numbers in [low, high)."""
    return low + (high - low) * torch.rand(shape, generator=generator, device=generator.device)
