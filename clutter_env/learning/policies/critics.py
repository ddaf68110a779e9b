"""Critics with layer normalisation, which keeps their values bounded where there are no data."""

from __future__ import annotations

from typing import Any

from sb3_contrib.tqc.policies import TQCPolicy
from stable_baselines3.sac.policies import SACPolicy
from torch import nn

__all__ = ["NormalisedSACPolicy", "NormalisedTQCPolicy"]


class _NormalisedCritics:
    """Puts a layer normalisation before every activation of the critics (Ball et al. 2023, RLPD)."""

    def make_critic(self, features_extractor: Any = None) -> Any:
        """The critics."""
        critic = super().make_critic(features_extractor)  # type: ignore[misc]  # a mixin: the class beside it has it
        for index, network in enumerate(critic.q_networks):
            critic.q_networks[index] = _normalised(network)
            critic.add_module(f"qf{index}", critic.q_networks[index])
        return critic


class NormalisedSACPolicy(_NormalisedCritics, SACPolicy):
    """The policy of SAC."""


class NormalisedTQCPolicy(_NormalisedCritics, TQCPolicy):
    """The policy of TQC."""


def _normalised(network: nn.Sequential) -> nn.Sequential:
    layers: list[nn.Module] = []
    width = 0
    for layer in network:
        if isinstance(layer, nn.Linear):
            width = layer.out_features
        else:
            layers.append(nn.LayerNorm(width))
        layers.append(layer)
    return nn.Sequential(*layers)
