"""An obstacle that stays in one gripper while another one takes the target: it needs no location.

The paper forbids it: each of its obstacles is put down before the next object is taken. With two arms it saves the last
put-down.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import TypeAlias

from planners.clearing.commitments import Commitments
from planners.clearing.saving_time import Grasps, arm_time, drive_time, is_open, seen_from
from planners.grasping.candidates import GraspCandidate
from planners.scene import Scene

__all__ = ["AfterGrasp", "held_aside"]

AfterGrasp: TypeAlias = Callable[[Scene, GraspCandidate], Scene]
"""The scene after a grasp, with the object in hand and the arm at home."""

_PAIRS = 12
"""Pairs of grasps that are checked, the quickest first."""
_BASES = 4
"""Base poses of the obstacle's grasps from which grasps of the target are looked for."""


def held_aside(grasps: Grasps, scene: Scene, commitments: Commitments, after: AfterGrasp) -> Commitments | None:
    """The same commitments, the last obstacle and the target taken by different arms; None if that is not found.

    Args:
        grasps: to choose from.
        scene: in which all obstacles but the last one are cleared.
        commitments: to the last obstacle and the target.
        after: the scene after a grasp.
    """
    robot = scene.robot

    def cost(pair: tuple[GraspCandidate, GraspCandidate]) -> float:
        """[s] to take both objects, about."""
        first, second = pair
        way = drive_time(robot, scene.state.base, first.base) + drive_time(robot, first.base, second.base, True)
        return way + arm_time(robot, first) + arm_time(robot, second)

    for first, second in itertools.islice(sorted(_pairs(grasps, scene, commitments), key=cost), _PAIRS):
        if is_open(grasps.compiled, scene, first) and is_open(grasps.compiled, after(scene, first), second):
            return commitments.with_grasp(first).with_grasp(second)
    return None


def _pairs(grasps: Grasps, scene: Scene, commitments: Commitments) -> Iterator[tuple[GraspCandidate, GraspCandidate]]:
    """Grasps of the last obstacle, each with those of the target through another arm that are free then."""
    (name,), target, here = commitments.order, commitments.target, scene.state.base
    firsts = _of_object(grasps, scene, commitments.grasps[name], 0, seen_from(grasps, scene, name, here))
    quickest = sorted(firsts, key=lambda one: drive_time(scene.robot, here, one.base) + arm_time(scene.robot, one))
    bases = {one.base.tobytes(): one.base for one in quickest}
    near = [one for base in itertools.islice(bases.values(), _BASES) for one in seen_from(grasps, scene, target, base)]
    seconds = _of_object(grasps, scene, commitments.grasps[target], scene.mask([name]), near)
    for first, second in itertools.product(firsts, seconds):
        if first.arm != second.arm:
            yield first, second


def _of_object(
    grasps: Grasps, scene: Scene, chosen: GraspCandidate, gone: int, more: Sequence[GraspCandidate]
) -> list[GraspCandidate]:
    """The grasps of one object that are free once those of the mask `gone` are."""
    found = (chosen, *grasps.source.for_object(scene, chosen.object), *more)
    return [one for one in found if not one.blockers & ~gone and not one.drives]
