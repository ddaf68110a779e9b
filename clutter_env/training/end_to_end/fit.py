"""Fits the end-to-end network to examples, part by part, each on the outputs of the parts before it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn import functional

from clutter_env.errors import LearningError
from clutter_env.policies.end_to_end.anchors import DIRECTIONS, nearest_direction
from clutter_env.policies.end_to_end.controller import FINGERS, LINES, PHASES
from clutter_env.policies.end_to_end.network import (
    ARM,
    BASE,
    FINGER,
    KEYFRAME_SIZE,
    NO_PHASE,
    TCP,
    EndToEndNetwork,
    Places,
    Scenes,
    Tables,
    pair_features,
    situation_features,
)
from clutter_env.training.end_to_end.examples import Examples, PickExamples, PlaceExamples, PlaceLabels

Index = NDArray[np.int64]
Log = Callable[[str], object]

_GRASPS, _ALL_GRASPS, _PLACES, _ALL_PLACES = 192, 768, 64, 256
"""Examples in a step of the tables: of what is in the way of grasps and places, and of what is reached."""
_POINTERS, _CELLS, _KEYFRAMES, _RULES = 32, 24, 256, 64
"""Examples in a step of the other parts."""
_PLAN_DIRECTION, _PLAN_OBJECT = 0.5, 0.15
"""Weights of the plan's own direction and object, beside all that are right."""
_AT_ONCE = 8
"""Scenes whose tables are computed together."""
_RATES = {"tables": 3e-3, "pointer": 5e-3, "places": 5e-3, "keyframes": 2e-3}
"""Highest learning rates of the parts, in the order in which they are fitted."""
_WARM_UP = 50
"""Steps in which the learning rate rises."""
_BASE_NOISE, _HAND_NOISE = (0.006, 0.006, 0.008), 0.01
"""[m], [rad] of noise on where the robot stands and how it holds an object: motions are not exact."""
_SCALES = torch.tensor((*(0.02,) * 3, *(0.004,) * 3, 0.05, *(0.1,) * 7, 0.002))
"""[m], [rad] Errors of a keyframe that count equally."""
_RAISE = 0.015
"""[m] by which objects are taken higher than in plans: the wrist of a level gripper is hardly above the table."""
_ODD = (0, 1, 1, 0, 1, 0, 0, 1, 0, 1, 0, 1, 0, 1, 0)
"""Numbers of a keyframe that have the other sign in its mirror image: offsets to the side, rolls and the pan."""
_EXACT = 0.01
"""[rad] by which yaws may be off a direction."""
_STANDS, _STAND_SCALE, _MOST_OFF = 96, 0.01, 20.0
"""Drives in a step; [m], [rad] and multiples of it that errors of where the base stands are counted in, and at most."""
_REFERENCE = 0.3
"""Weight of the arm configuration where it is only the reference of inverse kinematics."""


@dataclass(frozen=True)
class Steps:
    """Gradient steps of each part."""

    tables: int = 4500
    pointer: int = 1000
    places: int = 600
    keyframes: int = 4000

    def shortened(self, share: float) -> Steps:
        """The same, for a share of the steps, at least one each."""
        return Steps(*(max(1, round(share * one)) for one in vars(self).values()))


def fit(examples: Examples, cells: NDArray[np.float64], steps: Steps, seed: int, log: Log) -> EndToEndNetwork:
    """A network that is fitted to examples.

    Args:
        examples: to learn from.
        cells: (k, 2) [m] of the table.
        steps: how many.
        seed: random seed.
        log: is told the loss of each part.

    Raises:
        LearningError: the examples lack what a part learns from.
    """
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    network = EndToEndNetwork()
    parts = _Parts(network, examples, torch.tensor(cells, dtype=torch.float32), rng)
    for name, rate in _RATES.items():
        parameters, loss = getattr(parts, name)()
        last = _descend(parameters, getattr(steps, name), loss, rate)
        log(f"{name}: loss {last:.3f}")
    return network


def _some(rows: NDArray[np.intp], what: str) -> NDArray[np.intp]:
    """Rows to draw from, at least one. Raises `LearningError`."""
    if not len(rows):
        raise LearningError(f"the plans do not show {what}: there is nothing to learn from; use more scenes")
    return rows


class _Parts:
    """The parts of the network: each gives its parameters, and the loss of a step."""

    def __init__(
        self, network: EndToEndNetwork, examples: Examples, cells: torch.Tensor, rng: np.random.Generator
    ) -> None:
        self._network, self._examples, self._cells, self._rng = network, examples, cells, rng
        self._mirrored_direction = torch.from_numpy(_mirrored_directions())
        self._mirrored_cell = torch.cdist(cells * torch.tensor((1.0, -1.0)), cells).argmin(dim=1)

    def tables(self) -> _Part:
        """What is reached, and what is in the way."""
        network, rng = self._network, self._rng
        picks, labels = self._examples.picks, self._examples.place_labels
        reached = _some(np.argwhere(picks.is_reached), "a grasp within reach")
        reached_places = _some(np.flatnonzero(labels.is_reached), "a place within reach")

        def loss(step: int) -> torch.Tensor:
            is_mirrored = bool(step % 2)
            some = _grasps(picks, reached[rng.integers(len(reached), size=_GRASPS)], is_mirrored)
            total = self._in_way_loss(some, False)
            total = total + self._in_way_loss(_labelled(labels, rng.choice(reached_places, _PLACES), is_mirrored), True)
            scene = rng.integers(len(picks.seed), size=_ALL_GRASPS)
            index = (rng.random(_ALL_GRASPS) * picks.size[scene]).astype(int)
            rows = np.stack((scene, index, rng.integers(len(DIRECTIONS), size=_ALL_GRASPS)), axis=1)
            total = total + self._reach_loss(_grasps(picks, rows, is_mirrored), False)
            rows = rng.integers(len(labels.seed), size=_ALL_PLACES)
            return total + self._reach_loss(_labelled(labels, rows, is_mirrored), True)

        return chain(
            *(part.parameters() for part in (network.reach, network.anchor, network.other, network.blocks))
        ), loss

    def _in_way_loss(self, some: _Contacts, is_place: bool) -> torch.Tensor:
        """Of what is in the way of contacts: object by object, and whether it is anything at all."""
        logits = self._network.in_way(some.own, some.yaws, is_place, some.others)
        pairs = functional.binary_cross_entropy_with_logits(logits[some.is_there], some.blockers[some.is_there].float())
        log_free = (functional.logsigmoid(-logits) * some.is_there).sum(dim=1).clamp(max=-1e-6)
        free = -torch.where(~some.blockers.any(dim=1), log_free, torch.log1p(-log_free.exp())).mean()
        return 10 * pairs + free

    def _reach_loss(self, some: _Contacts, is_place: bool) -> torch.Tensor:
        logits = self._network.reached(some.own, some.yaws, is_place)
        return functional.binary_cross_entropy_with_logits(logits, some.is_reached.float())

    def pointer(self) -> _Part:
        """Which object, from where: every right object and free direction is a right answer."""
        network, picks, rng = self._network, self._examples.picks, self._rng
        nothing = np.full(len(picks.seed), -1)
        tables = self._tables(picks, nothing)
        right = picks.is_right[..., None] & picks.is_reached & (picks.blockers == 0)
        exact = np.flatnonzero(picks.direction >= 0)
        right[exact, picks.index[exact], picks.direction[exact]] = True
        usable = _some(np.flatnonzero(right.any(axis=(1, 2))), "a right first pick")
        parts = (network.preference, network.object)

        def loss(step: int) -> torch.Tensor:
            is_mirrored, size = bool(step % 2), int(picks.size[rng.choice(usable)])
            rows = rng.choice(usable[picks.size[usable] == size], _POINTERS)  # of one size, without absent objects
            some = Tables(tables.reach[rows, :size], tables.blocks[rows, :size, :, :size].float())
            if is_mirrored:  # the mirrored table, as its examples were mirrored too
                some = Tables(*(part[:, :, self._mirrored_direction] for part in some))
            scenes = Scenes(*(part[:, :size] for part in _scenes(picks, rows, nothing, is_mirrored)))
            logits, _ = network.point(scenes, some)
            shares = torch.log_softmax(logits.flatten(1), dim=1).reshape(logits.shape)
            is_right, direction = torch.from_numpy(right[rows, :size]), torch.from_numpy(picks.direction[rows])
            if is_mirrored:
                is_right = is_right[..., self._mirrored_direction]
                direction = torch.where(direction >= 0, self._mirrored_direction[direction], direction)
            of_right = torch.where(is_right, shares, shares.new_tensor(-1e9)).flatten(1).logsumexp(dim=1)
            each, index = torch.arange(len(rows)), torch.from_numpy(picks.index[rows])
            of_direction = torch.log_softmax(logits[each, index], dim=1)[each, direction.clamp(min=0)]
            of_object = shares[each, index].logsumexp(dim=1)
            total = of_right + _PLAN_DIRECTION * of_direction * (direction >= 0) + _PLAN_OBJECT * of_object
            return -total.mean()

        return chain((network.graph, network.choice), *(part.parameters() for part in parts)), loss

    def places(self) -> _Part:
        """Where the held object is put down: the plan's cell."""
        network, rng, cells = self._network, self._rng, self._cells
        places = self._examples.places
        usable = _some(np.flatnonzero(places.cell >= 0), "a place on the grid of cells")
        judged = self._judged(places)

        def loss(step: int) -> torch.Tensor:
            is_mirrored, rows = bool(step % 2), rng.choice(usable, _CELLS)
            before, cell = torch.from_numpy(places.before[rows]), torch.from_numpy(places.cell[rows])
            if is_mirrored:
                before, cell = before * torch.tensor((1.0, -1.0)), self._mirrored_cell[cell]
            some = Places(*(part[rows] for part in judged))
            if is_mirrored:
                free, reach, spoils = (part[:, self._mirrored_cell] for part in some[1:])
                some = Places(some.placed, free, reach, spoils)
            logits = network.place_logits(_scenes(places, rows, places.held, is_mirrored), some, before)
            assert logits.shape[1] == len(cells)
            return functional.cross_entropy(logits, cell)

        return chain((network.place,), network.crowding.parameters(), network.place_own.parameters()), loss

    def keyframes(self) -> _Part:
        """The next phase and its keyframe."""
        network, rng, rows = self._network, self._rng, self._examples.keyframes
        usable = _some(np.flatnonzero(rows.is_straight), "a straight motion")
        counts, weights = _phase_weights(), _keyframe_weights()
        shares = np.cumsum(counts[rows.phase[usable]]) / counts[rows.phase[usable]].sum()
        rules, at_contact = recoveries(), [PHASES.index(phase) for phase in ("transit", *LINES)]
        # A plan's base may also stand as no direction has it.
        near = np.array([nearest_direction(*yaws)[1] < _EXACT for yaws in rows.yaws.astype(float)])
        drives = _some(np.flatnonzero((rows.phase == PHASES.index("drive")) & near), "a drive to a contact")
        parts = (network.phase, network.context, network.keyframe, network.stand)

        def loss(step: int) -> torch.Tensor:
            some = usable[np.searchsorted(shares, rng.random(_KEYFRAMES)).clip(max=len(usable) - 1)]
            phase = torch.from_numpy(rows.phase[some])
            own, yaws, objects = (torch.from_numpy(part[some]) for part in (rows.own, rows.yaws, rows.objects))
            base, in_hand = (torch.from_numpy(part[some]) for part in (rows.base, rows.in_hand))
            base = base + torch.randn(base.shape) * torch.tensor(_BASE_NOISE)
            shift = torch.randn(in_hand.shape) * _HAND_NOISE * torch.from_numpy(rows.held[some] >= 0)[:, None]
            in_hand = in_hand + shift
            each = np.arange(objects.shape[1])
            is_there = (each < rows.size[some, None]) & (each != rows.index[some, None])
            keyframe = torch.from_numpy(rows.keyframe[some])
            is_grasp = torch.from_numpy((rows.phase[some] == PHASES.index("approach")) & ~rows.is_place[some])
            keyframe[:, TCP.stop - 1] += _RAISE * is_grasp
            keyframe[:, TCP] -= shift * torch.from_numpy(rows.is_place[some])[:, None]  # held lower, put down higher
            if step % 2:  # the tucked arm of drives and retreats has no mirror image
                sides = torch.from_numpy(np.where(np.isin(rows.phase[some], at_contact), -1.0, 1.0)).float()[:, None]
                own, objects = _with_side(own, sides), _with_side(objects, sides[:, None])
                yaws, base, in_hand = (
                    yaws * sides,
                    base * _side_of((0, 1, 1), sides),
                    in_hand * _side_of((0, 1, 0), sides),
                )
                keyframe = keyframe * _side_of(_ODD, sides)
            situation = situation_features(own, yaws, torch.from_numpy(rows.is_place[some]), base, in_hand)
            modes, found = network.keyframes(
                phase, situation, pair_features(own, yaws, objects), torch.from_numpy(is_there)
            )
            off = (found - keyframe[:, None]).abs() / _SCALES * weights[phase][:, None]
            of_keyframe = torch.logsumexp(torch.log_softmax(modes, dim=1) - off.sum(dim=2), dim=1).mean()
            states = np.stack(
                (rows.held >= 0, rows.held == rows.target, np.zeros(len(rows.held), np.bool_), rows.was_place), axis=1
            )[some]
            shown = network.phase_logits(torch.from_numpy(rows.last[some]), torch.tensor(states, dtype=torch.float32))
            drawn = rules[rng.integers(len(rules), size=_RULES)]
            after = network.phase_logits(
                torch.from_numpy(drawn[:, 0]), torch.tensor(drawn[:, 1:5], dtype=torch.float32)
            )
            of_phase = functional.cross_entropy(shown, phase) + self._stand_loss(rng.choice(drives, _STANDS), step)
            return of_phase + functional.cross_entropy(after, torch.from_numpy(drawn[:, 5])) - of_keyframe

        return chain(*(part.parameters() for part in parts)), loss

    def _stand_loss(self, some: Index, step: int) -> torch.Tensor:
        """Of where the base stands, for keyframes of drives."""
        rows, sides = self._examples.keyframes, torch.full((len(some), 1), -1.0 if step % 2 else 1.0)
        own, yaws, keyframe = (torch.from_numpy(part[some]) for part in (rows.own, rows.yaws, rows.keyframe))
        found = self._network.stands(_with_side(own, sides), yaws * sides)
        off = (found - keyframe[:, BASE] * _side_of((0, 1, 1), sides)).abs() / _STAND_SCALE
        off = torch.cat((off[:, :1] * torch.cos(yaws[:, 1:]).abs(), off[:, 1:]), dim=1)  # towards the table
        return off.clamp(max=_MOST_OFF).sum(dim=1).mean()

    def _tables(self, examples: PickExamples | PlaceExamples, held: Index) -> Tables:
        """The network's tables of all scenes, in half precision, 0 for absent objects."""
        s, n, c = len(examples.seed), examples.objects.shape[1], len(DIRECTIONS)
        tables = Tables(torch.zeros(s, n, c), torch.zeros(s, n, c, n, dtype=torch.float16))
        with torch.no_grad():
            for size in np.unique(examples.size).tolist():
                for rows in _blocks(np.flatnonzero(examples.size == size)):
                    scenes = _scenes(examples, rows, held, False)
                    found = self._network.tables(Scenes(*(part[:, :size] for part in scenes)))
                    tables.reach[rows, :size] = found.reach
                    tables.blocks[rows, :size, :, :size] = found.blocks.half()
        return tables

    def _judged(self, places: PlaceExamples) -> Places:
        """What the network's tables say of all cells in all scenes."""
        found, network, tables = [], self._network, self._tables(places, places.held)
        with torch.no_grad():
            for rows in _blocks(np.arange(len(places.seed))):
                scenes = _scenes(places, rows, places.held, False)
                needs = network.needs(scenes, Tables(tables.reach[rows], tables.blocks[rows].float()))
                found.append(network.judge_places(scenes, needs, torch.from_numpy(places.own[rows]), self._cells))
        return Places(*(torch.cat(part) for part in zip(*found, strict=True)))


def _with_side(objects: torch.Tensor, sides: torch.Tensor) -> torch.Tensor:
    """Objects (..., 5), mirrored left to right where the side (..., 1) is -1."""
    return objects * _side_of((0, 1, 0, 0, 0), sides)


def _side_of(odd: Sequence[int], sides: torch.Tensor) -> torch.Tensor:
    """Factors (..., k) of numbers of which the odd ones change their sign where the side (..., 1) is -1."""
    return torch.where(torch.tensor(odd) > 0, sides, torch.ones_like(sides))


_Part = tuple[Iterable[nn.Parameter], Callable[[int], torch.Tensor]]


@dataclass(frozen=True, eq=False)
class _Contacts:
    """m labelled contacts: own (m, 5), yaws (m, 2), others (m, n, 5), is_there and blockers (m, n), is_reached (m,)."""

    own: torch.Tensor
    yaws: torch.Tensor
    others: torch.Tensor
    is_there: torch.Tensor
    blockers: torch.Tensor
    is_reached: torch.Tensor

    @classmethod
    def of(
        cls,
        own: NDArray[np.float32],
        yaws: NDArray[np.float32],
        others: NDArray[np.float32],
        size: Index,
        itself: Index,
        masks: NDArray[np.uint64],
        is_reached: NDArray[np.bool_],
        is_mirrored: bool,
    ) -> _Contacts:
        """From arrays, mirrored left to right if wanted, which changes no label."""
        each = np.arange(others.shape[1])
        side = np.array((1, -1, 1, 1, 1), np.float32) if is_mirrored else np.float32(1)
        bits = masks[:, None] >> each.astype(np.uint64) & np.uint64(1)
        return cls(
            own=torch.from_numpy(own * side),
            yaws=torch.from_numpy(-yaws if is_mirrored else yaws),
            others=torch.from_numpy(others * side),
            is_there=torch.from_numpy((each < size[:, None]) & (each != itself[:, None])),
            blockers=torch.from_numpy(bits.astype(np.bool_)),
            is_reached=torch.from_numpy(is_reached),
        )


def _grasps(picks: PickExamples, rows: Index, is_mirrored: bool) -> _Contacts:
    """Grasps (m, 3) by scene, object and direction."""
    scene, index, direction = rows.T
    return _Contacts.of(
        *(picks.objects[scene, index], DIRECTIONS[direction].astype(np.float32), picks.objects[scene]),
        *(picks.size[scene], index, picks.blockers[scene, index, direction]),
        *(picks.is_reached[scene, index, direction], is_mirrored),
    )


def _labelled(labels: PlaceLabels, rows: Index, is_mirrored: bool) -> _Contacts:
    """Some labelled places."""
    return _Contacts.of(
        *(labels.own[rows], labels.yaws[rows], labels.objects[rows], labels.size[rows], labels.held[rows]),
        *(labels.blockers[rows], labels.is_reached[rows], is_mirrored),
    )


def _scenes(examples: PickExamples | PlaceExamples, rows: Index, held: Index, is_mirrored: bool) -> Scenes:
    """Some scenes; `held` (s,) are the indices of held objects of all, -1 for none."""
    objects, each = examples.objects[rows], np.arange(examples.objects.shape[1])
    if is_mirrored:
        objects = objects * np.array((1, -1, 1, 1, 1), np.float32)
    is_there = torch.from_numpy((each < examples.size[rows, None]) & (each != held[rows, None]))
    is_target = torch.from_numpy(each == examples.target[rows, None])
    return Scenes(torch.from_numpy(objects), is_there, is_there, is_target)


def _blocks(rows: Index) -> list[Index]:
    return [rows[first : first + _AT_ONCE] for first in range(0, len(rows), _AT_ONCE)]


def _mirrored_directions() -> Index:
    """(c,) Number of each direction's mirror image."""
    away = DIRECTIONS[:, None] + DIRECTIONS[None]
    return np.abs(np.remainder(away + math.pi, 2 * math.pi) - math.pi).max(axis=2).argmin(axis=1)


def _phase_weights() -> NDArray[np.float64]:
    """(p,) How often examples of each phase are drawn: motions of the arm and of the base more than others."""
    often = ("drive", "transit", "approach", "lower")
    return np.array([1.0 if phase in often else 0.3 for phase in PHASES])


def _keyframe_weights() -> torch.Tensor:
    """(p, 15) Weights of the numbers of a keyframe in each phase: only what the controller uses."""
    weights = torch.zeros(len(PHASES), KEYFRAME_SIZE)
    for number, phase in enumerate(PHASES):
        if phase in FINGERS:
            weights[number, FINGER] = 1.0
        elif phase in ("drive", "retreat"):
            weights[number, ARM] = 1.0
        else:
            weights[number, TCP] = 1.0
            weights[number, ARM] = 1.0 if phase == "transit" else _REFERENCE
    return weights


def recoveries() -> Index:
    """Rules (r, 6) of which phase follows, also after failures, which no plan shows.

    Columns: last phase, whether something is held, whether that is the target, whether the last keyframe was given up,
    whether the last contact was a place, next phase.
    """
    picked = [("close", 1, "lift"), ("lift", 1, "retreat"), ("close", 0, "lift"), ("lift", 0, "retreat")]
    picked += [("retreat", 0, "drive"), ("retreat", 1, "drive"), ("drive", 1, "transit"), ("drive", 0, "ready")]
    picked += [("ready", 0, "transit"), ("transit", 0, "approach"), ("transit", 1, "lower")]
    placed = [("drive", 1, "transit"), ("drive", 0, "retreat"), ("transit", 1, "lower"), ("transit", 0, "retreat")]
    placed += [("open", 0, "rise"), ("open", 1, "open"), ("rise", 0, "retreat"), ("rise", 1, "retreat")]
    placed += [("retreat", 0, "drive"), ("retreat", 1, "drive"), ("lower", 0, "open")]
    rules: list[tuple[int, int, int, int, int, int]] = []
    for was_place, known in enumerate((picked, placed)):
        for last, is_held, after in known:
            for gave_up in (0, 1):
                rules.append((PHASES.index(last), is_held, 0, gave_up, was_place, PHASES.index(after)))
    first = (NO_PHASE, 0, 0, 0, 0, PHASES.index("drive"))
    target = [("close", "lift"), ("lift", "retreat"), ("retreat", "retreat")]
    rules += [
        (PHASES.index(last), 1, 1, gave_up, 0, PHASES.index(after)) for last, after in target for gave_up in (0, 1)
    ]
    # Short of the contact the gripper goes back, else it closes or opens.
    ends = [("approach", 0, 0, 0, "close"), ("approach", 0, 1, 0, "lift")]
    ends += [("lower", 1, 0, 1, "open"), ("lower", 1, 1, 1, "rise")]
    often = [
        first,
        *((PHASES.index(a), held, 0, gave_up, place, PHASES.index(b)) for a, held, gave_up, place, b in ends),
    ]
    return np.array(rules + 4 * often)


def _descend(
    parameters: Iterable[nn.Parameter], steps: int, loss_at: Callable[[int], torch.Tensor], rate: float
) -> float:
    """Gradient steps by AdamW, the rate falling along a cosine. Returns the last loss."""
    wanted: Sequence[nn.Parameter] = list(parameters)
    optimiser = torch.optim.AdamW(wanted, rate, weight_decay=1e-4)
    last = math.nan
    for step in range(steps):
        share = min(1.0, (step + 1) / _WARM_UP) * 0.5 * (1 + math.cos(math.pi * step / steps))
        for group in optimiser.param_groups:
            group["lr"] = rate * max(share, 1e-3)
        loss = loss_at(step)
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(wanted, 5.0)
        optimiser.step()
        last = loss.item()
    return last
