"""Action chunking: regression of the next half second, as in ACT (Zhao et al. 2023) without its latent variable.

Zhao, Kumar, Levine & Finn, "Learning fine-grained bimanual manipulation with low-cost hardware", RSS 2023.
"""

from __future__ import annotations

import torch
from torch.nn.functional import l1_loss

from clutter_env.learning.chunking.examples import ROW, STEPS, ChunkExamples
from clutter_env.learning.chunking.network import ScaledChunks
from clutter_env.learning.regression.descent import DescentConfig, Report, descend

__all__ = ["ChunkNetwork", "fit_chunks"]


class ChunkNetwork(ScaledChunks):
    """From the features of a situation to the next steps."""

    def __init__(self, num_features: int, width: int = 256) -> None:
        super().__init__(num_features, width)

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Scaled chunks (k, STEPS, ROW) of features (k, f)."""
        return self.layers(features).reshape(-1, STEPS, ROW)

    def chunk(self, features: torch.Tensor) -> torch.Tensor:
        """The next steps (STEPS, ROW) of one situation (f,)."""
        return self.unscaled(self(features[None])[0])


def fit_chunks(examples: ChunkExamples, config: DescentConfig, report: Report = lambda *_: None) -> ChunkNetwork:
    """A network fitted to examples by the mean absolute error.

    Args:
        examples: to imitate.
        config: settings.
        report: called with the step and the loss every 500 steps.
    """
    torch.manual_seed(config.seed)
    features = torch.tensor(examples.features, dtype=torch.float32)
    network = ChunkNetwork(features.shape[1], config.width)
    wanted = network.scale_to(torch.tensor(examples.chunks, dtype=torch.float32))

    def loss(_: int) -> torch.Tensor:
        """Of a random batch."""
        chosen = torch.randint(len(features), (config.batch,))
        return l1_loss(network(features[chosen]), wanted[chosen])

    descend(torch.optim.Adam(network.parameters(), lr=config.learning_rate), config.steps, loss, report)
    return network
