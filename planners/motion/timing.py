"""Timing of paths: as fast as velocity and acceleration limits of the joints allow, sampled at control steps.

A path is a polygon of whole-body configurations. Each segment and each corner has a known speed limit. A forward and a
backward pass limit the speed by the accelerations. The method is from Bobrow, Dubowsky & Gibson, "Time-optimal control
of robotic manipulators along specified paths", 1985, for a kinematic robot. The controller gets samples, so their first
and second differences must keep the limits. This is checked at the end.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from assets.robots import RobotSpec
from irm.compilation import njit
from irm.kernel_arguments import leaf_kernel
from planners.collision.world import CollisionWorld
from planners.motion.path import WholeBodyPath, cut, interpolate
from planners.motion.pick_and_place import PickPlaceMotion
from planners.motion.pulling import PullMotion
from planners.motion.trajectory import CONTROL_STEP, Phase, Trajectory, join
from planners.scene import SELF_BIT, HeldObject, RobotState, Scene, StaticObstacle

SETTLE_TIME = 0.15
"""Wait [s] after the fingers have closed or opened, before the arm moves on."""
HEADROOM = 0.97
"""Share of the limits that is used. Rounding and the turning base frame need the rest."""
_CORNER_SHARE = 0.75
"""Share of the acceleration for corners. The rest is for speeding up and slowing down."""
_SLOW = 0.25
"""Share of full speed near a wall, and its square of the accelerations. At full speed, an arm lags by 8 mm and a
braking base overshoots by 5 mm. That is more than the `PADDING` left there."""
_PULL = 0.5
"""Share of full speed for opening: weight and friction of the opened part stretch the arm."""
_NEAR = 0.006
"""Distance [m] that is near a wall. Supports are left out: the robot moves across them without collision."""
_TINY = 1e-12
"""Change of direction that is regarded as none."""
_GRID = 0.04
"""Spacing [s] at full speed of the points for which the speed is computed."""
_FINE_GRID = 0.01
"""Spacing [s] at full speed of the points of a smooth path."""
_STRETCHES = 30
"""Most slow-downs of a trajectory until its samples keep the limits."""

Array = NDArray[np.float64]
IsNear: TypeAlias = Callable[[Array], NDArray[np.bool_]]
"""Test of the straight parts between configurations (k, 11) for being near to something: (k - 1,)."""


def time_parametrise(
    X: ArrayLike,
    robot: RobotSpec,
    finger_position: float,
    phase: Phase,
    is_loaded: bool = False,
    is_near: IsNear | None = None,
) -> Trajectory:
    """Compute a trajectory along a polygon of whole-body configurations, at rest at both ends.

    Args:
        X: (k, 11) base x, y, yaw (continuous), torso and arm.
        robot: the robot with its limits.
        finger_position: constant position of a finger [m].
        phase: the phase of this trajectory.
        is_loaded: whether an object is held, by any arm. The base then turns at most at `robot.max_loaded_yaw_rate`.
        is_near: test for straight parts of a path near something, where the robot moves slowly. See `near_walls`.

    Returns:
        Samples every `CONTROL_STEP`, the last one at rest at the end. Their first differences keep the velocity limits,
        their second differences the acceleration limits. For the base, both hold in its own frame.
    """
    path = np.array(X, dtype=float)
    moved = np.abs(np.diff(path, axis=0)).max(axis=1, initial=0.0) > 1e-9
    path = path[np.concatenate([[True], moved])]
    if len(path) == 1:
        return Trajectory.of_states(np.tile(np.append(path[0], finger_position), (2, 1)), phase)
    if robot.base_drive == "differential" and len(path) > 2 and np.ptp(path[:, :3], axis=0).max() > 0:
        # Stop at both ends of every turn and every straight drive.
        drives = np.abs(np.diff(path[:, :3], axis=0)).max(axis=1) > 0
        stops = [0, *(np.flatnonzero(drives[1:] | drives[:-1]) + 1).tolist(), len(path) - 1]
        pieces = [
            time_parametrise(path[one : other + 1], robot, finger_position, phase, is_loaded, is_near).states
            for one, other in pairwise(stops)
        ]
        return Trajectory.of_states(np.vstack([pieces[0], *(piece[1:] for piece in pieces[1:])]), phase)
    velocity, acceleration = HEADROOM * np.array(robot.max_velocity), HEADROOM * np.array(robot.max_acceleration)
    if is_loaded:
        velocity[2] = min(velocity[2], HEADROOM * robot.max_loaded_yaw_rate)
    length, points = _grid(path, velocity)
    is_slow = np.zeros(len(points) - 1, bool)
    if is_near is not None and is_near(path).any():
        is_slow = is_near(points)
    speed = _speeds(length, points, acceleration, is_slow)
    clock = np.concatenate([[0.0], np.cumsum(2 * np.diff(length) / (speed[:-1] + speed[1:]))])
    for _ in range(_STRETCHES):
        samples = _sample(clock, speed, length, points)
        excess = _excess(samples, velocity, acceleration)
        if excess <= 1.0:
            break
        stretch = min(max(np.sqrt(excess), 1.01), 1.5)
        clock, speed = clock * stretch, speed / stretch
    return Trajectory.of_states(np.column_stack([samples, np.full(len(samples), finger_position)]), phase)


def near_walls(world: CollisionWorld, opening: float) -> IsNear:
    """Test for parts of a path where the robot is closer than `_NEAR` to a fixed obstacle that is no support."""
    scene = world.scene
    alone = _among(scene.robot, tuple(body for body in scene.static_obstacles if body.name not in scene.supports))
    return lambda X: alone.edges_that_hit(X, opening, ignore=1 << SELF_BIT)


def _slowed(trajectory: Trajectory, share: float) -> Trajectory:
    """The same motion at a share of its speed."""
    at = np.append(np.arange(0.0, len(trajectory.times) - 1, share), len(trajectory.times) - 1)
    states = interpolate(at, np.arange(len(trajectory.times)), trajectory.states)
    return Trajectory.of_states(states, trajectory.phases[0])


@lru_cache(maxsize=16)
def _among(robot: RobotSpec, walls: tuple[StaticObstacle, ...]) -> CollisionWorld:
    """A robot among walls only, built once for all phases of a plan."""
    home = RobotState(np.zeros(3), np.array(robot.home), 0.0)
    return CollisionWorld.from_scene(Scene(robot, home, (), walls, supports=()), _NEAR)


def round_corners(robot: RobotSpec, X: ArrayLike, half_width: float) -> tuple[Array, Array]:
    """Smooth a polygon of whole-body configurations, with the same ends.

    The mean over a moving window turns corners into parabolas and removes the noise of finely cut curves. Straight
    segments longer than the window stay straight in their middle.

    The length of the path `X` (k, 11) is measured in seconds at the robot's full speed. So is `half_width`, from the
    middle of the window to its edges.

    Returns:
        Configurations (m, 11), and the positions (m,) of the windows' middles on the polygon: 1.5 is half-way between
        X[1] and X[2].
    """
    path = np.asarray(X, dtype=float)
    ends = np.concatenate([[0.0], np.cumsum(_times_at_full_speed(np.diff(path, axis=0), np.array(robot.max_velocity)))])
    count = max(int(np.ceil(ends[-1] / _FINE_GRID)), 1)
    half = min(int(half_width / _FINE_GRID), count // 2)
    length = ends[-1] / count * np.arange(-half, count + half + 1)
    points = interpolate(np.clip(length, 0.0, ends[-1]), ends, path)
    points[:half] = 2 * path[0] - points[2 * half : half : -1]
    points[count + half + 1 :] = 2 * path[-1] - points[count + half - 1 : count - 1 : -1]
    sums = np.cumsum(np.vstack([np.zeros(path.shape[1]), points]), axis=0)
    means = (sums[2 * half + 1 :] - sums[: count + 1]) / (2 * half + 1)
    return means, np.interp(length[half : half + count + 1], ends, np.arange(len(path)))


def drive_trajectory(
    world: CollisionWorld, path: WholeBodyPath, state: RobotState, homing: WholeBodyPath | None = None
) -> Trajectory:
    """Compute the trajectory of a base path with still arm and fingers: the phase "drive".

    If the arm moves home before, its motion comes first: the phases "ready" (the fingers open) and "home".
    """
    robot = world.scene.robot
    if homing is None:
        return _along(world, path, state.finger_position, "drive")
    open_at = state.finger_position if path.held is not None else robot.finger_position(homing.opening)
    return join(
        [
            _fingers(robot, homing.configurations[0], state.finger_position, open_at, _phase("ready", path.held), 0.0),
            _along(world, homing, open_at, "home"),
            _along(world, path, open_at, "drive"),
        ]
    )


def pick_trajectory(world: CollisionWorld, motion: PickPlaceMotion, state: RobotState) -> Trajectory:
    """Compute the trajectory of a pick from a state.

    Its phases are "ready" (the fingers open), "transit", "approach", "close", "lift" and "retreat". The object is held
    from the lift on.
    """
    robot = world.scene.robot
    open_at = robot.finger_position(motion.transit.opening)
    here, grasp = motion.transit.configurations[0], motion.approach.configurations[-1]
    return join(
        [
            _fingers(robot, here, state.finger_position, open_at, Phase("ready", 0.0), 0.0),
            _along(world, motion.transit, open_at, "transit"),
            _along(world, motion.approach, open_at, "approach"),
            _fingers(robot, grasp, open_at, 0.0, Phase("close", 0.0, "", motion.held), SETTLE_TIME),
            _along(world, motion.departure, 0.0, "lift"),
            _along(world, motion.retreat, 0.0, "retreat"),
        ]
    )


def place_trajectory(world: CollisionWorld, motion: PickPlaceMotion, state: RobotState) -> Trajectory:
    """Compute the trajectory of a put-down from a state.

    Its phases are "transit", "lower", "open", "rise" and "retreat". The object is held until the fingers open.
    """
    robot = world.scene.robot
    closed, open_at = state.finger_position, robot.finger_position(motion.departure.opening)
    release = motion.approach.configurations[-1]
    return join(
        [
            _along(world, motion.transit, closed, "transit"),
            _along(world, motion.approach, closed, "lower"),
            _fingers(robot, release, closed, open_at, Phase("open", 0.0, "", motion.held), SETTLE_TIME),
            _along(world, motion.departure, open_at, "rise"),
            _along(world, motion.retreat, open_at, "retreat"),
        ]
    )


def pull_trajectory(world: CollisionWorld, motion: PullMotion, state: RobotState) -> Trajectory:
    """Compute the trajectory of a pull from a state.

    Its phases are "ready", "transit", "approach", "close", "pull", "open", "leave" and "home". The handle is touched
    from when the fingers close on it until they have opened. The pull is slow.
    """
    robot, held = world.scene.robot, motion.held
    open_at, leave_at = (robot.finger_position(path.opening) for path in (motion.transit, motion.leave))
    here, grasp, end = (
        path.configurations[k] for path, k in ((motion.transit, 0), (motion.pull, 0), (motion.pull, -1))
    )
    pull = Phase("pull", 0.0, "", held)
    pulled = _slowed(time_parametrise(motion.pull.configurations, robot, 0.0, pull, is_loaded=True), _PULL)
    return join(
        [
            _fingers(robot, here, state.finger_position, open_at, Phase("ready", 0.0), 0.0),
            _along(world, motion.transit, open_at, "transit"),
            _along(world, motion.approach, open_at, "approach"),
            _fingers(robot, grasp, open_at, 0.0, Phase("close", 0.0, "", held), SETTLE_TIME),
            pulled,
            _fingers(robot, end, 0.0, leave_at, Phase("open", 0.0, "", held), SETTLE_TIME),
            _along(world, motion.leave, leave_at, "leave"),
            _along(world, motion.home, leave_at, "home"),
        ]
    )


def _along(world: CollisionWorld, path: WholeBodyPath, finger_position: float, name: str) -> Trajectory:
    phase, robot = _phase(name, path.held), world.scene.robot
    is_loaded = path.held is not None or bool(world.scene.aside)
    is_near = near_walls(world, path.opening)
    return time_parametrise(path.configurations, robot, finger_position, phase, is_loaded, is_near)


def _phase(name: str, held: HeldObject | None) -> Phase:
    """A phase that touches only the object held throughout, if any."""
    return Phase(name, 0.0, held.name if held is not None else "", held)


def _fingers(robot: RobotSpec, x: Array, start: float, end: float, phase: Phase, settle: float) -> Trajectory:
    """Move the fingers at their own speed while the robot stands, then wait for `settle` [s]."""
    rests = int(np.ceil(settle / CONTROL_STEP - 1e-9))
    fingers = np.concatenate([finger_ramp(robot, start, end), np.full(rests, end)])
    return Trajectory.of_states(np.column_stack([np.tile(x, (len(fingers), 1)), fingers]), phase)


def finger_ramp(robot: RobotSpec, start: float, end: float) -> Array:
    """Positions (n,) [m] of a finger at control steps, at its own speed, both ends included."""
    per_step = HEADROOM * robot.max_finger_velocity * CONTROL_STEP
    return np.linspace(start, end, int(np.ceil(abs(end - start) / per_step - 1e-9)) + 1)


def _times_at_full_speed(moves: Array, velocity: Array) -> Array:
    """Duration [s] of each move (k, 11) at full speed. The base's x and y are taken together."""
    joints = np.abs(moves[:, 2:]) / velocity[2:]
    return np.maximum(np.hypot(moves[:, 0], moves[:, 1]) / velocity[:2].min(), joints.max(axis=1))


def _grid(path: Array, velocity: Array) -> tuple[Array, Array]:
    """Path lengths (m,), in seconds at full speed, and the points (m, 11) there. Corners are on the grid."""
    durations = _times_at_full_speed(np.diff(path, axis=0), velocity)
    fewest = 2 if len(durations) == 1 else 1
    parts = np.maximum(np.ceil(durations / _GRID).astype(int), fewest)
    at = cut(parts)
    length = np.interp(at, np.arange(len(path)), np.concatenate([[0.0], np.cumsum(durations)]))
    return length, interpolate(at, np.arange(len(path)), path)


@leaf_kernel
def _share_of(acceleration: Array, vector: Array) -> float:
    """Largest share of its joint's acceleration that a vector (11,) needs. The base's x and y are taken together."""
    share = math.hypot(vector[0], vector[1]) / min(acceleration[0], acceleration[1])
    for joint in range(2, vector.shape[0]):
        share = max(share, abs(vector[joint]) / acceleration[joint])
    return share


@njit(cache=True)
def _speeds(length: Array, points: Array, acceleration: Array, is_slow: NDArray[np.bool_]) -> Array:
    """Speed along the path (m,), in seconds at full speed per second.

    It is at most 1, `_SLOW` where `is_slow` (m - 1,), and 0 at the ends. Corners need a part of the acceleration, and
    so does driving while the base turns. The rest at full speed is left for speeding up and slowing down.
    """
    m, d, planar = points.shape[0], points.shape[1], min(acceleration[0], acceleration[1])
    direction, steps, turn = np.empty((m - 1, d)), np.empty(m - 1), np.empty(d)
    squared, at_corners, shares, gain = np.ones(m), np.zeros(m), np.empty(m - 1), np.empty(m - 1)
    for i in range(m - 1):
        steps[i] = length[i + 1] - length[i]
        for joint in range(d):
            direction[i, joint] = (points[i + 1, joint] - points[i, joint]) / steps[i]
    for i in range(1, m - 1):
        for joint in range(d):
            turn[joint] = direction[i, joint] - direction[i - 1, joint]
        need, step = max(_share_of(acceleration, turn), _TINY), 0.5 * (steps[i - 1] + steps[i])
        at_corners[i] = max(need / CONTROL_STEP, need / step)
        squared[i] = min((_CORNER_SHARE * CONTROL_STEP / need) ** 2, _CORNER_SHARE * step / need, 1.0)
    for i in range(m - 1):
        slower = _SLOW**2 if is_slow[i] else 1.0
        swing = math.hypot(direction[i, 0], direction[i, 1]) * abs(direction[i, 2]) / planar
        most = min(_CORNER_SHARE / max(swing, _TINY), slower)
        squared[i], squared[i + 1] = min(squared[i], most), min(squared[i + 1], most)
        shares[i] = max(at_corners[i], at_corners[i + 1], swing)
        gain[i] = 2 * steps[i] / _share_of(acceleration, direction[i]) * slower
    squared[0] = squared[m - 1] = 0.0
    for i in range(m - 1):
        spare = 1.0 - min(shares[i] * squared[i], _CORNER_SHARE)
        squared[i + 1] = min(squared[i + 1], squared[i] + spare * gain[i])
    for i in range(m - 2, -1, -1):
        spare = 1.0 - min(shares[i] * squared[i + 1], _CORNER_SHARE)
        squared[i] = min(squared[i], squared[i + 1] + spare * gain[i])
    return np.sqrt(squared)


@njit(cache=True)
def _sample(clock: Array, speed: Array, length: Array, points: Array) -> Array:
    """Points (n, 11) at control steps to the end of the path, with uniform acceleration between grid points."""
    m, end, piece = points.shape[0], clock[-1], 0
    samples = np.empty((math.ceil(end / CONTROL_STEP - 1e-9) + 1, points.shape[1]))
    for row in range(samples.shape[0]):
        now = CONTROL_STEP * row
        while piece < m - 2 and clock[piece + 1] <= now:
            piece += 1
        since, span = min(now, end) - clock[piece], clock[piece + 1] - clock[piece]
        way = speed[piece] * since + 0.5 * (speed[piece + 1] - speed[piece]) / span * since**2
        at = min(max(length[piece] + way, length[piece]), length[piece + 1])
        for joint in range(points.shape[1]):
            start, stop = points[piece, joint], points[piece + 1, joint]
            slope = (stop - start) / (length[piece + 1] - length[piece])
            samples[row, joint] = stop if at >= length[piece + 1] else slope * (at - length[piece]) + start
    return samples


def _excess(samples: Array, velocity: Array, acceleration: Array) -> float:
    """Largest factor by which the limits are exceeded: squared for velocities, plain for accelerations."""
    rates = np.diff(samples, axis=0) / CONTROL_STEP
    c, s = np.cos(samples[:-1, 2]), np.sin(samples[:-1, 2])
    rates[:, 0], rates[:, 1] = c * rates[:, 0] + s * rates[:, 1], c * rates[:, 1] - s * rates[:, 0]
    padded = np.vstack([np.zeros(samples.shape[1]), rates, np.zeros(samples.shape[1])])
    changes = np.diff(padded, axis=0) / CONTROL_STEP
    too_fast = (np.abs(rates) / velocity).max(initial=0.0) ** 2
    return float(max(too_fast, (np.abs(changes) / acceleration).max(initial=0.0)))
