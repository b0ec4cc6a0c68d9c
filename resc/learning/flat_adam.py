"""Adam for weights that lie side by side in memory.

A step on each of a dozen small tensors costs more than its arithmetic: after the gradients of a
minibatch, most of what Python and torch run for it has left the processor's caches.
"""

from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.optim.adam import adam

ALIGNED = 16
"""Every weight begins at a multiple of so many numbers, a line of the cache."""


def side_by_side(parts: Sequence[Float[Tensor, "..."]]) -> Float[Tensor, " w"]:
    """Tensors in one row, with zeros between them, so that each is aligned."""
    flat = [part.reshape(-1) for part in parts]
    padded = [(part, part.new_zeros(-part.numel() % ALIGNED)) for part in flat]
    return torch.cat([piece for pair in padded for piece in pair])


class FlatAdam:
    """Adam (Kingma and Ba 2015), and the clip of the gradient's norm before it.

    Args:
        weights: Of one kind and device; from here on they are views of one tensor.
        max_norm: Longest gradient; one that is longer is shortened to it.
        epsilon: Added to the root of the mean square.
        betas: Of the running means of the gradient and of its square.
    """

    def __init__(
        self,
        weights: Sequence[nn.Parameter],
        max_norm: float,
        epsilon: float,
        betas: tuple[float, float] = (0.9, 0.999),
    ) -> None:
        self.max_norm, self.epsilon, self.betas = max_norm, epsilon, betas
        with torch.no_grad():
            self.values = side_by_side(list(weights))
        self.mean, self.square = torch.zeros_like(self.values), torch.zeros_like(self.values)
        self.steps = torch.zeros((), device=self.values.device)
        at = 0
        for weight in weights:
            weight.data = self.values[at : at + weight.numel()].view_as(weight)
            at += weight.numel() + -weight.numel() % ALIGNED

    @torch.no_grad()
    def step(self, gradient: Float[Tensor, " w"], rate: float) -> None:
        """Moves the weights along a gradient that is `side_by_side`, and spends it."""
        norm = torch.linalg.vector_norm(gradient)
        too_long = ((norm + 1e-6) / self.max_norm).clamp_(min=1.0)
        adam(
            [self.values],
            [gradient],
            [self.mean],
            [self.square],
            [],
            [self.steps],
            fused=True,
            grad_scale=too_long,
            amsgrad=False,
            beta1=self.betas[0],
            beta2=self.betas[1],
            lr=rate,
            weight_decay=0.0,
            eps=self.epsilon,
            maximize=False,
        )

    def state_dict(self) -> dict[str, Any]:
        """Running means and the number of steps."""
        return {"mean": self.mean, "square": self.square, "steps": self.steps}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Takes what `state_dict` gave, or what that of torch's Adam gave for the same weights."""
        if "param_groups" in state:
            own = [part for _, part in sorted(state["state"].items())]
            state = {
                "mean": side_by_side([part["exp_avg"] for part in own]),
                "square": side_by_side([part["exp_avg_sq"] for part in own]),
                "steps": own[0]["step"],
            }
        for name, value in self.state_dict().items():
            value.copy_(state[name])
