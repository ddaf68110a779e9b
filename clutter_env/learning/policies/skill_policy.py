"""Policies for `Skill` in Stable-Baselines3 that choose as `SkillNetwork` says."""

from __future__ import annotations

from typing import Any

from sb3_contrib.common.maskable.policies import MaskableActorCriticPolicy
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import nn

from clutter_env.policies.skill_network import SkillNetwork
from planners import DIRECTIONS

__all__ = ["MaskableSkillPolicy", "SkillPolicy"]


class _SkillPolicyMixin:
    """Replaces the separate networks of Stable-Baselines3 by `SkillNetwork`, whose logits are those of the policy."""

    action_space: Any
    optimizer_class: Any
    optimizer_kwargs: Any
    parameters: Any

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor = SkillNetwork((int(self.action_space.n) - 1) // DIRECTIONS)

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)  # type: ignore[misc]  # a mixin: the class beside it has _build
        self.action_net = nn.Identity()
        self.mlp_extractor.initialise_heads()
        self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)


class SkillPolicy(_SkillPolicyMixin, ActorCriticPolicy):
    """The policy of PPO on Skill."""


class MaskableSkillPolicy(_SkillPolicyMixin, MaskableActorCriticPolicy):
    """The policy of MaskablePPO on Skill."""
