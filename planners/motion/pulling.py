"""Motion of a hand with a handle: the hand keeps its grasp while a drawer slides or a door turns.

If the base is holonomic and the handle moves horizontally, the base moves with the handle and the arm is still.
Otherwise all movable joints follow by differential inverse kinematics. It uses weighted, damped least squares in small
steps, each corrected until the hand is there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from assets.robots import RobotSpec
from planners.clock import NO_DEADLINE, Deadline
from planners.collision.opened import STEPS, pulled, riding, way, without_moving
from planners.collision.scene_arrays import RobotArrays
from planners.collision.world import OVERLAP, CollisionWorld
from planners.motion.approaches import ContactQuery, free_approach
from planners.motion.arm import plan_home, tcp_poses
from planners.motion.path import BlockedBy, NoPath, WholeBodyPath
from planners.motion.pick_and_place import plan_reach
from planners.motion.pushing import Track, pushed_tracks
from planners.scene import HeldObject, RobotState, Scene
from planners.scene.masks import FIXED_BITS

Array = NDArray[np.float64]

_SLIDE_STEP, _TURN_STEP = 0.005, 0.03
"""Steps [m] and [rad] of the opening part between two configurations of the pull."""
_LEVEL = 1e-6
"""Tolerance, in the entries of a matrix, for a motion in the plane."""
_STEP = 1e-6
"""Difference [m], [rad] for the numerical Jacobian."""
_CORRECTIONS = 8
"""Most corrections of one step."""
_NEAR = 1e-4, 1e-3
"""Tolerances [m] and [rad] of the hand pose."""
_DAMPING = 1e-4
"""Damping of the least squares, in squared metres and radians."""
_BASE_WEIGHT, _TORSO_WEIGHT = 0.6, 0.5
"""Weights of base and torso, relative to the arm's weight of 1."""
_MARGIN = 0.02
"""Margin [rad] or [m] at both ends of a joint's range."""
_MOST = 0.2
"""Largest motion [rad] or [m] of a joint in one step. A larger one is a jump to another arm configuration."""


def followed_ways(robot: RobotSpec, arrays: RobotArrays, start: Array, poses: Array) -> Iterator[Array]:
    """Find whole-body configurations (k, 11) with the hand on a handle, one method after another, the calmest first.

    Args:
        robot: the robot, which determines how the base moves.
        arrays: the same robot for kernels.
        start: (11,) base pose, torso and arm once the fingers have closed.
        poses: (m, 4, 4) TCP poses in the world along the pull, from its start.

    Yields:
        Configurations from the start as far as the hand can follow: m for the whole pull.
    """
    if robot.base_drive == "holonomic":
        driven = _by_base(start, poses)
        if driven is not None:
            yield driven
    if robot.base_drive != "fixed":
        yield _by_joints(robot, arrays, start, poses, with_base=True)
    yield _by_joints(robot, arrays, start, poses, with_base=False)


def _by_base(start: Array, poses: Array) -> Array | None:
    """Move the base rigidly with the hand. None if the hand changes its height or tilts."""
    X = np.tile(start, (len(poses), 1))
    for row, T in zip(X, poses, strict=True):
        moved = T @ np.linalg.inv(poses[0])
        if abs(moved[2, 3]) > _LEVEL or abs(moved[2, 2] - 1.0) > _LEVEL:
            return None
        row[:2] = moved[:2, :2] @ start[:2] + moved[:2, 3]
        row[2] = start[2] + np.arctan2(moved[1, 0], moved[0, 0])
    X[:, 2] = np.unwrap(X[:, 2])
    return X


def _by_joints(robot: RobotSpec, arrays: RobotArrays, start: Array, poses: Array, with_base: bool) -> Array:
    """Follow with all joints, with or without the base. Configurations are returned as far as limits allow."""
    weights = np.ones(len(start))
    weights[:3], weights[3] = (_BASE_WEIGHT if with_base else 0.0), _TORSO_WEIGHT
    # A joint that starts inside the margin may stay there.
    low, high = np.minimum(start[3:], arrays.lower + _MARGIN), np.maximum(start[3:], arrays.upper - _MARGIN)
    lower, upper = np.concatenate([np.full(3, -np.inf), low]), np.concatenate([np.full(3, np.inf), high])
    found = [np.array(start)]
    for T in poses[1:]:
        x = _reached(robot, arrays, found[-1], T, weights, lower, upper)
        if x is None or np.abs(x - found[-1]).max() > _MOST:
            break
        found.append(x)
    return np.array(found)


def _reached(
    robot: RobotSpec, arrays: RobotArrays, x: Array, T: Array, weights: Array, lower: Array, upper: Array
) -> Array | None:
    """Configuration near `x` with the TCP at T (4, 4). None if joint limits prevent it."""
    x, free = x.copy(), weights.copy()
    for _ in range(_CORRECTIONS):
        J, here = _jacobian(robot, arrays, x)
        error = _difference(here, T)
        if np.linalg.norm(error[:3]) < _NEAR[0] and np.linalg.norm(error[3:]) < _NEAR[1]:
            return x
        W = free[:, None] * J.T
        moved = x + W @ np.linalg.solve(J @ W + _DAMPING * np.eye(6), error)
        beyond = (moved < lower) | (moved > upper)
        x, free = np.clip(moved, lower, upper), np.where(beyond, 0.0, free)
    return None


def _jacobian(robot: RobotSpec, arrays: RobotArrays, x: Array) -> tuple[Array, Array]:
    """Jacobian (6, 11) of the TCP in the world, linear rows first, and its pose (4, 4). The base keeps to its drive."""
    varied = np.vstack([x, x + _STEP * np.eye(len(x))])
    T = tcp_poses(arrays, varied)
    J = np.empty((6, len(x)))
    J[:3] = (T[1:, :3, 3] - T[0, :3, 3]).T / _STEP
    for column, pose in enumerate(T[1:]):
        J[3:, column] = _rotation_between(T[0, :3, :3], pose[:3, :3]) / _STEP
    if robot.base_drive == "differential":
        ahead = np.array([np.cos(x[2]), np.sin(x[2])])
        J[:, :2] = np.outer(J[:, :2] @ ahead, ahead)
    return J, T[0]


def _difference(here: Array, there: Array) -> Array:
    """Difference (6,) [m], [rad] from one pose (4, 4) to another, in the world."""
    return np.concatenate([there[:3, 3] - here[:3, 3], _rotation_between(here[:3, :3], there[:3, :3])])


def _rotation_between(one: Array, other: Array) -> Array:
    """Rotation vector (3,) [rad] in the world from one rotation matrix to another one near it."""
    R = other @ one.T
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2
    sine = float(np.linalg.norm(axis))
    angle = np.arctan2(sine, (np.trace(R) - 1) / 2)
    return np.asarray(axis * (angle / sine if sine > 1e-12 else 1.0))


@dataclass(frozen=True, eq=False)
class PullMotion:
    """A motion that grasps a handle, moves a drawer or door, and lets go.

    Attributes:
        transit, approach: the free path and the straight lines before the fingers close.
        pull: the motion of the hand with the handle.
        leave: straight lines of the open gripper away from the handle.
        home: the free path of the arm home, or a standstill if none is found.
        held: the handle as it is held.
        after: the scene once the fingers have opened.
    """

    transit: WholeBodyPath
    approach: WholeBodyPath
    pull: WholeBodyPath
    leave: WholeBodyPath
    home: WholeBodyPath
    held: HeldObject
    after: Scene

    @property
    def paths(self) -> tuple[WholeBodyPath, ...]:
        """Paths without a held object."""
        return self.transit, self.approach, self.leave, self.home


def plan_pull(
    world: CollisionWorld,
    base: ArrayLike,
    start: ArrayLike,
    q_grasp: ArrayLike,
    *,
    rng: np.random.Generator,
    deadline: Deadline = NO_DEADLINE,
) -> PullMotion | BlockedBy | NoPath:
    """Plan to grasp the scene's handle, pull it to the wanted position, let go, and bring the arm home.

    Args:
        world: the compiled scene, with a `pull`.
        base, start, q_grasp, rng, deadline: as for `plan_pick`.

    Returns:
        The motion, the objects in its way, or the reason why clearing does not help.
    """
    scene = world.scene
    assert scene.pull is not None
    reached = plan_reach(world, base, start, q_grasp, scene.pull.handle, rng=rng, deadline=deadline)
    if isinstance(reached, BlockedBy | NoPath):
        return reached
    transit, approach, held = reached
    opening, grasp = scene.opening(scene.pull.opening), approach.configurations[-1]
    T = tcp_poses(world.robot, grasp[None])[0]
    length = abs(scene.pull.position - opening.position)
    steps = max(int(np.ceil(length / (_SLIDE_STEP if opening.kind == "slide" else _TURN_STEP))), 2)
    positions = np.concatenate([[opening.position], way(opening, scene.pull.position, steps)])
    if scene.pull.pushes:
        tracks = list(pushed_tracks(scene, T, positions))
        if not tracks:
            return NoPath("push: the fingers are not before a face that they can push")
    else:
        tracks = list(_pulled_tracks(scene, T, positions))
    refused: list[BlockedBy | NoPath] = []
    ways = ((X, track) for track in tracks for X in followed_ways(scene.robot, world.robot, grasp, track.poses))
    for X, track in ways:
        if len(X) < len(track.poses):
            share = len(X) / len(track.poses)
            refused.append(NoPath(f"pull: the arm follows the handle over {share:.0%} of its way"))
            continue
        blocked = _in_the_way(world, X, track, approach.opening)
        if blocked is not None:
            refused.append(blocked)
            continue
        turned = None if track.turned is None else float(track.turned[-1])
        state = RobotState(X[-1, :3], X[-1, 3:], scene.robot.finger_position(0.0))
        after = pulled(scene, turned=turned).with_state(state)
        if scene.pull.pushes:  # the face may have turned in front of the fingers
            held = HeldObject.grasped(after.body(held.name), tcp_poses(world.robot, X[-1:])[0])
        left = _left(CollisionWorld.from_scene(after), held, rng)
        if isinstance(left, NoPath):
            refused.append(left)
            continue
        return PullMotion(transit, approach, WholeBodyPath(X, 0.0), *left, held, after)
    objects = [one for one in refused if isinstance(one, BlockedBy)]
    return min(objects, key=lambda one: len(one.blockers)) if objects else refused[0]


def _pulled_tracks(scene: Scene, T: Array, positions: Array) -> Iterator[Track]:
    """Paths of a hand that holds a handle at T (4, 4), the better one first.

    If there is a lever, it is turned first. It is let back at the end, since a spring would turn it against the leaving
    hand and push the door shut. Where the hand cannot follow it back, it is let go as it is.
    """
    assert scene.pull is not None
    opening = scene.opening(scene.pull.opening)
    if not scene.pull.lever:
        yield Track(np.array([opening.motion(position) @ T for position in positions]), positions)
        return
    lever = scene.opening(scene.pull.lever)
    steps = max(int(np.ceil(abs(scene.pull.turned - lever.position) / _TURN_STEP)), 2)
    turning = np.concatenate([[lever.position], way(lever, scene.pull.turned, steps)])
    back = turning[-2::-1]
    pulling = positions[1:]
    where = np.concatenate([np.full(len(turning), positions[0]), pulling, np.full(len(back), positions[-1])])
    turned = np.concatenate([turning, np.full(len(pulling), scene.pull.turned), back])
    poses = np.array([opening.motion(at) @ lever.motion(by) @ T for at, by in zip(where, turned, strict=True)])
    kept = len(poses) - len(back)
    yield Track(poses, where, turned)
    yield Track(poses[:kept], where[:kept], turned[:kept])


def _in_the_way(world: CollisionWorld, X: Array, track: Track, gap: float) -> BlockedBy | NoPath | None:
    """Collisions during the pull: with fixed bodies along the whole path, with moving parts at several places.

    The gripper opening is the `gap` [m] of the approach: closed fingers may touch the bracket of the handle.
    """
    scene = world.scene
    assert scene.pull is not None
    opening, along = scene.opening(scene.pull.opening), riding(scene)
    moving = {one.name for one in scene.static_obstacles if one.name in opening.parts}
    hits = CollisionWorld.from_scene(without_moving(scene)).path_hits(X, gap, ignore=scene.mask(along))
    others = scene.mask(scene.names) & ~scene.mask(along) | scene.mask([scene.pull.handle])
    parts = tuple(one for one in scene.static_obstacles if one.name in moving)
    for k in np.unique(np.linspace(0, len(X) - 1, STEPS + 1).round().astype(int))[1:].tolist():
        turned = None if track.turned is None else float(track.turned[k])
        there = pulled(replace(scene, static_obstacles=parts), float(track.positions[k]), turned)
        hits |= CollisionWorld.from_scene(there).hits(X[k, :3], X[k, 3:], gap, ignore=others)
    if hits & FIXED_BITS:
        return NoPath(f"pull: the robot touches {', '.join(world.names_of(hits & FIXED_BITS))}")
    return BlockedBy(frozenset(scene.names_of(hits)), "pull") if hits else None


def _left(
    world: CollisionWorld, held: HeldObject, rng: np.random.Generator
) -> tuple[WholeBodyPath, WholeBodyPath] | NoPath:
    """Paths of the open gripper away from the handle, and of the arm home, after the pull."""
    state = world.scene.state
    query = ContactQuery.release(world, state.base, state.q, held)
    for pattern in query.patterns:
        approach = free_approach(query, pattern)
        if approach is not None:
            leave = WholeBodyPath(approach.empty, query.empty.opening)
            fingers = world.scene.robot.finger_position(leave.opening)
            home = plan_home(world, RobotState(leave.end_base, leave.end, fingers), rng)
            if isinstance(home, WholeBodyPath):
                return leave, home
            if not _is_around(world, leave, held.name):
                return leave, WholeBodyPath(np.repeat(leave.configurations[-1:], 2, axis=0), leave.opening)
    return NoPath("pull: the gripper cannot leave the handle where it is pulled to")


def _is_around(world: CollisionWorld, leave: WholeBodyPath, handle: str) -> bool:
    """Whether the handle is still between the open fingers, so that no motion can begin there with another opening."""
    hits = world.with_padding(-OVERLAP).hits(leave.end_base, leave.end, 0.0)
    return bool(hits >> world.scene.index(handle) & 1)
