"""The same function over and over, compiled once."""

from collections.abc import Callable

import torch
from torch import Tensor
from torch._higher_order_ops.while_loop import while_loop

State = tuple[Tensor, ...]


def repeated(advance: Callable[[State], State], state: State, times: int) -> State:
    """The state after `advance`, which must give new tensors of the same shapes, so many times.

    Unrolled, a compiler would see as many copies; here it compiles one, unless gradients are
    wanted, which do not pass through its loop.
    """
    if torch.compiler.is_compiling() and not torch.is_grad_enabled():

        def again(count: Tensor, *now: Tensor) -> tuple[Tensor, ...]:
            return count + 1, *advance(now)

        start = (torch.zeros((), dtype=torch.int64), *state)
        _, *after = while_loop(lambda count, *_: count < times, again, start)
        return tuple(after)
    for _ in range(times):
        state = advance(state)
    return state
