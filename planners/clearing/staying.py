"""Fewer base motions: a grasp from where the base stands, or from where the next object can be taken too."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

from planners.clearing.commitments import CandidateSource, Commitments
from planners.collision.compiled_scenes import CompiledScenes
from planners.grasping.candidates import GraspCandidate
from planners.motion.pick_and_place import can_take
from planners.scene import Scene

__all__ = ["free_grasps", "is_open", "near_grasps", "with_less_driving"]

_BASES = 5
"""Base poses of one object from which the next one is looked at."""


def with_less_driving(
    source: CandidateSource, compiled: CompiledScenes, scene: Scene, commitments: Commitments, name: str
) -> Commitments:
    """The same commitments with a grasp of one object, the next to be taken, that needs less driving.

    First choice is a grasp from where the base stands; then one from whose base pose the object after it can be taken.

    Args:
        source: of the grasps.
        compiled: scenes compiled so far.
        scene: in which the object is taken.
        commitments: to what remains to be done.
        name: of the object, one that is not held.
    """
    chosen, following = commitments.grasps[name], _next_after(commitments, name)
    if chosen.drives:
        return commitments
    here = next(near_grasps(source, compiled, scene, name, chosen), None)
    if here is not None:
        return commitments.with_grasp(here)
    if following:
        for grasp in itertools.islice(_of_different_bases(free_grasps(source, scene, name), chosen), _BASES):
            later = source.from_base(scene, following, grasp.base)
            if any(other.blockers & ~scene.mask([name]) == 0 for other in later):
                return commitments.with_grasp(grasp)
    return commitments


def near_grasps(
    source: CandidateSource, compiled: CompiledScenes, scene: Scene, name: str, wanted: GraspCandidate
) -> Iterator[GraspCandidate]:
    """The free grasps of an object from where the base stands, those of the wanted arm first.

    The gripper can come to them and leave with the object along straight lines.
    """
    found = [one for one in source.from_base(scene, name, scene.state.base) if not one.blockers and not one.drives]
    for grasp in sorted(found, key=lambda one: (one.arm != wanted.arm, -one.quality)):
        if is_open(compiled, scene, grasp):
            yield grasp


def is_open(compiled: CompiledScenes, scene: Scene, grasp: GraspCandidate) -> bool:
    """Whether the gripper can come to a grasp and leave with the object, the other arms at home with what they hold."""
    return can_take(compiled.world(scene.using(grasp.arm)), grasp.base, grasp.q, grasp.object)


def free_grasps(source: CandidateSource, scene: Scene, name: str) -> list[GraspCandidate]:
    """The grasps of an object that hit nothing and to which the base does not drive with the arm rigid."""
    return [grasp for grasp in source.for_object(scene, name) if not grasp.blockers and not grasp.drives]


def _of_different_bases(grasps: list[GraspCandidate], first: GraspCandidate) -> Iterator[GraspCandidate]:
    """One grasp for each base pose, the best, with `first` before all others."""
    seen: set[bytes] = set()
    for grasp in (first, *grasps):
        if grasp.base.tobytes() not in seen:
            seen.add(grasp.base.tobytes())
            yield grasp


def _next_after(commitments: Commitments, name: str) -> str:
    """The object that is taken after another one, "" after the target."""
    if name == commitments.target:
        return ""
    later = commitments.order[commitments.order.index(name) + 1 :]
    return (*later, commitments.target)[0]
