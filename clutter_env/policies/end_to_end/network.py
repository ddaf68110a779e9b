"""The end-to-end network: from object rows and the robot to the object or place, the phase, and the next keyframe.

1. Tables: for each object and direction, whether the gripper gets there at all, and which other objects are in its way.
   Every other object is described in the frame of the gripper and judged by the same small network, so that the answer
   does not depend on the order or the number of the objects.
2. Pointer: messages along the tables, from objects to those in their way, say what it takes to get at each object
   and which ones the target needs moved. Object and direction are chosen by that.
3. Places: cells of the table, by what is in the way of each and by the grasps that an object there would be in the way
   of.
4. Keyframe: in the frame of the chosen object or place, a mixture of whole-body keyframes of the next phase.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import torch
from torch import nn
from torch.nn import functional

from clutter_env.policies.end_to_end.anchors import DIRECTIONS
from clutter_env.policies.end_to_end.controller import PHASES
from clutter_env.policies.high_level.network import turned

_OWN, _PAIR, _SITUATION = 15, 22, 24
_NEAR = (5.0, 20.0, 60.0)
"""[1/m] of the squashed copies of offsets."""
_MIDDLE_RADIUS, _MIDDLE_HEIGHT, _TABLE_HEIGHT = 0.03, 0.16, 0.75
"""[m] of usual objects and of the table, subtracted so that features are about zero."""
_ROUNDS = 6
"""Of messages: a chain of clearances is hardly ever longer."""
_FAR, _LEAST = 30.0, 1e-4
"""Cost of an object before a way to it is known; least need of an object, for its logarithm."""
_GRASPS = 12
"""Most needed grasps that a place is compared with."""
NO_PHASE = len(PHASES)
"""Number of the phase before the first one."""
_LEAST_COSINE = 0.15
"""Of the base's yaw; directions have a larger one."""
MODES = 4
"""Keyframes in a mixture."""
BASE, TCP, ARM, FINGER = slice(0, 3), slice(3, 6), slice(6, 14), slice(14, 15)
"""Parts of a keyframe: base along, aside and turned from its nominal pose behind the anchor; TCP in the anchor's frame;
torso and arm from the configuration straight ahead; position of a finger."""
KEYFRAME_SIZE = 15
"""Numbers of a keyframe."""
NOMINAL_DISTANCE = 0.85
"""[m] from the base to the anchor along the base's heading."""
MARGIN = 0.004
"""[m] added to the radius of objects that may be in the way: motions are not exact."""
_SURE = 0.9995
"""Probability from which on something is in the way for certain."""
ABSENT = -30.0
"""Logit of what cannot be."""


class Scenes(NamedTuple):
    """b scenes of up to n objects.

    Attributes:
        objects: (b, n, 5) `anchors.OBJECT_COLUMNS`.
        is_there: (b, n) whether each is on the table and not held.
        can_be_taken: (b, n) whether it stands upright there.
        is_target: (b, n).
    """

    objects: torch.Tensor
    is_there: torch.Tensor
    can_be_taken: torch.Tensor
    is_target: torch.Tensor


class Tables(NamedTuple):
    """What is in the way of the grasps of b scenes.

    Attributes:
        reach: (b, n, c) logits that direction c of object n is reached.
        blocks: (b, n, c, n) probabilities that an object is in its way.
    """

    reach: torch.Tensor
    blocks: torch.Tensor


class Needs(NamedTuple):
    """What the messages along the tables come to.

    Attributes:
        preference: (b, n, c) cost of each grasp whatever is in its way.
        weight: (b, n, c) share of each direction in the way to its object.
        cost: (b, n) of getting at each object.
        need: (b, n) how far the target needs it moved, 1 for the target itself.
    """

    preference: torch.Tensor
    weight: torch.Tensor
    cost: torch.Tensor
    need: torch.Tensor


class Places(NamedTuple):
    """What the tables say of k cells for the held objects of b scenes.

    Attributes:
        placed: (b, k, 5) the object as it would stand there.
        free: (b, k) logarithm of the probability that nothing is in the way.
        reach: (b, k) logits that the cell is reached.
        spoils: (b, k) needed grasps that the object would be in the way of.
    """

    placed: torch.Tensor
    free: torch.Tensor
    reach: torch.Tensor
    spoils: torch.Tensor


class EndToEndNetwork(nn.Module):
    """See the module. Widths are of hidden layers."""

    directions: torch.Tensor

    def __init__(self, width: int = 96) -> None:
        super().__init__()
        self.register_buffer("directions", torch.tensor(DIRECTIONS, dtype=torch.float32), persistent=False)
        self.reach, self.preference = _layers(_OWN, width, width, 1), _layers(_OWN, width, width, 1)
        self.anchor, self.other = nn.Linear(_OWN, width), nn.Linear(_PAIR, width)
        self.blocks = nn.Sequential(nn.SiLU(), nn.Linear(width, width), nn.SiLU(), nn.Linear(width, 1))
        self.crowding = _layers(_PAIR, 16, 1)
        self.graph = nn.Parameter(torch.tensor((1.0, 0.0, 0.0, 0.0)))  # see `needs`
        self.choice = nn.Parameter(torch.tensor((1.0, 1.0, 1.0)))
        self.object = _layers(5, 32, 32, 1)
        self.place = nn.Parameter(torch.tensor((1.0, 1.0, 1.0)))
        self.place_own = _layers(7, width, width, 1)
        self.phase = _layers(len(PHASES) + 1 + 4, 64, 64, len(PHASES))
        self.stand = _layers(_OWN + 2, 96, 96, 3)
        self.context = nn.Sequential(nn.Linear(_PAIR, width), nn.SiLU(), nn.Linear(width, 32))
        self.keyframe = _layers(_SITUATION + len(PHASES) + 32, 128, 128, MODES * (KEYFRAME_SIZE + 1))

    # Tables.

    def in_way(self, own: torch.Tensor, yaws: torch.Tensor, is_place: bool, others: torch.Tensor) -> torch.Tensor:
        """Logits (..., n) that others (..., n, 5) are in the way of an object (..., 5) from yaws (..., 2)."""
        features = self.anchor(own_features(own, yaws, is_place))[..., None, :]
        logits: torch.Tensor = self.blocks(features + self.other(pair_features(own, yaws, others)))[..., 0]
        return logits

    def reached(self, own: torch.Tensor, yaws: torch.Tensor, is_place: bool) -> torch.Tensor:
        """Logits (...) that the gripper gets to an object (..., 5) from yaws (..., 2), if nothing is in its way."""
        logits: torch.Tensor = self.reach(own_features(own, yaws, is_place))[..., 0]
        return logits

    def tables(self, scenes: Scenes) -> Tables:
        """The tables of scenes."""
        own, yaws = self._grasps(scenes)
        b, n, c = own.shape[:3]
        others = _thicker(scenes.objects)[:, None, None].expand(b, n, c, n, 5)
        blocks = self.in_way(own, yaws, False, others)
        counts = scenes.is_there[:, None, None] & ~torch.eye(n, dtype=torch.bool)[None, :, None]
        probability = torch.where(counts, torch.sigmoid(blocks), blocks.new_zeros(()))
        return Tables(self.reached(own, yaws, False), probability)

    def _grasps(self, scenes: Scenes) -> tuple[torch.Tensor, torch.Tensor]:
        """The object (b, n, c, 5) and yaws (b, n, c, 2) of every grasp."""
        b, n, _ = scenes.objects.shape
        c = len(self.directions)
        return scenes.objects[:, :, None].expand(b, n, c, 5), self.directions.expand(b, n, c, 2)

    # Pointer.

    def needs(self, scenes: Scenes, tables: Tables) -> Needs:
        """Messages along the tables: the cost of getting at each object, and what the target needs moved."""
        reach_weight, object_cost, sharpness, chain = functional.softplus(self.graph)
        preference = self.preference(own_features(*self._grasps(scenes), False))[..., 0]
        fixed = functional.softplus(preference) + reach_weight * functional.softplus(-4 * tables.reach)
        fixed = torch.where(scenes.can_be_taken[..., None], fixed, fixed.new_tensor(_FAR))
        cost = torch.full_like(scenes.objects[..., 0], _FAR)
        heat = 1.0 / (1.0 + 4.0 * sharpness)
        for _ in range(_ROUNDS):
            in_way = torch.einsum("bncm,bm->bnc", tables.blocks, object_cost + chain * cost)
            grasp_cost = fixed + in_way
            cost = (-heat * torch.logsumexp(-grasp_cost / heat, dim=2)).clamp(0.0, _FAR)
        weight = torch.softmax(-grasp_cost / heat, dim=2)
        sends = torch.einsum("bnc,bncm->bnm", weight, tables.blocks)
        need = scenes.is_target.float()
        for _ in range(_ROUNDS):
            need = torch.maximum(need, torch.einsum("bn,bnm->bm", need, sends).clamp(max=1.0))
        return Needs(functional.softplus(preference), weight, cost, need)

    def point(self, scenes: Scenes, tables: Tables) -> tuple[torch.Tensor, Needs]:
        """Logits (b, n, c) of the object to pick next and its direction, and the needs."""
        found = self.needs(scenes, tables)
        own, blocked, reach = functional.softplus(self.choice)
        target = scenes.is_target.float()
        need = torch.log(found.need + _LEAST)
        of_object = torch.stack((need, found.cost, target, found.need, target * found.cost), dim=-1)
        logits = (
            self.object(of_object)
            - own * found.preference
            + blocked * log_free(tables.blocks)
            - reach * functional.softplus(-4 * tables.reach)
        )
        return torch.where(scenes.can_be_taken[..., None], logits, logits.new_tensor(ABSENT)), found

    # Places.

    def judge_places(self, scenes: Scenes, found: Needs, held: torch.Tensor, cells: torch.Tensor) -> Places:
        """Judge the cells (k, 2) for the held object (b, 5)."""
        b, k = len(held), len(cells)
        placed = held[:, None].repeat(1, k, 1)
        placed[..., :2], placed[..., 2] = cells, _TABLE_HEIGHT
        others = _thicker(scenes.objects)[:, None].expand(b, k, *scenes.objects.shape[1:])
        ahead = placed.new_zeros(b, k, 2)
        in_way = torch.sigmoid(self.in_way(placed, ahead, True, others)) * scenes.is_there[:, None]
        return Places(
            placed=placed,
            free=log_free(in_way),
            reach=self.reached(placed, ahead, True),
            spoils=self._spoils(scenes, found, placed),
        )

    def place_logits(self, scenes: Scenes, places: Places, before: torch.Tensor) -> torch.Tensor:
        """Logits (b, k) of the cells. `before` (b, 2) [m] is where the object was taken from."""
        placed = places.placed
        b, k = placed.shape[:2]
        others = scenes.objects[:, None].expand(b, k, *scenes.objects.shape[1:])
        close = functional.softplus(self.crowding(pair_features(placed, placed.new_zeros(b, k, 2), others))[..., 0])
        close = (close * scenes.is_there[:, None]).sum(dim=2)
        away = placed[..., :2] - before[:, None]
        own = (3 * placed[..., :2], 3 * away, 3 * away.norm(dim=-1, keepdim=True), torch.tanh(10 * away))
        blocked, reach, spoiled = functional.softplus(self.place)
        logits: torch.Tensor = (
            self.place_own(torch.cat(own, dim=-1))[..., 0]
            + blocked * places.free
            - reach * functional.softplus(-4 * places.reach)
            - 4 * spoiled * places.spoils
            - close
        )
        return logits

    def _spoils(self, scenes: Scenes, found: Needs, placed: torch.Tensor) -> torch.Tensor:
        """(b, k) how far objects placed at (b, k, 5) are in the way of grasps that are needed."""
        b, n, c = found.weight.shape
        counts = (found.need[..., None] * found.weight).reshape(b, n * c)
        counts, index = counts.topk(min(_GRASPS, n * c), dim=1)
        own = torch.gather(scenes.objects, 1, (index // c)[..., None].expand(-1, -1, 5))
        others = placed[:, None].expand(b, own.shape[1], *placed.shape[1:])
        blocks = torch.sigmoid(self.in_way(own, self.directions[index % c], False, others))
        return torch.einsum("bg,bgk->bk", counts, blocks)

    # Phase and keyframe.

    def phase_logits(self, last: torch.Tensor, state: torch.Tensor) -> torch.Tensor:
        """Logits (b, p) of the next phase.

        Args:
            last: (b,) number of the last phase, `NO_PHASE` before the first.
            state: (b, 4) whether something is held, whether that is the target, whether the last keyframe was given up,
                whether the last contact was a place.
        """
        logits: torch.Tensor = self.phase(torch.cat((functional.one_hot(last, len(PHASES) + 1).float(), state), dim=1))
        return logits

    def stands(self, own: torch.Tensor, yaws: torch.Tensor) -> torch.Tensor:
        """(b, 3) Where the base stands at an anchor: the part `BASE` of a keyframe.

        Args:
            own: (b, 5) the object as it stands at the contact.
            yaws: (b, 2) [rad] of gripper and base there.
        """
        cosine = torch.cos(yaws[..., 1]).clamp(min=_LEAST_COSINE)
        line = torch.stack((3 * own[..., 0] / cosine, torch.tanh(10 * own[..., 0] / cosine)), dim=-1)
        found: torch.Tensor = self.stand(torch.cat((own_features(own, yaws, False), line), dim=-1)) * UNITS[BASE]
        # Along the world's x, since bases stand along the front of the table.
        along = (NOMINAL_DISTANCE + found[..., 0]) / cosine - NOMINAL_DISTANCE
        return torch.cat((along[..., None], found[..., 1:]), dim=-1)

    def keyframes(
        self, phase: torch.Tensor, situation: torch.Tensor, pairs: torch.Tensor, is_there: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits (b, m) and keyframes (b, m, 15) of a mixture. Their part `BASE` is not trained: see `stands`.

        Args:
            phase: (b,) number of the phase.
            situation: (b, s) see `situation_features`.
            pairs: (b, n, f) `pair_features` of the other objects at the anchor.
            is_there: (b, n) whether each counts.
        """
        context = (self.context(pairs) * is_there[..., None]).sum(dim=1)
        hidden = torch.cat((situation, functional.one_hot(phase, len(PHASES)).float(), context), dim=1)
        found = self.keyframe(hidden).reshape(len(phase), MODES, KEYFRAME_SIZE + 1)
        return found[..., 0], found[..., 1:] * UNITS


UNITS = torch.tensor((0.1, 0.1, 0.1, *(0.1,) * 3, 0.1, *(0.5,) * 7, 0.02))
"""[m], [rad] of each number of a keyframe that is one unit of an output."""


def _thicker(objects: torch.Tensor) -> torch.Tensor:
    """Objects (..., 5) with a margin about them."""
    return objects + objects.new_tensor((0.0, 0.0, 0.0, MARGIN, 0.0))


def log_free(blocks: torch.Tensor) -> torch.Tensor:
    """(...) Logarithm of the probability that none of n objects is in the way, of probabilities (..., n) for each."""
    return torch.log1p(-blocks.clamp(max=_SURE)).sum(dim=-1)


def own_features(own: torch.Tensor, yaws: torch.Tensor, is_place: bool) -> torch.Tensor:
    """(..., 15) An object (..., 5) as it stands at a contact, and the yaws (..., 2) of gripper and base."""
    x, y, bottom, radius, height = own.unbind(-1)
    yaw, heading = yaws.unbind(-1)
    turn = yaw - heading
    features = (
        *(3 * x, 2 * y, 10 * (bottom - _TABLE_HEIGHT)),
        *(torch.cos(heading), 2 * torch.sin(heading), torch.cos(yaw), torch.sin(yaw)),
        *(torch.cos(turn), 2 * torch.sin(turn), torch.sin(2 * turn)),
        *(100 * (radius - _MIDDLE_RADIUS), 20 * (height - _MIDDLE_HEIGHT)),
        *(3 * (torch.cos(heading) * x + torch.sin(heading) * y), 3 * (torch.cos(heading) * y - torch.sin(heading) * x)),
        torch.full_like(x, float(is_place)),
    )
    return torch.stack(features, dim=-1)


def pair_features(own: torch.Tensor, yaws: torch.Tensor, others: torch.Tensor) -> torch.Tensor:
    """(..., n, 22) Other objects (..., n, 5) in the frames of gripper and base at an object (..., 5), and sizes."""
    offset = others[..., :2] - own[..., None, :2]
    ahead, aside = turned(offset, yaws[..., 0])
    before, beside = turned(offset, yaws[..., 1])
    radius, height = others[..., 3], others[..., 4]
    top = others[..., 2] + height - own[..., None, 2]
    gap = (offset.square().sum(dim=-1) + 1e-8).sqrt() - radius - own[..., None, 3]
    features = [3 * ahead, 3 * aside, 3 * before, 3 * beside]
    for scale in _NEAR:
        features += [torch.tanh(scale * value) for value in (ahead, aside, before, beside)]
    features += [torch.tanh(40 * aside), torch.tanh(60 * gap), 3 * gap]
    features += [100 * (radius - _MIDDLE_RADIUS), 20 * (height - _MIDDLE_HEIGHT), 20 * top - 3]
    return torch.stack(features, dim=-1)


def situation_features(
    own: torch.Tensor, yaws: torch.Tensor, is_place: torch.Tensor, base: torch.Tensor, in_hand: torch.Tensor
) -> torch.Tensor:
    """(b, 24) The situation at an anchor.

    Args:
        own: (b, 5) the object as it stands at the contact.
        yaws: (b, 2) [rad] of gripper and base there.
        is_place: (b,) whether it is put down there.
        base: (b, 3) where the base is: x, y [m], yaw [rad].
        in_hand: (b, 3) [m] of the held object in the TCP's frame, 0 without one.
    """
    features = own_features(own, yaws, False)
    heading = yaws[:, 1]
    offset = own[:, :2] - base[:, :2]
    along, across = turned(offset[:, None], heading)
    near = torch.cat((along - NOMINAL_DISTANCE, across), dim=1)
    turn = torch.sin(base[:, 2] - heading)[:, None]
    return torch.cat(
        (features, is_place.float()[:, None], torch.tanh(2 * near), torch.tanh(10 * near), turn, 10 * in_hand), dim=1
    )


def _layers(*sizes: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for here, there in pairwise(sizes):
        layers += [nn.Linear(here, there), nn.SiLU()]
    return nn.Sequential(*layers[:-1])
