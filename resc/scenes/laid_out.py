"""Scenes that were laid out before, for a pool that flies just these."""

import torch

from resc.scenes.layout import Layout


class LaidOut:
    """A scene that is laid out already: hands its layout to the pool."""

    def __init__(self, layout: Layout) -> None:
        self.layout = layout

    def sample(self, count: int, generator: torch.Generator) -> Layout:
        """The layout, all of it; nothing is drawn."""
        assert count == len(self.layout), f"{count} of {len(self.layout)} scenes wanted"
        return self.layout
