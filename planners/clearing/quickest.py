"""Quick grasps: from a near base pose, with the arm near home, and with the next object near.

`holding_aside` also saves a put-down: the last obstacle stays in one gripper while another one takes the target. The
paper forbids this: each of its obstacles is put down before the next object is taken.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.clearing.commitments import grasped
from planners.grasping.candidates import GraspCandidate, GraspCandidates
from planners.scene import Scene

Array = NDArray[np.float64]

_TRIED = 8
"""Grasps of one object to offer, quickest first."""
_PAIRS = 12
"""Pairs of grasps by two arms to check, quickest first."""
_BASES = 4
"""Base poses of the obstacle's grasps from which another arm takes the target."""
_CHANGE = 3.0
"""Time [s] that it takes, about, until an arm is at home and another one begins."""
_START = 0.7
"""Time [s] that a base motion takes to speed up and slow down, in addition to its distance at full speed."""


def quickest_first(
    candidates: GraspCandidates, scene: Scene, name: str, following: str = "", is_first: bool = False
) -> Iterator[GraspCandidate]:
    """Find the quickest unblocked grasps of an object, quickest first. Grasps under a shelf are left out.

    Args:
        candidates: source of grasps.
        scene: the scene in which the object is taken.
        name: name of the object.
        following: name of the object that is taken next, "" for none.
        is_first: whether no arm has moved before, so that each of them can begin at once.
    """
    gone = scene.mask([name])
    later = candidates.for_object(scene, following) if following else ()
    bases = [grasp.base for grasp in later if not grasp.blockers & ~gone]

    def cost(grasp: GraspCandidate) -> float:
        """Approximate time [s] to drive there, to take the object and to drive on."""
        onwards = min((_drive_time(scene.robot, grasp.base, base) for base in bases), default=0.0)
        drive = _drive_time(scene.robot, scene.state.base, grasp.base)
        return drive + _arm_time(scene.robot, grasp) + onwards + _change_time(scene.robot, grasp, is_first)

    found = [*candidates.from_base(scene, name, scene.state.base), *candidates.for_object(scene, name)]
    free = [grasp for grasp in found if not grasp.blockers and not grasp.drives]
    return itertools.islice(sorted(free, key=cost), _TRIED)


def move_time(scene: Scene, grasp: GraspCandidate | None, base: Array, q: Array, is_first: bool) -> float:
    """Approximate time [s] to take an object with a grasp and to put it down.

    Args:
        scene: the scene before the move.
        grasp: the grasp. None if the object is in the hand of the active arm.
        base, q: (3,) base pose and (8,) configuration at the put-down.
        is_first: as for `quickest_first`.
    """
    robot = scene.robot
    if grasp is None:
        return _drive_time(robot, scene.state.base, base, True) + _swing_time(robot, robot.arm_name, q)
    drives = _drive_time(robot, scene.state.base, grasp.base) + _drive_time(robot, grasp.base, base, True)
    return drives + _arm_time(robot, grasp) + _swing_time(robot, grasp.arm, q) + _change_time(robot, grasp, is_first)


def holding_aside(
    candidates: GraspCandidates,
    scene: Scene,
    obstacle: GraspCandidate,
    target: GraspCandidate,
    can_take: Callable[[Scene, GraspCandidate], bool],
) -> tuple[GraspCandidate, GraspCandidate] | None:
    """Find grasps of the last obstacle and of the target by different arms. None if the search fails.

    Args:
        candidates: source of grasps.
        scene: the scene with only the last obstacle left to clear.
        obstacle, target: the grasps that one arm alone would use.
        can_take: whether approach to a grasp in a scene, and retreat with the object, are collision-free.
    """
    robot = scene.robot

    def cost(pair: tuple[GraspCandidate, GraspCandidate]) -> float:
        """Approximate time [s] to take both objects."""
        first, second = pair
        drives = _drive_time(robot, scene.state.base, first.base) + _drive_time(robot, first.base, second.base, True)
        return drives + _arm_time(robot, first) + _arm_time(robot, second)

    pairs = sorted(_pairs(candidates, scene, obstacle, target), key=cost)
    for first, second in itertools.islice(pairs, _PAIRS):
        if can_take(scene, first) and can_take(grasped(scene, first), second):
            return first, second
    return None


def _pairs(
    candidates: GraspCandidates, scene: Scene, obstacle: GraspCandidate, target: GraspCandidate
) -> Iterator[tuple[GraspCandidate, GraspCandidate]]:
    """Pairs of a grasp of the last obstacle and a grasp of the target that is free then, by another arm."""
    here = scene.state.base

    def free(chosen: GraspCandidate, gone: int, more: Sequence[GraspCandidate]) -> list[GraspCandidate]:
        """Grasps of one object that are free once the objects of the mask `gone` have left."""
        found = (chosen, *candidates.for_object(scene, chosen.object), *more)
        return [one for one in found if not one.blockers & ~gone and not one.drives]

    firsts = free(obstacle, 0, candidates.from_base(scene, obstacle.object, here))
    quickest = sorted(firsts, key=lambda one: _drive_time(scene.robot, here, one.base) + _arm_time(scene.robot, one))
    bases = itertools.islice({one.base.tobytes(): one.base for one in quickest}.values(), _BASES)
    near = [one for base in bases for one in candidates.from_base(scene, target.object, base)]
    seconds = free(target, scene.mask([obstacle.object]), near)
    yield from ((one, other) for one, other in itertools.product(firsts, seconds) if one.arm != other.arm)


def _drive_time(robot: RobotSpec, start: Array, end: Array, is_loaded: bool = False) -> float:
    """Approximate time [s] of the base from one pose (3,) to another. 0 if it stays."""
    away = float(np.hypot(*(end - start)[:2]))
    turn = abs(float(np.remainder(end[2] - start[2] + np.pi, 2 * np.pi)) - np.pi)
    yaw_rate = min(robot.max_velocity[2], robot.max_loaded_yaw_rate) if is_loaded else robot.max_velocity[2]
    longest = max(away / min(robot.max_velocity[:2]), turn / yaw_rate)
    return longest + _START if longest > 1e-6 else 0.0


def _change_time(robot: RobotSpec, grasp: GraspCandidate, is_first: bool) -> float:
    """Time [s] until the arm of a grasp can begin, since the active arm must be at home."""
    return 0.0 if is_first or grasp.arm in ("", robot.arm_name) else _CHANGE


def _arm_time(robot: RobotSpec, grasp: GraspCandidate) -> float:
    """Time [s] of a grasp's arm from its home configuration to the grasp and back at full speed."""
    return _swing_time(robot, grasp.arm, grasp.q)


def _swing_time(robot: RobotSpec, arm: str, q: Array) -> float:
    """Time [s] of an arm from its home configuration to torso and arm `q` (8,) and back at full speed."""
    spec = robot.using(arm) if arm not in ("", robot.arm_name) else robot
    turns = np.abs(q - np.array(spec.home))
    turns[1:] = np.minimum(turns[1:], np.abs(2 * np.pi - turns[1:]))
    return 2 * float((turns / np.array(spec.max_velocity[3:])).max())
