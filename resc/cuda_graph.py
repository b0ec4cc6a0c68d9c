"""Functions of tensors as CUDA graphs: launched whole, without Python between their kernels."""

from collections.abc import Callable, Iterable
from typing import Generic, TypeVar

import torch
from torch import Tensor

WARM_UP = 3
"""Calls before the capture: by then all is compiled, and libraries have their memory."""


Returned = TypeVar("Returned")


class CudaGraph(Generic[Returned]):
    """A function of tensors, captured at its fourth call and replayed at every later one.

    Arguments are copied to where they were at the capture, so each must keep its shape. What else
    the function uses must stay where it is in memory; what it returns is written over by the next
    call. It must not ask a tensor for a number, nor draw any.

    Args:
        function: What is captured; each call has its full effect, the first ones too.
    """

    def __init__(self, function: Callable[..., Returned]) -> None:
        self.function = function
        self.calls = 0
        self._given: list[Tensor] = []
        self._captured: tuple[torch.cuda.CUDAGraph, Returned] | None = None

    def __call__(self, *given: Tensor) -> Returned:
        """What the function returns."""
        self.calls += 1
        if self.calls <= WARM_UP:
            return self.function(*given)
        if self._captured is None:
            self._captured = self._capture(given)
        elif given:
            copy_each(given, self._given)
        graph, returned = self._captured
        graph.replay()
        return returned

    def _capture(self, given: tuple[Tensor, ...]) -> tuple[torch.cuda.CUDAGraph, Returned]:
        """Records what the function launches, which does not run until it is replayed."""
        self._given = [tensor.clone() for tensor in given]
        graph = torch.cuda.CUDAGraph()
        # thread_local: the recorder's thread may wait for its copies meanwhile.
        with torch.cuda.graph(graph, capture_error_mode="thread_local"):
            returned = self.function(*self._given)
        return graph, returned


def copy_each(values: Iterable[Tensor], there: Iterable[Tensor]) -> None:
    """Copies tensors to others, in one call: on a GPU, in few launches."""
    torch._foreach_copy_([*there], [*values])  # pyright: ignore[reportPrivateImportUsage]
