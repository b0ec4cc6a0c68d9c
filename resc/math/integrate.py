"""Fixed-step integration of ordinary differential equations on tuples of tensors."""

from collections.abc import Callable

from torch import Tensor

State = tuple[Tensor, ...]


def rk4(derivative: Callable[[State], State], state: State, step_s: float) -> State:
    """The state after `step_s` by the classical Runge-Kutta method (order 4, four evaluations)."""

    def along(slope: State, share: float) -> State:
        return tuple(x + share * step_s * dx for x, dx in zip(state, slope, strict=True))

    k1 = derivative(state)
    k2 = derivative(along(k1, 0.5))
    k3 = derivative(along(k2, 0.5))
    k4 = derivative(along(k3, 1.0))
    return tuple(
        x + step_s / 6 * (a + 2 * b + 2 * c + d)
        for x, a, b, c, d in zip(state, k1, k2, k3, k4, strict=True)
    )
