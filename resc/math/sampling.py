"""Random generators by seed and name: removing one part does not reshuffle another."""

import hashlib

import torch


def generator_for(seed: int, path: str, device: torch.device | str = "cpu") -> torch.Generator:
    """The generator of the part at configuration path `path`."""
    digest = hashlib.sha256(f"{seed}/{path}".encode()).digest()
    return torch.Generator(device=device).manual_seed(int.from_bytes(digest[:8], "little") >> 1)


def uniform(
    shape: tuple[int, ...], low: float | int, high: float | int, generator: torch.Generator
) -> torch.Tensor:
    """Uniform numbers in [low, high)."""
    return low + (high - low) * torch.rand(shape, generator=generator, device=generator.device)
