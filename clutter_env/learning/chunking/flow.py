"""Flow matching: the next half second is drawn from a learned distribution, as in π0 (Black et al. 2024).

Lipman, Chen, Ben-Hamu, Nickel & Le, "Flow matching for generative modeling", ICLR 2023: a network learns the velocity
that carries noise to data along straight lines; integrating it from noise gives a sample.
"""

from __future__ import annotations

import torch
from torch.nn.functional import mse_loss

from clutter_env.learning.chunking.examples import ROW, STEPS, ChunkExamples
from clutter_env.learning.chunking.network import SIZE, ScaledChunks
from clutter_env.learning.regression.descent import DescentConfig, Report, descend

__all__ = ["FlowNetwork", "fit_flow"]

_INTEGRATION_STEPS = 8
"""Steps from noise to a sample."""


class FlowNetwork(ScaledChunks):
    """The velocity of a chunk on its way from noise to data, given the situation."""

    OWN_INPUTS = SIZE + 1
    """Inputs besides the features: the chunk, and how far on its way it is."""

    def __init__(self, num_features: int, width: int = 256) -> None:
        super().__init__(num_features + self.OWN_INPUTS, width)

    def forward(self, features: torch.Tensor, chunk: torch.Tensor, time: torch.Tensor) -> torch.Tensor:
        """Velocities (k, n) at features (k, f), flat scaled chunks (k, n) and times (k, 1): 0 noise, 1 data."""
        return self.layers(torch.cat((features, chunk, time), dim=1))

    def chunk(self, features: torch.Tensor) -> torch.Tensor:
        """The next steps (STEPS, ROW) of one situation (f,): the sample to which zero noise leads."""
        chunk = torch.zeros(1, SIZE)
        for step in range(_INTEGRATION_STEPS):
            time = torch.full((1, 1), step / _INTEGRATION_STEPS)
            chunk = chunk + self(features[None], chunk, time) / _INTEGRATION_STEPS
        return self.unscaled(chunk.reshape(STEPS, ROW))


def fit_flow(examples: ChunkExamples, config: DescentConfig, report: Report = lambda *_: None) -> FlowNetwork:
    """A network fitted to examples by conditional flow matching.

    Args:
        examples: to imitate.
        config: settings.
        report: called with the step and the loss every 500 steps.
    """
    torch.manual_seed(config.seed)
    features = torch.tensor(examples.features, dtype=torch.float32)
    network = FlowNetwork(features.shape[1], config.width)
    data = network.scale_to(torch.tensor(examples.chunks, dtype=torch.float32)).flatten(1)

    def loss(_: int) -> torch.Tensor:
        """Of a random batch, at random points of the way from noise to data."""
        chosen = torch.randint(len(features), (config.batch,))
        noise, time = torch.randn(config.batch, SIZE), torch.rand(config.batch, 1)
        between = (1 - time) * noise + time * data[chosen]
        return mse_loss(network(features[chosen], between, time), data[chosen] - noise)

    descend(torch.optim.Adam(network.parameters(), lr=config.learning_rate), config.steps, loss, report)
    return network
