"""Behaviour cloning: regression of the expert's actions on the observations."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from clutter_env.learning.demonstrations.episode import Episode
from clutter_env.learning.errors import DatasetError
from clutter_env.learning.policies.features import feature_vector
from clutter_env.learning.policies.policy import Policy
from clutter_env.training.descent import DescentConfig, Report, descend

__all__ = ["CloneConfig", "Examples", "clone", "examples_of"]


@dataclass(frozen=True, eq=False)
class Examples:
    """Pairs of features (k, f) and actions (k, a)."""

    features: NDArray[np.float32]
    actions: NDArray[np.float32]

    def __add__(self, other: Examples) -> Examples:
        return Examples(np.concatenate((self.features, other.features)), np.concatenate((self.actions, other.actions)))

    def __len__(self) -> int:
        return len(self.actions)


@dataclass(frozen=True)
class CloneConfig(DescentConfig):
    """Settings of the regression."""

    steps: int = 10_000
    batch: int = 512


def examples_of(episodes: Iterable[Episode]) -> Examples:
    """All steps of the episodes.

    Raises:
        DatasetError: there are no episodes.
    """
    features, actions = [], []
    for episode in episodes:
        features.append(feature_vector(episode.observations)[:-1])
        actions.append(episode.actions)
    if not actions:
        raise DatasetError("there are no episodes to learn from")
    return Examples(np.concatenate(features), np.concatenate(actions))


def clone(
    examples: Examples,
    config: CloneConfig = CloneConfig(),
    policy: Policy | None = None,
    report: Report = lambda *_: None,
) -> Policy:
    """Fit a policy to examples.

    Args:
        examples: to imitate.
        config: settings.
        policy: is changed; a new one if not given.
        report: called with the step and the loss every 500 steps.
    """
    torch.manual_seed(config.seed)
    features, actions = torch.from_numpy(examples.features), torch.from_numpy(examples.actions)
    fitted = Policy(features.shape[1], actions.shape[1], config.width) if policy is None else policy

    def loss(_: int) -> torch.Tensor:
        """Of a random batch."""
        chosen = torch.randint(len(features), (config.batch,))
        return torch.nn.functional.smooth_l1_loss(fitted(features[chosen]), actions[chosen], beta=0.1)

    descend(torch.optim.Adam(fitted.parameters(), lr=config.learning_rate), config.steps, loss, report)
    return fitted
