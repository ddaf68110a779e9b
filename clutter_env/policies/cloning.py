"""Cloned policies: a network from features of the observation to an action in [-1, 1]."""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from clutter_env.errors import DatasetError
from clutter_env.policies.features import feature_vector
from clutter_env.reporting.files import write_atomically

POLICY_FILE = "policy.pt"


class ClonedPolicy(nn.Module):
    """Three linear layers from features to an action, which tanh squashes into [-1, 1].

    The features are not normalised. Division by their standard deviation in the data enlarges features that hardly vary
    there, so that they dominate the others when they do vary: clones of `Pick` then succeed less often.
    """

    def __init__(self, num_features: int, num_actions: int, width: int = 256) -> None:
        super().__init__()
        self.shape = (num_features, num_actions, width)
        self.layers = nn.Sequential(
            nn.Linear(num_features, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, num_actions)
        )

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Actions (k, a) of features (k, f)."""
        return torch.tanh(self.layers(features))

    def reset(self, info: Mapping[str, Any]) -> None:
        """Start an episode; nothing is remembered of the last one."""

    def act(self, observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
        """The action (a,) for one observation."""
        with torch.no_grad():
            action = self(torch.from_numpy(feature_vector(observation)))
        return np.asarray(action.numpy(), np.float32)

    def save(self, path: Path, provenance: Mapping[str, Any] | None = None) -> None:
        """Write shape, weights and what they were made with; the file is complete, or the old one stays.

        Raises:
            OSError: the disk is full or cannot be written.
        """
        content = BytesIO()  # torch itself would raise a RuntimeError when the disk is full
        torch.save({"shape": self.shape, "weights": self.state_dict(), "provenance": dict(provenance or {})}, content)
        write_atomically(path, content.getvalue())

    @classmethod
    def load(cls, path: Path) -> ClonedPolicy:
        """The policy that `save` wrote.

        Raises:
            DatasetError: there is no such file, it is damaged, or it holds something else.
        """
        if not path.exists():
            raise DatasetError(f"there is no policy at {path}")
        try:
            content = torch.load(path, weights_only=True)
            policy = cls(*content["shape"])
            policy.load_state_dict(content["weights"])
        except Exception as problem:  # torch raises many kinds for a damaged file: pickle's, zip's, its own
            raise DatasetError(f"{path} holds no cloned policy, or it is damaged: {problem}") from problem
        return policy
