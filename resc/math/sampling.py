"""Random generators by seed and name: removing one part does not reshuffle another."""

import hashlib
import numbers

import torch

from resc.errors import ConfigError

# fmt: off
ERFINV_CENTRE = (
    2.81022636e-08, 3.43273939e-07, -3.5233877e-06, -4.39150654e-06, 0.00021858087,
    -0.00125372503, -0.00417768164, 0.246640727, 1.50140941,
)
ERFINV_TAIL = (
    -0.000200214257, 0.000100950558, 0.00134934322, -0.00367342844, 0.00573950773,
    -0.0076224613, 0.00943887047, 1.00167406, 2.83297682,
)
# fmt: on


def generator_for(seed: int, path: str, device: torch.device | str = "cpu") -> torch.Generator:
    """The generator of the part at configuration path `path`.

    Raises:
        ConfigError: The seed is no whole number from 0 to 2^63 - 1.
    """
    require_seed(seed)
    digest = hashlib.sha256(f"{seed}/{path}".encode()).digest()
    return torch.Generator(device=device).manual_seed(int.from_bytes(digest[:8], "little") >> 1)


def require_seed(seed: int) -> None:
    """Raises ConfigError for what some of the generators behind a run would not take."""
    whole = isinstance(seed, numbers.Integral) and not isinstance(seed, bool)
    if not whole or not 0 <= seed < 2**63:
        raise ConfigError(f"seed is {seed!r}; expected a whole number from 0 to 2^63 - 1.")


def gaussian(unit: torch.Tensor) -> torch.Tensor:
    """Standard normal numbers from uniform float32 numbers in [0, 1), one from each.

    z = sqrt(2) erfinv(x), x = 2 u - 1, the inverse of the distribution: unlike `randn`, whose bits
    depend on the size of the batch, a row drawn alone is the row drawn among others. u is a
    multiple of 2^-24, so half of that moves x off -1 and makes it symmetric, exactly; |z| < 5.5.

    erfinv by two polynomials in w = -log(1 - x^2), exact to 1e-6: they vectorise when compiled,
    which makes them 16 times faster than `torch.erfinv` there.
    Source: Giles, Approximating the erfinv function, GPU Computing Gems (2011), single precision.
    """
    x = 2 * unit - 1 + 2**-24
    w = -torch.log((1 - x) * (1 + x))
    centre, tail = _polynomial(w - 2.5, ERFINV_CENTRE), _polynomial(w.sqrt() - 3, ERFINV_TAIL)
    return 2**0.5 * x * torch.where(w < 5, centre, tail)


def _polynomial(x: torch.Tensor, coefficients: tuple[float, ...]) -> torch.Tensor:
    """The polynomial with these coefficients, highest power first, by Horner's rule."""
    value = torch.full_like(x, coefficients[0])
    for coefficient in coefficients[1:]:
        value = value * x + coefficient
    return value


def uniform(
    shape: tuple[int, ...], low: float | int, high: float | int, generator: torch.Generator
) -> torch.Tensor:
    """Uniform numbers in [low, high)."""
    return low + (high - low) * torch.rand(shape, generator=generator, device=generator.device)
