"""Critics that know the price of motion."""

from __future__ import annotations

from typing import Any

import torch
from torch import nn

from clutter_env.learning.policies.critics import NormalisedSACPolicy, NormalisedTQCPolicy
from clutter_env.learning.policies.priced import MOTION_PRICE

__all__ = ["PricedSACPolicy", "PricedTQCPolicy"]


class _PricedCritics:
    """Takes the price of motion off what the critics' networks say, so that these need not learn it.

    The price is a function of the action alone. A hundredth of the critics' values, it would be lost in the errors of
    networks that learned it, and the actor would follow the errors in every direction that hardly moves the gripper.
    """

    def make_critic(self, features_extractor: Any = None) -> Any:
        """The critics."""
        critic = super().make_critic(features_extractor)  # type: ignore[misc]  # a mixin: the class beside it has it
        for index, network in enumerate(critic.q_networks):
            critic.q_networks[index] = _Priced(network, critic.action_space.shape[0])
            critic.add_module(f"qf{index}", critic.q_networks[index])
        return critic


class PricedSACPolicy(_PricedCritics, NormalisedSACPolicy):
    """The policy of SAC."""


class PricedTQCPolicy(_PricedCritics, NormalisedTQCPolicy):
    """The policy of TQC."""


class _Priced(nn.Module):
    """A network less the price of the action, with which its input ends."""

    def __init__(self, network: nn.Module, num_actions: int) -> None:
        super().__init__()
        self.network, self._num_actions = network, num_actions

    def forward(self, state_and_action: torch.Tensor) -> torch.Tensor:
        """Values (k, n) of states and actions (k, f + a)."""
        values: torch.Tensor = self.network(state_and_action)
        action = state_and_action[:, -self._num_actions :]
        return values - MOTION_PRICE * action.square().mean(dim=1, keepdim=True)
