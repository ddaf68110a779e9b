"""Two variants of planning ahead that choose other grasps for the same objects, so that a plan takes less time.

`with_less_time`: a near base pose, an arm configuration near home, the next object near too. `held_aside`: the last
obstacle stays in one gripper while another one takes the target. The paper forbids that: each of its obstacles is put
down before the next object is taken. With two arms it saves the last put-down.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.clearing.commitments import ClearingProblem, Commitments, grasped
from planners.collision.world import objects_on
from planners.grasping.candidates import GraspCandidate
from planners.motion.approaches import can_take
from planners.scene import Scene
from planners.scene.masks import FIXED_BITS

Array = NDArray[np.float64]

_TRIED = 8
"""Grasps of one object whose straight lines are checked, the quickest first."""
_PAIRS = 12
"""Pairs of grasps by two arms that are checked, the quickest first."""
_BASES = 4
"""Base poses of the obstacle's grasps from which another arm's grasps of the target are looked for."""
_START = 0.7
"""[s] that a base motion takes beside its distance at full speed: it speeds up and slows down."""


def with_less_time(problem: ClearingProblem, scene: Scene, commitments: Commitments, name: str) -> Commitments:
    """The same commitments with the quickest grasp of one object, the next to be taken, that is free.

    Args:
        problem: where grasps come from.
        scene: in which the object is taken.
        commitments: to what remains to be done.
        name: of the object, one that is not held.
    """
    if commitments.grasps[name].drives:
        return commitments
    following: list[Array] = []
    if name != commitments.target:
        later = (*commitments.order[commitments.order.index(name) + 1 :], commitments.target)[0]
        gone = scene.mask([name])
        following = [grasp.base for grasp in problem.grasps(scene, later) if not grasp.blockers & ~gone]

    def cost(grasp: GraspCandidate) -> float:
        """[s] to drive there, to take the object and to drive on, about."""
        onwards = min((_drive_time(scene.robot, grasp.base, base) for base in following), default=0.0)
        return _drive_time(scene.robot, scene.state.base, grasp.base) + _arm_time(scene.robot, grasp) + onwards

    found = [*problem.grasps_from(scene, name, scene.state.base), *problem.grasps(scene, name)]
    free = [grasp for grasp in (commitments.grasps[name], *found) if not grasp.blockers and not grasp.drives]
    for grasp in itertools.islice(sorted(free, key=cost), _TRIED):
        if _is_open(problem, scene, grasp):
            return commitments.with_grasp(grasp)
    return commitments


def held_aside(problem: ClearingProblem, scene: Scene, commitments: Commitments) -> Commitments | None:
    """The same commitments, the last obstacle and the target taken by different arms; None if that is not found.

    Args:
        problem: where grasps come from.
        scene: in which all obstacles but the last one are cleared.
        commitments: to the last obstacle and the target.
    """
    robot = scene.robot

    def cost(pair: tuple[GraspCandidate, GraspCandidate]) -> float:
        """[s] to take both objects, about."""
        first, second = pair
        drives = _drive_time(robot, scene.state.base, first.base) + _drive_time(robot, first.base, second.base, True)
        return drives + _arm_time(robot, first) + _arm_time(robot, second)

    for first, second in itertools.islice(sorted(_pairs(problem, scene, commitments), key=cost), _PAIRS):
        if _is_open(problem, scene, first) and _is_open(problem, grasped(scene, first), second):
            return commitments.with_grasp(first).with_grasp(second)
    return None


def with_blockers(problem: ClearingProblem, chosen: Iterable[GraspCandidate]) -> list[GraspCandidate]:
    """The same grasps with what is in their way in the problem's scene."""
    scene, found = problem.scene, []
    for grasp in chosen:
        world = problem.candidates.compiled.world(scene).for_arm(grasp.arm)
        own = scene.mask({grasp.object, *scene.held_names})
        hits = world.hits(grasp.base, grasp.q, grasp.opening, ignore=own) & ~FIXED_BITS
        found.append(replace(grasp, blockers=hits | objects_on(world, grasp.object)))
    return found


def _pairs(
    problem: ClearingProblem, scene: Scene, commitments: Commitments
) -> Iterator[tuple[GraspCandidate, GraspCandidate]]:
    """Grasps of the last obstacle, each with those of the target through another arm that are free then."""
    (name,), target, here = commitments.order, commitments.target, scene.state.base

    def of_object(chosen: GraspCandidate, gone: int, more: Sequence[GraspCandidate]) -> list[GraspCandidate]:
        """The grasps of one object that are free once those of the mask `gone` are."""
        found = (chosen, *problem.grasps(scene, chosen.object), *more)
        return [one for one in found if not one.blockers & ~gone and not one.drives]

    firsts = of_object(commitments.grasps[name], 0, problem.grasps_from(scene, name, here))
    quickest = sorted(firsts, key=lambda one: _drive_time(scene.robot, here, one.base) + _arm_time(scene.robot, one))
    bases = itertools.islice({one.base.tobytes(): one.base for one in quickest}.values(), _BASES)
    near = [one for base in bases for one in problem.grasps_from(scene, target, base)]
    seconds = of_object(commitments.grasps[target], scene.mask([name]), near)
    yield from ((one, other) for one, other in itertools.product(firsts, seconds) if one.arm != other.arm)


def _is_open(problem: ClearingProblem, scene: Scene, grasp: GraspCandidate) -> bool:
    """Whether the gripper can come to a grasp and leave with the object, the other arms at home with what they hold."""
    world = problem.candidates.compiled.world(scene.using(grasp.arm))
    return can_take(world, grasp.base, grasp.q, grasp.object)


def _drive_time(robot: RobotSpec, start: Array, end: Array, is_loaded: bool = False) -> float:
    """[s] that the base takes from one pose (3,) to another, about; 0 if it stays."""
    away = float(np.hypot(*(end - start)[:2]))
    turn = abs(float(np.remainder(end[2] - start[2] + np.pi, 2 * np.pi)) - np.pi)
    yaw_rate = min(robot.max_velocity[2], robot.max_loaded_yaw_rate) if is_loaded else robot.max_velocity[2]
    longest = max(away / min(robot.max_velocity[:2]), turn / yaw_rate)
    return longest + _START if longest > 1e-6 else 0.0


def _arm_time(robot: RobotSpec, grasp: GraspCandidate) -> float:
    """[s] that the arm of a grasp takes from its home configuration to the grasp and back at full speed."""
    spec = robot.using(grasp.arm) if grasp.arm != robot.arm_name else robot
    turns = np.abs(grasp.q - np.array(spec.home))
    turns[1:] = np.minimum(turns[1:], np.abs(2 * np.pi - turns[1:]))
    return 2 * float((turns / np.array(spec.max_velocity[3:])).max())
