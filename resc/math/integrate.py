"""Fixed-step integration of ordinary differential equations on tuples of tensors."""

from collections.abc import Callable

from torch import Tensor

State = tuple[Tensor, ...]


def rk4(derivative: Callable[[State], State], state: State, step_s: float) -> State:
    """The state after `step_s` by the classical Runge-Kutta method (order 4, four evaluations)."""
    k1 = derivative(state)
    k2 = derivative(_along(state, k1, 0.5 * step_s))
    k3 = derivative(_along(state, k2, 0.5 * step_s))
    k4 = derivative(_along(state, k3, step_s))
    return tuple(
        x + step_s / 6 * (a + 2 * b + 2 * c + d)
        for x, a, b, c, d in zip(state, k1, k2, k3, k4, strict=True)
    )


def _along(state: State, slope: State, step_s: float) -> State:
    return tuple(x + step_s * dx for x, dx in zip(state, slope, strict=True))
