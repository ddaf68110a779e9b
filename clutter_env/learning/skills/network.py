"""The network of skills: for every object and direction how good it is to clear it from there, and for the target.

Every object is described beside its neighbours in the frame of every approach direction, by the same small networks.
So the answer does not depend on the order of the objects, and what is learned of one direction holds for the others.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import nn

from clutter_env.envs.skill import BODY_FIELDS
from planners.skills.geometry import DIRECTIONS

__all__ = ["SkillNetwork", "SkillScores"]

WIDTH = 32
_ROW = len(BODY_FIELDS) + DIRECTIONS
_GLOBALS = 2
_PRESENT, _IS_TARGET, _X, _RADIUS, _HEIGHT = (
    BODY_FIELDS.index(name) for name in ("present", "is_target", "x", "half_x", "height")
)
_SCALES = (8.0, 25.0)
"""[1/m] Of the squashed copies of offsets: decimetres and centimetres."""
_MIDDLE_RADIUS, _MIDDLE_HEIGHT = 0.03, 0.16
"""[m] Of usual objects, subtracted so that features are about zero."""
_SMALL = 0.01
"""Standard deviation of the initial weights of the last layers."""
_PAIR, _SELF = 14, 11


class SkillScores(NamedTuple):
    """What the network says of k states; the order of skills is that of the actions of `Skill`.

    Attributes:
        logits: (k, m) of choosing each skill.
        free: (k, m) logits that a skill has a grasp with nothing in its way.
        whole: (k, w) features of the state.
    """

    logits: torch.Tensor
    free: torch.Tensor
    whole: torch.Tensor


class SkillNetwork(nn.Module):
    """Predicts `SkillScores` from flat observations; a permutation of the objects permutes the logits.

    Two rounds: how an object stands among its neighbours from a direction; then whether it stands in the way of the
    target, from each of its directions.
    """

    def __init__(self, num_objects: int, width: int = WIDTH) -> None:
        super().__init__()
        self.num_objects = num_objects
        self.latent_dim_pi = num_objects * DIRECTIONS + 1
        self.latent_dim_vf = width
        self.own = nn.Linear(_SELF, width)
        self.pair = nn.Linear(_PAIR, width)
        self.beside = nn.Sequential(nn.ReLU(), nn.Linear(width, width), nn.ReLU())
        self.among = _layers(2 * width + _SELF, width, width)
        self.free = nn.Linear(width, 1)
        self.target_pair = nn.Linear(_PAIR, width)
        self.target_own = nn.Linear(width, width)
        self.other_own = nn.Linear(width, width)
        self.hinders = nn.Sequential(nn.ReLU(), nn.Linear(width, width), nn.ReLU())
        self.useful = _layers(4 * width + _GLOBALS, width, width)
        self.clear = nn.Linear(width, 1)
        self.whole = _layers(3 * width + _GLOBALS, width, width)
        self.take = nn.Linear(width, 1)
        angles = torch.arange(DIRECTIONS) * (2 * math.pi / DIRECTIONS)
        self.register_buffer("headings", torch.stack((angles.cos(), angles.sin()), dim=1), persistent=False)

    def initialise_heads(self) -> None:
        """Start with equal probabilities: one half for taking the target, the rest shared by all clearing skills."""
        for head in (self.clear, self.take):
            nn.init.normal_(head.weight, std=_SMALL)
            nn.init.zeros_(head.bias)
        nn.init.constant_(self.take.bias, math.log(self.num_objects * DIRECTIONS))

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits (k, m) and features for the value (k, w) of observations (k, f)."""
        scores = self.scores(observation)
        return scores.logits, scores.whole

    def forward_actor(self, observation: torch.Tensor) -> torch.Tensor:
        """The logits."""
        return self(observation)[0]

    def forward_critic(self, observation: torch.Tensor) -> torch.Tensor:
        """The value's features."""
        return self(observation)[1]

    def scores(self, observation: torch.Tensor) -> SkillScores:
        """All that is known of observations (k, f)."""
        count = self.num_objects
        rows = observation[:, :-_GLOBALS].reshape(-1, count, _ROW)
        rest = observation[:, -_GLOBALS:]
        present, is_target = rows[..., _PRESENT], rows[..., _IS_TARGET]
        pairs = self._pair_features(rows)
        around = self._among(rows, pairs, present)
        target = (around * is_target[:, :, None, None]).sum(1)
        target_pairs = (pairs * is_target[:, :, None, None, None]).sum(1)
        best = around.amax(2)
        hidden = self.target_pair(target_pairs) + self.target_own(target)[:, None] + self.other_own(best)[:, :, None]
        hinders = self.hinders(hidden) * (present * (1 - is_target))[:, :, None, None]
        use = torch.cat((hinders.amax(2), hinders.mean(2)), dim=2)
        beside = torch.cat((target.amax(1), rest), dim=1)
        told = torch.cat((use, beside[:, None].expand(-1, count, -1)), dim=2)
        embedded = self.useful(torch.cat((around, told[:, :, None].expand(-1, -1, DIRECTIONS, -1)), dim=3))
        whole = self.whole(torch.cat((use.sum(1), beside), dim=1))
        logits = torch.cat((self.clear(embedded).flatten(1), self.take(whole)), dim=1)
        free = self.free(around)[..., 0]
        of_target = (free * is_target[:, :, None]).sum(1).amax(1, keepdim=True)
        return SkillScores(logits, torch.cat((free.flatten(1), of_target), dim=1), whole)

    def _among(self, rows: torch.Tensor, pairs: torch.Tensor, present: torch.Tensor) -> torch.Tensor:
        """(k, n, directions, w): every object among its neighbours, seen along every direction."""
        own = self._own_features(rows)
        beside = self.beside(self.pair(pairs) + self.own(own)[:, :, None])
        others = present[:, None] * (1 - torch.eye(self.num_objects, device=rows.device))
        beside = beside * others[..., None, None]
        pooled: torch.Tensor = self.among(torch.cat((beside.sum(2), beside.amax(2), own), dim=3))
        return pooled

    def _own_features(self, rows: torch.Tensor) -> torch.Tensor:
        """(k, n, directions, f): where an object stands on the table, its size, what failed."""
        x, y = rows[..., _X], rows[..., _X + 1]
        ahead, aside = self._turned(rows[..., _X : _X + 2])
        headings = self.headings.expand(*ahead.shape, 2)
        failed = rows[..., len(BODY_FIELDS) :]
        radius, height = 100 * (rows[..., _RADIUS] - _MIDDLE_RADIUS), 20 * (rows[..., _HEIGHT] - _MIDDLE_HEIGHT)
        each = (x, 3 * x * x, y, 3 * y * y, radius, height)
        shared = torch.stack(each, dim=2)[:, :, None].expand(-1, -1, DIRECTIONS, -1)
        return torch.cat((torch.stack((ahead, aside, failed), dim=3), headings, shared), dim=3)

    def _pair_features(self, rows: torch.Tensor) -> torch.Tensor:
        """(k, n, n, directions, f): the second object as seen from the first along every direction."""
        place, radius, height = rows[..., _X : _X + 2], rows[..., _RADIUS], rows[..., _HEIGHT]
        offset = place[:, None] - place[:, :, None]
        ahead, aside = self._turned(offset)
        gap = offset.norm(dim=3) - radius[:, None] - radius[:, :, None]
        features = [3 * ahead, 3 * aside]
        for scale in _SCALES:
            features += [torch.tanh(scale * ahead), torch.tanh(scale * aside), torch.tanh(scale * aside.abs())]
        sizes = (100 * (radius - _MIDDLE_RADIUS), 20 * (height - _MIDDLE_HEIGHT), rows[..., _IS_TARGET])
        of_other = [value[:, None].expand_as(gap) for value in sizes]
        taller = 20 * (height[:, None] - height[:, :, None])
        alone = torch.stack((*of_other, torch.tanh(40 * gap), 3 * gap, taller), dim=3)
        return torch.cat((torch.stack(features, dim=4), alone[..., None, :].expand(*ahead.shape, 6)), dim=4)

    def _turned(self, offset: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Offsets (..., 2) ahead and to the left of every direction, (..., directions) each."""
        cosine, sine = self.headings.unbind(1)
        x, y = offset[..., :1], offset[..., 1:]
        return cosine * x + sine * y, cosine * y - sine * x


def _layers(inputs: int, width: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, width), nn.ReLU(), nn.Linear(width, outputs), nn.ReLU())
