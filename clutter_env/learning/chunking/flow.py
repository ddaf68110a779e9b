"""Flow matching: the next half second is drawn from a learned distribution, as in π0 (Black et al. 2024).

Lipman, Chen, Ben-Hamu, Nickel & Le, "Flow matching for generative modeling", ICLR 2023: a network learns the velocity
that carries noise to data along straight lines; integrating it from noise gives a sample.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import nn

from clutter_env.learning.chunking.examples import ROW, STEPS, ChunkExamples

__all__ = ["FlowConfig", "FlowNetwork", "fit_flow"]

_SIZE = STEPS * ROW
_INTEGRATION_STEPS = 8
"""Steps from noise to a sample."""


@dataclass(frozen=True)
class FlowConfig:
    """Settings of the regression.

    Attributes:
        steps: gradient steps.
        batch: examples in each step.
        learning_rate: the first one; it falls to zero along a cosine.
        width: of the hidden layers.
        seed: random seed.
    """

    steps: int = 6000
    batch: int = 256
    learning_rate: float = 1e-3
    width: int = 256
    seed: int = 0


class FlowNetwork(nn.Module):
    """The velocity of a chunk on its way from noise to data, given the situation."""

    OWN_INPUTS = _SIZE + 1
    """Inputs besides the features: the chunk, and how far on its way it is."""

    mean: torch.Tensor
    spread: torch.Tensor

    def __init__(self, num_features: int, width: int = 256) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(STEPS, ROW))
        self.register_buffer("spread", torch.ones(STEPS, ROW))
        self.layers = nn.Sequential(
            nn.Linear(num_features + self.OWN_INPUTS, width),
            nn.SiLU(),
            nn.Linear(width, width),
            nn.SiLU(),
            nn.Linear(width, width),
            nn.SiLU(),
            nn.Linear(width, _SIZE),
        )

    def forward(self, features: torch.Tensor, chunk: torch.Tensor, time: torch.Tensor) -> torch.Tensor:
        """Velocities (k, n) at features (k, f), flat scaled chunks (k, n) and times (k, 1): 0 noise, 1 data."""
        return self.layers(torch.cat((features, chunk, time), dim=1))

    def chunk(self, features: torch.Tensor) -> torch.Tensor:
        """The next steps (STEPS, ROW) of one situation (f,): the sample to which zero noise leads."""
        chunk = torch.zeros(1, _SIZE)
        for step in range(_INTEGRATION_STEPS):
            time = torch.full((1, 1), step / _INTEGRATION_STEPS)
            chunk = chunk + self(features[None], chunk, time) / _INTEGRATION_STEPS
        return self.mean + self.spread * chunk.reshape(STEPS, ROW)


def fit_flow(
    examples: ChunkExamples,
    config: FlowConfig = FlowConfig(),
    report: Callable[[int, float], None] = lambda *_: None,
) -> FlowNetwork:
    """A network fitted to examples by conditional flow matching.

    Args:
        examples: to imitate.
        config: settings.
        report: called with the step and the loss every 500 steps.
    """
    torch.manual_seed(config.seed)
    features = torch.tensor(examples.features, dtype=torch.float32)
    chunks = torch.tensor(examples.chunks, dtype=torch.float32)
    network = FlowNetwork(features.shape[1], config.width)
    network.mean[:], network.spread[:] = chunks.mean(0), chunks.std(0) + 1e-2
    data = ((chunks - network.mean) / network.spread).reshape(len(chunks), _SIZE)
    optimiser = torch.optim.Adam(network.parameters(), lr=config.learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, config.steps)
    for step in range(config.steps):
        chosen = torch.randint(len(features), (config.batch,))
        noise, time = torch.randn(config.batch, _SIZE), torch.rand(config.batch, 1)
        between = (1 - time) * noise + time * data[chosen]
        velocity = network(features[chosen], between, time)
        loss = nn.functional.mse_loss(velocity, data[chosen] - noise)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        if step % 500 == 0 or step == config.steps - 1:
            report(step, loss.item())
    return network
