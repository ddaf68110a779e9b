"""Grasps that take less time: a near base pose, an arm configuration near home, the next object near too."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.clearing.commitments import CandidateSource, Commitments
from planners.collision.world import CompiledScenes, objects_on
from planners.grasping.candidates import GraspCandidate
from planners.motion.pick_and_place import can_take
from planners.scene import Scene
from planners.scene.masks import FIXED_BITS

__all__ = ["Grasps", "arm_time", "drive_time", "is_open", "seen_from", "with_blockers", "with_less_time"]

Array = NDArray[np.float64]

_TRIED = 8
"""Grasps of one object whose straight lines are checked, the quickest first."""
_START = 0.7
"""[s] that a base motion takes beside its way at full speed: it speeds up and slows down."""


class Grasps(NamedTuple):
    """Where grasps come from: their source, and the scenes compiled so far."""

    source: CandidateSource
    compiled: CompiledScenes


def drive_time(robot: RobotSpec, start: Array, end: Array, is_loaded: bool = False) -> float:
    """[s] that the base takes from one pose (3,) to another, about; 0 if it stays."""
    away = float(np.hypot(*(end - start)[:2]))
    turn = abs(float(np.remainder(end[2] - start[2] + np.pi, 2 * np.pi)) - np.pi)
    yaw_rate = min(robot.max_velocity[2], robot.max_loaded_yaw_rate) if is_loaded else robot.max_velocity[2]
    way = max(away / min(robot.max_velocity[:2]), turn / yaw_rate)
    return way + _START if way > 1e-6 else 0.0


def arm_time(robot: RobotSpec, grasp: GraspCandidate) -> float:
    """[s] that the arm of a grasp takes from its home configuration to the grasp and back at full speed."""
    spec = robot.using(grasp.arm) if grasp.arm != robot.arm_name else robot
    turns = np.abs(grasp.q - np.array(spec.home))
    turns[1:] = np.minimum(turns[1:], np.abs(2 * np.pi - turns[1:]))
    return 2 * float((turns / np.array(spec.max_velocity[3:])).max())


def with_less_time(grasps: Grasps, scene: Scene, commitments: Commitments, name: str) -> Commitments:
    """The same commitments with the quickest grasp of one object, the next to be taken, that is free.

    Args:
        grasps: to choose from.
        scene: in which the object is taken.
        commitments: to what remains to be done.
        name: of the object, one that is not held.
    """
    if commitments.grasps[name].drives:
        return commitments
    robot, following = scene.robot, _bases_after(grasps, scene, commitments, name)

    def cost(grasp: GraspCandidate) -> float:
        """[s] to drive there, to take the object and to drive on, about."""
        onwards = min((drive_time(robot, grasp.base, base) for base in following), default=0.0)
        return drive_time(robot, scene.state.base, grasp.base) + arm_time(robot, grasp) + onwards

    found = [*seen_from(grasps, scene, name, scene.state.base), *grasps.source.for_object(scene, name)]
    free = [grasp for grasp in (commitments.grasps[name], *found) if not grasp.blockers and not grasp.drives]
    for grasp in itertools.islice(sorted(free, key=cost), _TRIED):
        if is_open(grasps.compiled, scene, grasp):
            return commitments.with_grasp(grasp)
    return commitments


def seen_from(grasps: Grasps, scene: Scene, name: str, base: Array) -> Sequence[GraspCandidate]:
    """The grasps of an object from one base pose (3,), whatever is in their way."""
    return [grasp for grasp in grasps.source.from_base(scene, name, base) if not grasp.drives]


def is_open(compiled: CompiledScenes, scene: Scene, grasp: GraspCandidate) -> bool:
    """Whether the gripper can come to a grasp and leave with the object, the other arms at home with what they hold."""
    return can_take(compiled.world(scene.using(grasp.arm)), grasp.base, grasp.q, grasp.object)


def with_blockers(grasps: Grasps, scene: Scene, chosen: Iterable[GraspCandidate]) -> list[GraspCandidate]:
    """The same grasps with what is in their way in another scene."""
    found = []
    for grasp in chosen:
        world, own = grasps.compiled.world(scene).for_arm(grasp.arm), scene.mask({grasp.object, *scene.held_names})
        hits = world.hits(grasp.base, grasp.q, grasp.opening, ignore=own) & ~FIXED_BITS
        found.append(replace(grasp, blockers=hits | objects_on(world, grasp.object)))
    return found


def _bases_after(grasps: Grasps, scene: Scene, commitments: Commitments, name: str) -> list[Array]:
    """Base poses (3,) from which the object that follows can be taken once this one is gone; none after the target."""
    if name == commitments.target:
        return []
    later = (*commitments.order[commitments.order.index(name) + 1 :], commitments.target)[0]
    gone = scene.mask([name])
    return [grasp.base for grasp in grasps.source.for_object(scene, later) if not grasp.blockers & ~gone]
