"""Decisions of a planner of moves, before any motion is planned."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from planners.clearing.commitments import Commitments, with_blockers
from planners.clearing.moves import Move
from planners.grasping.candidates import GraspCandidates
from planners.placing.placements import Placement
from planners.scene import Scene
from planners.symbolic.transitions import ArmStep

_SAME = 0.002
"""Tolerance [m] and of rotation entries for objects that stand elsewhere than expected: they are released just
above."""


@dataclass(frozen=True)
class ClearancePlan:
    """A grasp and a placement for each object to clear. Empty placements for strategies that do not plan ahead.

    Attributes:
        commitments: a grasp for the target and for every object that must go before it.
        placements: the placements of objects that are put down.
        aside: the object that stays in a gripper while another one takes the target, "" for none.
        general: objects that are put down where the goal wants them.
        until: objects in the order of their moves. Empty for strategies that do not plan ahead.
        steps: picks and put-downs of these moves, in order.
        expected: the scene after these moves. None for such strategies.
        later: the moves after these. The last object of `until` moves again among them.
    """

    commitments: Commitments
    placements: Mapping[str, Placement] = field(default_factory=lambda: MappingProxyType({}))
    aside: str = ""
    general: frozenset[str] = frozenset()
    until: tuple[str, ...] = ()
    steps: tuple[ArmStep, ...] = ()
    expected: Scene | None = None
    later: tuple[Move, ...] = ()

    @property
    def holds_two(self) -> bool:
        """Whether an object is taken while another one is in a hand."""
        picked = {step.object for step in self.steps if not step.is_put_down}
        in_hand = {step.object for step in self.steps if step.is_put_down and step.object not in picked}
        for name, is_put_down in self.steps:
            if is_put_down:
                in_hand -= {name}
            elif in_hand:
                return True
            else:
                in_hand |= {name}
        return False

    def without(self, name: str) -> ClearancePlan:
        """The plan that remains once that object has been cleared."""
        kept = MappingProxyType({other: place for other, place in self.placements.items() if other != name})
        return replace(self, commitments=self.commitments.without(name), placements=kept)

    def begins_in(self, scene: Scene) -> bool:
        """Whether the later moves can be made as planned: all objects are where they are expected."""
        if self.expected is None or not self.later or self.expected.held_names != scene.held_names:
            return False
        pairs = zip(self.expected.objects, scene.objects, strict=True)
        return all(one is other or np.allclose(one.pose, other.pose, atol=_SAME) for one, other in pairs)


def as_plan(candidates: GraspCandidates, scene: Scene, moves: Sequence[Move]) -> ClearancePlan:
    """Turn moves into commitments, up to the first move of an object that moves again later.

    To be put down by the hand that has kept it is no such move. The blockers of each grasp are computed for the scene
    as it is.
    """
    again = [
        any(other.grasp for other in moves[index + 1 :] if other.name == one.name) for index, one in enumerate(moves)
    ]
    count = next((index + 1 for index, moves_again in enumerate(again) if moves_again), len(moves))
    made: dict[str, Move] = {}
    for move in moves[:count]:
        taken = made.pop(move.name, None)
        made[move.name] = move if taken is None else replace(move, grasp=taken.grasp)
    grasps = with_blockers(candidates, scene, [move.grasp for move in made.values() if move.grasp is not None])
    in_hand = [move.name for move in made.values() if move.placement is None]
    target = in_hand[-1] if in_hand else ""
    return ClearancePlan(
        Commitments(
            target,
            tuple(name for name in made if name != target),
            MappingProxyType({grasp.object: grasp for grasp in grasps}),
        ),
        MappingProxyType({name: move.placement for name, move in made.items() if move.placement is not None}),
        aside=in_hand[0] if len(in_hand) > 1 else "",
        general=frozenset(name for name, move in made.items() if move.is_general),
        until=tuple(made),
        steps=tuple(itertools.chain.from_iterable(map(_steps, moves[:count]))),
        expected=moves[count - 1].after if moves else scene,
        later=tuple(moves[count:]),
    )


def _steps(move: Move) -> Iterator[ArmStep]:
    """The pick and the put-down of a move, where it has them."""
    if move.grasp is not None:
        yield ArmStep(move.name, False)
    if move.placement is not None:
        yield ArmStep(move.name, True)
