"""A policy for `Skill`: one network for all objects, each described with its neighbours and the target."""

from __future__ import annotations

import math
from typing import Any

import torch
from sb3_contrib.common.maskable.policies import MaskableActorCriticPolicy
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import nn

from clutter_env.envs.skill import BODY_FIELDS
from planners.skills.geometry import DIRECTIONS

__all__ = ["MaskableSkillPolicy", "SkillNetwork", "SkillPolicy"]

WIDTH = 64
NEIGHBOUR_SCALE = 10.0
"""[1/m] Offsets of neighbours are scaled so that centimetres are resolved."""

_SMALL = 0.01
"""Standard deviation of the initial weights of the last layers."""
_ROW = len(BODY_FIELDS) + DIRECTIONS
_GLOBALS = 2
_PRESENT, _IS_TARGET, _X, _Y = (BODY_FIELDS.index(name) for name in ("present", "is_target", "x", "y"))


class SkillNetwork(nn.Module):
    """Logits and value features of the flat observation; a permutation of the objects permutes the logits.

    Every object is described by its own row, by the sum over its neighbours of the output of a small network for each
    pair, and by the same description of the target.
    """

    def __init__(self, num_objects: int) -> None:
        super().__init__()
        self.num_objects = num_objects
        self.latent_dim_pi = num_objects * DIRECTIONS + 1
        self.latent_dim_vf = WIDTH
        self.pair = _layers(2 * _ROW + 4, WIDTH, WIDTH)
        self.body = _layers(2 * (_ROW + WIDTH) + 2 + _GLOBALS, WIDTH, WIDTH)
        self.clear = nn.Linear(WIDTH, DIRECTIONS)
        self.whole = _layers(_ROW + 2 * WIDTH + _GLOBALS, WIDTH, WIDTH)
        self.take = nn.Linear(WIDTH, 1)

    def initialise_heads(self) -> None:
        """Start with equal probabilities: one half for taking the target, the rest shared by all clearing skills."""
        for head in (self.clear, self.take):
            nn.init.normal_(head.weight, std=_SMALL)
            nn.init.zeros_(head.bias)
        nn.init.constant_(self.take.bias, math.log(self.num_objects * DIRECTIONS))

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits (k, n) and features for the value (k, w) of observations (k, f)."""
        rows = observation[:, :-_GLOBALS].reshape(-1, self.num_objects, _ROW)
        rest = observation[:, -_GLOBALS:]
        bodies = torch.cat((rows, self._neighbours(rows)), dim=2)
        target = (bodies * rows[:, :, _IS_TARGET, None]).sum(1)
        embedded = self._embed(bodies, target, rest)
        everything = embedded.mean(1)
        whole = self.whole(torch.cat((target, everything, rest), dim=1))
        logits = torch.cat((self.clear(embedded).flatten(1), self.take(whole)), dim=1)
        return logits, whole

    def forward_actor(self, observation: torch.Tensor) -> torch.Tensor:
        """The logits."""
        return self(observation)[0]

    def forward_critic(self, observation: torch.Tensor) -> torch.Tensor:
        """The value's features."""
        return self(observation)[1]

    def _neighbours(self, rows: torch.Tensor) -> torch.Tensor:
        """(k, n, w): for each object the sum over the others."""
        count = self.num_objects
        one = rows[:, :, None].expand(-1, -1, count, -1)
        other = rows[:, None].expand(-1, count, -1, -1)
        offset = NEIGHBOUR_SCALE * (other[..., _X : _Y + 1] - one[..., _X : _Y + 1])
        pairs = self.pair(torch.cat((one, other, offset / 4, torch.tanh(offset)), dim=3))
        counts = other[..., _PRESENT] * (1 - torch.eye(count, device=rows.device))
        return (pairs * counts[..., None]).sum(2)

    def _embed(self, bodies: torch.Tensor, target: torch.Tensor, rest: torch.Tensor) -> torch.Tensor:
        """(k, n, w)."""
        count = self.num_objects
        aim, common = target[:, None].expand(-1, count, -1), rest[:, None].expand(-1, count, -1)
        offset = NEIGHBOUR_SCALE * (bodies[..., _X : _Y + 1] - aim[..., _X : _Y + 1])
        return self.body(torch.cat((bodies, aim, torch.tanh(offset), common), dim=2))


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


def _layers(inputs: int, width: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, width), nn.ReLU(), nn.Linear(width, outputs), nn.ReLU())
