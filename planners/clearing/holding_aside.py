"""An obstacle that stays in one gripper while another one takes the target: it needs no location.

The paper forbids it: both of its actions that put a held object down are needed before the next pick-up. With two arms
it saves the last put-down, and often a base motion.
"""

from __future__ import annotations

from collections.abc import Iterator

from planners.clearing.commitments import CandidateSource, Commitments
from planners.clearing.staying import free_grasps, is_open
from planners.collision.compiled_scenes import CompiledScenes
from planners.grasping.candidates import GraspCandidate
from planners.scene import Scene

__all__ = ["AfterGrasp", "held_aside"]

from collections.abc import Callable
from itertools import islice
from typing import TypeAlias

AfterGrasp: TypeAlias = Callable[[Scene, GraspCandidate], Scene]
"""The scene after a grasp, with the object in hand and the arm at home."""

_BASES = 6
"""Base poses from which the obstacle is taken that are looked at."""


def held_aside(
    source: CandidateSource, compiled: CompiledScenes, scene: Scene, commitments: Commitments, after: AfterGrasp
) -> Commitments | None:
    """The same commitments, the last obstacle and the target taken by different arms; None if that is not found.

    First pairs of grasps from one base pose are looked at, then any.

    Args:
        source: of the grasps.
        compiled: scenes compiled so far.
        scene: in which all obstacles but the last one are cleared.
        commitments: to the last obstacle and the target.
        after: the scene after a grasp.
    """
    (name,), target = commitments.order, commitments.target
    starts = [
        one for one in _of_different_bases(scene, source, commitments.grasps[name]) if is_open(compiled, scene, one)
    ]
    loaded = [(grasp, after(scene, grasp)) for grasp in starts]
    for grasp, carried in loaded:
        for other in source.from_base(carried, target, carried.state.base):
            if _is_taken(compiled, carried, grasp, other):
                return commitments.with_grasp(grasp).with_grasp(other)
    for grasp, carried in loaded:
        for other in free_grasps(source, carried, target):
            if _is_taken(compiled, carried, grasp, other):
                return commitments.with_grasp(grasp).with_grasp(other)
    return None


def _is_taken(compiled: CompiledScenes, carried: Scene, held: GraspCandidate, grasp: GraspCandidate) -> bool:
    """Whether a grasp of the target is another arm's and free while the obstacle is held."""
    is_other_arm = grasp.arm != held.arm and not grasp.blockers and not grasp.drives
    return is_other_arm and is_open(compiled, carried, grasp)


def _of_different_bases(scene: Scene, source: CandidateSource, first: GraspCandidate) -> Iterator[GraspCandidate]:
    """Grasps of one object from where the base stands, then one for each other base pose and arm."""
    here = [one for one in source.from_base(scene, first.object, scene.state.base) if not one.blockers]
    found: dict[tuple[bytes, str], GraspCandidate] = {}
    for grasp in (*here, first, *free_grasps(source, scene, first.object)):
        if not grasp.drives:
            found.setdefault((grasp.base.tobytes(), grasp.arm), grasp)
    return islice(iter(found.values()), _BASES)
