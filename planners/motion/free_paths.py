"""Free paths between the start, the hover configuration at the end of the straight lines, and a carry configuration."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planners.collision.world import CollisionWorld
from planners.motion.approaches import Approach, GraspContext
from planners.motion.arm import ArmPath, BlockedBy, NoPath, plan_arm, tcp_pose, unwrap_joints
from planners.motion.arm_query import ArmQuery, RRTConfig
from planners.motion.base import BasePath, plan_base
from planners.motion.whole_body_path import WholeBodyPath
from planners.scene import RobotState
from planners.scene.masks import FIXED_BITS

Array = NDArray[np.float64]

_TORSO_SHARES = (0.5, 1.0)
"""Shares of the torso's travel at which the home configuration of the arm is tried where home itself does not fit."""
_RISES = (0.25, 0.15, 0.05, 0.0)
"""[m] that the torso rises for carrying in the configuration of the arm at hand."""
_SAMPLING = 0.1
"""[m], [rad] of a joint between configurations at which the height of a held object is computed: 1 mm is missed."""

LIFTED = 0.10
"""[m] above where it stood that an object is carried, where that is possible: a target then counts as lifted."""
SAME_BASE = 1e-6
"""[m, rad] by which base poses may differ that count as the same: rounding."""


class Task(NamedTuple):
    """A pick or a placement for which free paths are wanted.

    Attributes:
        context: the grasp or release.
        base: (3,) where the base stands at the start: x [m], y [m], yaw [rad].
        q: (8,) torso [m] and arm [rad] at the start.
        starts_loaded: whether the object is held at the start: a placement.
        rng: for the random trees.
        config: effort of each path.
    """

    context: GraspContext
    base: Array
    q: Array
    starts_loaded: bool
    rng: np.random.Generator
    config: RRTConfig


def carry_configurations(
    world: CollisionWorld,
    query: ArmQuery,
    q_grasp: Array,
    q_hover: Array,
    least_height: float = -np.inf,
    only_home: bool = True,
) -> Array:
    """Configurations (k, 8) in which a motion may end, best first.

    The robot's home configuration where it fits; elsewhere home with another height of the torso, then the
    configuration of the arm at hand, with the torso raised. What fits hits neither static obstacles nor the robot, and
    holds the object high enough, if any of them does.

    Args:
        world: the scene, compiled.
        query: base pose, gripper opening and held object.
        q_grasp: (8,) configuration of the grasp or release; continuous joints end near it at home.
        q_hover: (8,) configuration at the end of the straight lines.
        least_height: [m] of the held object's lowest point.
        only_home: whether the others are left out where home fits and holds the object high enough.
    """
    robot = world.robot
    home = unwrap_joints(robot, q_grasp, world.scene.robot.home)
    if only_home and _fits(world, query, home) and _held_height(world, query, home) >= least_height:
        return home[None]
    torsos = [robot.lower[0] + share * (robot.upper[0] - robot.lower[0]) for share in _TORSO_SHARES]
    rises = [min(q_hover[0] + rise, robot.upper[0]) for rise in _RISES]
    others = [np.array([torso, *home[1:]]) for torso in torsos] + [np.array([torso, *q_hover[1:]]) for torso in rises]
    fitting = [q for q in (home, *others) if _fits(world, query, q)]
    fitting.sort(key=lambda q: _held_height(world, query, q) < least_height)
    return np.array(fitting or [home])


def _fits(world: CollisionWorld, query: ArmQuery, q: Array) -> bool:
    return not world.hits(query.base, q, query.opening, query.held, query.ignore) & FIXED_BITS


def _held_height(world: CollisionWorld, query: ArmQuery, q: Array) -> float:
    """[m] of the held object's lowest point; infinite without one."""
    if query.held is None:
        return np.inf
    T_world_tcp = tcp_pose(world.scene.robot, RobotState(query.base, q, 0.0))
    return world.scene.body(query.held.name).at_pose(T_world_tcp @ query.held.T_tcp_object).bottom


def free_paths(
    task: Task, approach: Approach, find_blockers: bool
) -> tuple[WholeBodyPath, WholeBodyPath] | BlockedBy | NoPath:
    """The free paths to the hover configuration without, and from it with the object.

    They are planned as if the objects that the straight lines hit were gone; these count as blockers.
    """
    paths: list[WholeBodyPath] = []
    blockers = set(task.context.empty.scene.names_of(approach.hits))
    for is_loaded in (False, True):
        path = _free_path(task, approach, is_loaded, find_blockers)
        if isinstance(path, NoPath):
            return path
        if isinstance(path, BlockedBy):
            blockers |= path.blockers
        else:
            paths.append(path)
    if blockers:
        return BlockedBy(frozenset(blockers), approach.phase if approach.hits else "transit")
    return paths[0], paths[1]


def _free_path(
    task: Task, approach: Approach, is_loaded: bool, find_blockers: bool
) -> WholeBodyPath | BlockedBy | NoPath:
    """One of the two; the one at the start of the task begins (with the object: ends) with a drive, if need be."""
    context = task.context
    world, query, lines = (
        (context.loaded, context.loaded_query, approach.loaded)
        if is_loaded
        else (context.empty, context.empty_query, approach.empty)
    )
    hover, q_hover = lines[-1, :3], lines[-1, 3:]
    query = replace(query, base=hover, ignore=context.ignore | approach.hits)
    drive: BasePath | NoPath | None = None
    is_carry = is_loaded != task.starts_loaded
    if not is_carry and np.abs(task.base - hover).max() > SAME_BASE:
        drive = plan_base(world, task.base, hover, task.q, opening=query.opening, held=query.held, rng=task.rng)
    if isinstance(drive, NoPath):
        return drive
    if is_carry:
        path = _carry_path(task, world, query, q_hover, find_blockers)
    else:
        path = _arm_path(task, world, query, q_hover, task.q, find_blockers)
    if not isinstance(path, ArmPath):
        return path
    return WholeBodyPath.joined(drive, path.reversed()).reversed() if is_loaded else WholeBodyPath.joined(drive, path)


def _carry_path(
    task: Task, world: CollisionWorld, query: ArmQuery, q_hover: Array, find_blockers: bool
) -> ArmPath | BlockedBy | NoPath:
    """The path between the hover configuration and a carry configuration.

    One that lowers the held object below the support is taken only if there is no other: so low it counts as lost.
    """
    least = -np.inf if query.held is None else world.scene.body(query.held.name).bottom + LIFTED
    path: ArmPath | BlockedBy | NoPath = NoPath("no carry configuration")
    low: ArmPath | None = None
    for only_home in (True, False):
        for end in carry_configurations(world, query, task.context.q, q_hover, least, only_home):
            path = _arm_path(task, world, query, q_hover, end, find_blockers)
            if not isinstance(path, ArmPath):
                continue
            if not _sinks(world, path):
                return path
            low = low or path
        if low is None:
            return path
    return low or path


def _arm_path(
    task: Task, world: CollisionWorld, query: ArmQuery, q_hover: Array, q: Array, find_blockers: bool
) -> ArmPath | BlockedBy | NoPath:
    """A free path from the hover configuration to another one (8,); without an object in reverse."""
    start, goal = (q, q_hover) if query.held is None else (q_hover, q)
    return plan_arm(world, query, start, goal, rng=task.rng, config=task.config, find_blockers=find_blockers)


def _sinks(world: CollisionWorld, path: ArmPath) -> bool:
    """Whether the held object comes below the top of the support, which it left at the start."""
    query = ArmQuery(path.base, path.opening, path.held)
    return any(_held_height(world, query, q) < world.scene.support.top for q in _sampled(path.waypoints))


def _sampled(waypoints: Array) -> Array:
    """Configurations (k, 8) along straight lines between waypoints (n, 8), `_SAMPLING` apart at most."""
    steps = np.maximum(np.ceil(np.abs(np.diff(waypoints, axis=0)).max(axis=1) / _SAMPLING), 1).astype(int)
    lines = zip(waypoints[:-1], waypoints[1:], steps, strict=True)
    return np.vstack([waypoints[:1], *(np.linspace(start, end, count + 1)[1:] for start, end, count in lines)])
