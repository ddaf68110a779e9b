"""What the two networks that predict chunks share: their layers and the scale of their outputs."""

from __future__ import annotations

import torch
from torch import nn

from clutter_env.learning.chunking.examples import ROW, STEPS
from clutter_env.learning.regression.perceptron import perceptron

__all__ = ["SIZE", "ScaledChunks"]

SIZE = STEPS * ROW
"""Numbers in a chunk."""
_LEAST_SPREAD = 1e-2
"""Added to the spread of the data, so that numbers that never change are not divided by zero."""


class ScaledChunks(nn.Module):
    """A network whose output is a chunk in units of the data's spread.

    Attributes:
        mean, spread: (STEPS, ROW) of the chunks in the data.
    """

    mean: torch.Tensor
    spread: torch.Tensor

    def __init__(self, num_inputs: int, width: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(STEPS, ROW))
        self.register_buffer("spread", torch.ones(STEPS, ROW))
        self.layers = perceptron(num_inputs, width, SIZE)

    def scale_to(self, chunks: torch.Tensor) -> torch.Tensor:
        """Take the scale from chunks (k, STEPS, ROW); they are returned scaled."""
        self.mean[:], self.spread[:] = chunks.mean(0), chunks.std(0) + _LEAST_SPREAD
        return (chunks - self.mean) / self.spread

    def unscaled(self, chunk: torch.Tensor) -> torch.Tensor:
        """A scaled chunk (STEPS, ROW) in its own units."""
        return self.mean + self.spread * chunk
