"""Action chunking: regression of the next half second, as in ACT (Zhao et al. 2023) without its latent variable.

Zhao, Kumar, Levine & Finn, "Learning fine-grained bimanual manipulation with low-cost hardware", RSS 2023.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import nn

from clutter_env.learning.chunking.examples import ROW, STEPS, ChunkExamples

__all__ = ["ChunkConfig", "ChunkNetwork", "fit_chunks"]


@dataclass(frozen=True)
class ChunkConfig:
    """Settings of the regression.

    Attributes:
        steps: gradient steps.
        batch: examples in each step.
        learning_rate: the first one; it falls to zero along a cosine.
        width: of the hidden layers.
        seed: random seed.
    """

    steps: int = 4000
    batch: int = 256
    learning_rate: float = 1e-3
    width: int = 256
    seed: int = 0


class ChunkNetwork(nn.Module):
    """From the features of a situation to the next steps; outputs are scaled by their spread in the data."""

    mean: torch.Tensor
    spread: torch.Tensor

    def __init__(self, num_features: int, width: int = 256) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(STEPS, ROW))
        self.register_buffer("spread", torch.ones(STEPS, ROW))
        self.layers = nn.Sequential(
            nn.Linear(num_features, width),
            nn.SiLU(),
            nn.Linear(width, width),
            nn.SiLU(),
            nn.Linear(width, width),
            nn.SiLU(),
            nn.Linear(width, STEPS * ROW),
        )

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Scaled chunks (k, STEPS, ROW) of features (k, f)."""
        return self.layers(features).reshape(-1, STEPS, ROW)

    def chunk(self, features: torch.Tensor) -> torch.Tensor:
        """The next steps (STEPS, ROW) of one situation (f,)."""
        return self.mean + self.spread * self(features[None])[0]


def fit_chunks(
    examples: ChunkExamples,
    config: ChunkConfig = ChunkConfig(),
    report: Callable[[int, float], None] = lambda *_: None,
) -> ChunkNetwork:
    """A network fitted to examples by the mean absolute error.

    Args:
        examples: to imitate.
        config: settings.
        report: called with the step and the loss every 500 steps.
    """
    torch.manual_seed(config.seed)
    features = torch.tensor(examples.features, dtype=torch.float32)
    chunks = torch.tensor(examples.chunks, dtype=torch.float32)
    network = ChunkNetwork(features.shape[1], config.width)
    network.mean[:], network.spread[:] = chunks.mean(0), chunks.std(0) + 1e-2
    wanted = (chunks - network.mean) / network.spread
    optimiser = torch.optim.Adam(network.parameters(), lr=config.learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, config.steps)
    for step in range(config.steps):
        chosen = torch.randint(len(features), (config.batch,))
        loss = nn.functional.l1_loss(network(features[chosen]), wanted[chosen])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        if step % 500 == 0 or step == config.steps - 1:
            report(step, loss.item())
    return network
