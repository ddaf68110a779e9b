"""The network of the skill policy: how good each skill is, clearing an object from a direction or taking the target.

It has the structure of the question. It learns two things of every grasp, a yaw of the gripper about an object: whether
the arm reaches it, and which of the other objects are in its way, one at a time, by the same small networks for all
objects and yaws. How many objects must be cleared for another one follows from these by a few sums and minima, also
for the scene without any one of them; small layers turn this into choices. So the answer does not depend on the order
of the objects, and what is learned of one object, or of one yaw, holds for the others.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import nn
from torch.nn.functional import logsigmoid, softplus

from clutter_env.envs.skill import BODY_FIELDS
from planners import DIRECTIONS, SIDE

YAWS = SIDE.directions
"""Yaws of grasps that are told apart, evenly about the vertical: the planner's side grasps of round objects."""
_STEP = YAWS // DIRECTIONS
YAWS_OF_DIRECTION = (np.arange(DIRECTIONS)[:, None] * _STEP + np.arange(-(_STEP // 2), _STEP // 2 + 1)) % YAWS
"""(directions, y) The yaws that belong to each direction of the skills; those on a border belong to both sides."""
NEVER = 6.0
"""Clearances that stand for what cannot be cleared."""
ROUNDS = 4
"""How many objects in a row are followed: one in the way of another one that is in the way of a third."""
_SMOOTH = 0.1
"""Clearances by which the minimum over grasps is smoothed, so that more than one of them learns."""
_WIDTH = 32
_ROW = len(BODY_FIELDS) + DIRECTIONS
_GLOBALS = 2
_PRESENT, _IS_TARGET, _X, _RADIUS, _HEIGHT = (
    BODY_FIELDS.index(name) for name in ("present", "is_target", "x", "half_x", "height")
)
_SCALES = (8.0, 40.0)
"""[1/m] Of the squashed copies of offsets: decimetres and centimetres."""
_GRIPPER = 0.065
"""[m] Half the width of the gripper: what is less beside its axis than this is in its way."""
_MIDDLE_RADIUS, _MIDDLE_HEIGHT = 0.03, 0.16
"""[m] Of usual objects, subtracted so that features are about zero."""
_SMALL = 0.01
"""Standard deviation of the initial weights of the last layers."""
_HARDLY = -3.0
"""Initial logit of a neighbour in the way, before it is known where it has to stand."""
_PLACE, _TURNED, _PAIR, _CLEAR, _STATE = 10, 11, 5, 5, 6
"""Numbers of features: of a grasp, of a neighbour seen along a yaw, of two objects, of a clearing skill, of a state."""
_SURELY_NOT = -8.0
"""Logarithm of the probability that a grasp is free that has just been refused."""
_LEAST_DOUBT = 0.02
"""Probability that a refused grasp is not free, at least: the estimate may be wrong."""


class GraspScores(NamedTuple):
    """Predicted grasps of n objects in k scenes.

    Attributes:
        reach: (k, n, yaws) logits that the arm reaches the grasp.
        blocks: (k, n, yaws, n) logits that the last object is in the way of the first one's grasp.
    """

    reach: torch.Tensor
    blocks: torch.Tensor


class SkillNetwork(nn.Module):
    """Predicts choices from flat observations; a permutation of the objects permutes the logits.

    The order of skills is that of the actions of `Skill`.
    """

    def __init__(self, num_objects: int, width: int = _WIDTH) -> None:
        super().__init__()
        self.num_objects = num_objects
        self.latent_dim_pi = num_objects * DIRECTIONS + 1
        self.latent_dim_vf = width
        self.reach = nn.Sequential(_layers(_PLACE, 2 * width, 2 * width), nn.Linear(2 * width, 1))
        self.of_place = nn.Linear(_PLACE, width, bias=False)
        self.of_turned = nn.Linear(_TURNED, width, bias=False)
        self.of_pair = nn.Linear(_PAIR, width)
        self.blocks = nn.Sequential(nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 1))
        nn.init.constant_(self.blocks[-1].bias, _HARDLY)
        self.useful = _layers(_CLEAR + _STATE, width, width)
        self.clear = nn.Linear(width, 1)
        self.whole = _layers(_STATE, width, width)
        self.take = nn.Linear(width, 1)
        angles = torch.arange(YAWS) * (2 * math.pi / YAWS)
        self.register_buffer("headings", torch.stack((angles.cos(), angles.sin()), dim=1), persistent=False)
        of_direction = torch.from_numpy(YAWS_OF_DIRECTION)
        self.register_buffer("of_direction", of_direction, persistent=False)
        covers = torch.zeros(DIRECTIONS, YAWS).scatter(1, of_direction, 1.0)
        self.register_buffer("covers", covers, persistent=False)

    def initialise_heads(self) -> None:
        """Start with equal probabilities: one half for taking the target, the rest shared by all clearing skills."""
        for head in (self.clear, self.take):
            nn.init.normal_(head.weight, std=_SMALL)
            nn.init.zeros_(head.bias)
        nn.init.constant_(self.take.bias, math.log(self.num_objects * DIRECTIONS))

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits (k, m) of choosing each skill, and features of the state (k, w), from observations (k, f)."""
        return self.choose(observation, self.grasps(self._rows(observation)))

    def forward_actor(self, observation: torch.Tensor) -> torch.Tensor:
        """The logits."""
        return self(observation)[0]

    def forward_critic(self, observation: torch.Tensor) -> torch.Tensor:
        """The value's features."""
        return self(observation)[1]

    def grasps(self, rows: torch.Tensor) -> GraspScores:
        """The grasps in scenes (k, n, f), whatever the target; of the columns those of bodies count."""
        place = self._place_features(rows)
        offset = rows[:, None, :, _X : _X + 2] - rows[:, :, None, _X : _X + 2]
        radius, height = rows[..., _RADIUS], rows[..., _HEIGHT]
        hidden = (
            self.of_turned(self._turned_features(offset, radius))
            + self.of_pair(_pair_features(offset, radius, height))[:, :, None]
            + self.of_place(place)[:, :, :, None]
        )
        return GraspScores(self.reach(place)[..., 0], self.blocks(hidden)[..., 0])

    def choose(self, observation: torch.Tensor, grasps: GraspScores) -> tuple[torch.Tensor, torch.Tensor]:
        """`forward`, given the grasps in the scenes."""
        rows, rest = self._rows(observation), observation[:, -_GLOBALS:]
        present, is_target = rows[..., _PRESENT], rows[..., _IS_TARGET]
        others = present[:, None] * (1 - torch.eye(self.num_objects, device=rows.device))
        unhindered = logsigmoid(grasps.reach) - (softplus(grasps.blocks) * others[:, :, None]).sum(3)
        refused = rows[..., len(BODY_FIELDS) :] @ self.covers + is_target[..., None] * rest[:, 1, None, None] > 0
        doubt = (-torch.expm1(unhindered)).clamp(min=_LEAST_DOUBT)
        more = torch.where(refused, 1 / doubt, 1.0)
        blocks = (torch.sigmoid(grasps.blocks) * more[..., None]).clamp(max=1) * others[:, :, None]
        unreachable = (torch.sigmoid(-grasps.reach) * more).clamp(max=1)
        needed = clearances_without(blocks, unreachable, is_target)
        of_target = (needed * is_target[:, :, None]).sum(1)
        after, now = of_target[:, :-1], of_target[:, -1:]

        free = torch.where(refused, _SURELY_NOT, unhindered)
        of_directions = free[:, :, self.of_direction].amax(3)
        taken = (free.amax(2) * is_target).sum(1, keepdim=True)
        state = torch.cat((now, torch.exp(taken), _logit(taken), after.amin(1, keepdim=True), rest), dim=1)
        of_object = torch.stack((now - after, after, needed[..., -1]), dim=2)[:, :, None]
        of_skill = torch.stack((torch.exp(of_directions), _logit(of_directions)), dim=3)
        of_state = state[:, None, None].expand(*of_directions.shape, _STATE)
        each = torch.cat((of_skill, of_object.expand(-1, -1, DIRECTIONS, -1), of_state), dim=3)
        whole = self.whole(state)
        clears = self.clear(self.useful(each)).flatten(1)
        return torch.cat((clears, self.take(whole)), dim=1), whole

    def _rows(self, observation: torch.Tensor) -> torch.Tensor:
        """(k, n, f): a row for each object."""
        return observation[:, :-_GLOBALS].reshape(-1, self.num_objects, _ROW)

    def _turned_features(self, offset: torch.Tensor, radius: torch.Tensor) -> torch.Tensor:
        """(k, n, yaws, n, f) of offsets (k, n, n, 2) between objects with these radii (k, n), seen along every yaw."""
        ahead, aside = self._turned(offset[:, :, None])
        of_other = radius[:, None, None]
        beside = aside.abs() - of_other
        features = [3 * ahead, 10 * (ahead - of_other), 3 * aside, 10 * aside.abs()]
        features += [torch.tanh(scale * (beside - _GRIPPER)) for scale in _SCALES]
        features.append(torch.tanh(_SCALES[1] * (beside - radius[:, :, None, None])))
        for scale in _SCALES:
            features += [torch.tanh(scale * ahead), torch.tanh(scale * aside)]
        return torch.stack(features, dim=4)

    def _place_features(self, rows: torch.Tensor) -> torch.Tensor:
        """(k, n, yaws, f): where an object stands on the table as seen along every yaw, and its size."""
        x, y = rows[..., _X], rows[..., _X + 1]
        ahead, aside = self._turned(rows[:, :, None, None, _X : _X + 2])
        headings = self.headings.expand(*ahead.shape[:3], 2)
        radius, height = 100 * (rows[..., _RADIUS] - _MIDDLE_RADIUS), 20 * (rows[..., _HEIGHT] - _MIDDLE_HEIGHT)
        each = (x, 3 * x * x, y, 3 * y * y, radius, height)
        shared = torch.stack(each, dim=2)[:, :, None].expand(-1, -1, YAWS, -1)
        return torch.cat((ahead, aside, headings, shared), dim=3)

    def _turned(self, offset: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Offsets (k, n, 1, m, 2) ahead and to the left of every yaw, (k, n, yaws, m) each."""
        cosine, sine = self.headings[:, 0, None], self.headings[:, 1, None]
        x, y = offset[..., 0], offset[..., 1]
        return cosine * x + sine * y, cosine * y - sine * x


def _pair_features(offset: torch.Tensor, radius: torch.Tensor, height: torch.Tensor) -> torch.Tensor:
    """(k, n, n, f): the sizes of the second object (k, n) beside those of the first, and the gap between them."""
    gap = offset.norm(dim=3) - radius[:, None] - radius[:, :, None]
    of_other = [100 * (radius - _MIDDLE_RADIUS), 20 * (height - _MIDDLE_HEIGHT)]
    pair = [value[:, None].expand_as(gap) for value in of_other]
    pair += [20 * (height[:, None] - height[:, :, None]), torch.tanh(40 * gap), 3 * gap]
    return torch.stack(pair, dim=3)


def _logit(log_probability: torch.Tensor) -> torch.Tensor:
    """The logit of a probability whose logarithm is given, scaled to about 1."""
    return 0.2 * (log_probability - torch.log((-torch.expm1(log_probability)).clamp(min=1e-4)))


def _layers(inputs: int, width: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, width), nn.ReLU(), nn.Linear(width, outputs), nn.ReLU())


def clearances_without(blocks: torch.Tensor, unreachable: torch.Tensor, is_target: torch.Tensor) -> torch.Tensor:
    """Clearances needed before each object can be grasped: in the scene without any one object, and in the whole one.

    The clearances for a grasp are the sum over what is in its way of one and of the clearances for that; those for an
    object are the least of its grasps. An object in the way of two others counts twice. The target is never cleared.

    Args:
        blocks: (k, n, yaws, n) probability that the last object is in the way of the first one's grasp.
        unreachable: (k, n, yaws) probability that the arm does not reach the grasp.
        is_target: (k, n) 1 for the target, 0 for the others.

    Returns:
        (k, n, n + 1) for the first object without the second; the last column without none.
    """
    k, n, yaws, _ = blocks.shape
    keeps = torch.cat((1 - torch.eye(n), torch.ones(n, 1)), dim=1).to(blocks)
    flat, never = blocks.reshape(k, n * yaws, n), (NEVER * unreachable)[..., None]
    stays = is_target[..., None]
    needed = torch.zeros(k, n, n + 1).to(blocks)
    for _ in range(ROUNDS):
        cost = keeps * (stays * NEVER + (1 - stays) * (1 + needed))
        of_grasps = (flat @ cost).reshape(k, n, yaws, n + 1) + never
        least = -_SMOOTH * torch.logsumexp(-of_grasps / _SMOOTH, dim=2)
        needed = least.clamp(min=0, max=NEVER)
    return needed
