"""Picks and put-downs: free paths and straight lines around one configuration.

A pick follows a free path from the start to a hover configuration, then straight lines to the grasp. It lifts the
object along straight lines, and a free path leads to a carry configuration. A put-down is the reverse. The straight
lines are those of `ContactQuery.patterns`, in that order. If the hover configuration has another base pose than the
start, the free path begins with a drive.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planners.clock import NO_DEADLINE, Deadline
from planners.collision.straight_lines import trace_straight
from planners.collision.world import CollisionWorld
from planners.goals import LIFTED
from planners.motion.approaches import Approach, ContactQuery, free_approach, trace
from planners.motion.arm import ArmQuery, plan_arm, tcp_poses, unwrap_joints
from planners.motion.base import plan_base, unwrap_yaw
from planners.motion.path import SAME_BASE, BlockedBy, NoPath, WholeBodyPath, on_base
from planners.scene import Body, HeldObject
from planners.scene.masks import FIXED_BITS

Array = NDArray[np.float64]

_TORSO_SHARES = (0.5, 1.0)
"""Shares of the torso's travel at which the arm's home configuration is tried if home itself is in collision."""
_RISES = (0.25, 0.15, 0.05, 0.0)
"""Rises [m] of the torso, or else of the arm, for carrying in the present arm configuration."""
_SAMPLING = 0.1
"""Joint step [m], [rad] for computing the height of a held object: 1 mm can be missed."""


@dataclass(frozen=True, eq=False)
class PickPlaceMotion:
    """A pick or a put-down.

    Attributes:
        transit, approach: the free path and the straight lines before the fingers close or open.
        departure, retreat: the straight lines and the free path afterwards. Each path begins where the last one ends.
        held: the object as it is held before or after.
        body: the object at its pose when the fingers close, or once they have opened.
    """

    transit: WholeBodyPath
    approach: WholeBodyPath
    departure: WholeBodyPath
    retreat: WholeBodyPath
    held: HeldObject
    body: Body

    @property
    def paths(self) -> tuple[WholeBodyPath, WholeBodyPath, WholeBodyPath, WholeBodyPath]:
        """The four paths in order of time. The fingers close or open after the second."""
        return self.transit, self.approach, self.departure, self.retreat


def plan_pick(
    world: CollisionWorld,
    base: ArrayLike,
    start: ArrayLike,
    q_grasp: ArrayLike,
    name: str,
    *,
    rng: np.random.Generator,
    ignore: int = 0,
    rises: bool = False,
    deadline: Deadline = NO_DEADLINE,
) -> PickPlaceMotion | BlockedBy | NoPath:
    """Plan to take an object with a given grasp and carry it in the home configuration, or another if needed.

    Args:
        world: the compiled scene.
        base: (3,) base pose when the fingers close.
        start: (8,) start configuration, or (11,) with the base pose first if the base stands elsewhere.
        q_grasp: (8,) configuration when the fingers close.
        name: name of the object.
        rng: for the free paths.
        ignore: mask of objects that are not obstacles.
        rises: whether the arm raises the object if the torso cannot raise it by `LIFTED`, as from a high shelf.
        deadline: when to stop a search for a drive, if the base stands elsewhere.

    Returns:
        The motion, the smallest known set of objects in its way, or the reason why clearing does not help. Continuous
        joints may end whole turns away from home.

    Raises:
        UnknownObject: no such object.
    """
    inside, stand, q_start = _split(world, base, start)
    query = ContactQuery.grasp(world, inside, unwrap_joints(world.robot, q_start, q_grasp), name, ignore)
    return _plan_around(_FreePaths(query, stand, q_start, False, rng, rises, deadline))


def plan_reach(
    world: CollisionWorld,
    base: ArrayLike,
    start: ArrayLike,
    q_grasp: ArrayLike,
    name: str,
    *,
    rng: np.random.Generator,
    deadline: Deadline = NO_DEADLINE,
) -> tuple[WholeBodyPath, WholeBodyPath, HeldObject] | BlockedBy | NoPath:
    """Plan the approach to a grasp only, for a handle that is pulled afterwards.

    Args:
        world, base, start, q_grasp, name, rng, deadline: as for `plan_pick`.

    Returns:
        The free path and the straight lines before the fingers close, and the object as it is then held. Otherwise the
        objects in the way or the reason, as for `plan_pick`.
    """
    inside, stand, q_start = _split(world, base, start)
    query = ContactQuery.grasp(world, inside, unwrap_joints(world.robot, q_start, q_grasp), name)
    free = _FreePaths(query, stand, q_start, False, rng, deadline=deadline)
    for find_blockers in (False, True):
        found: BlockedBy | NoPath = NoPath("no free approach found")
        for pattern in query.patterns:
            approach = free_approach(query, pattern) if not find_blockers else trace(query, pattern)
            if not isinstance(approach, Approach):
                continue
            path = free._path(approach, False, find_blockers)
            if isinstance(path, WholeBodyPath) and not approach.hits:
                lines = WholeBodyPath(approach.empty, query.empty.opening).reversed()
                return path, lines, query.held
            names = frozenset(world.scene.names_of(approach.hits))
            blockers = names | (path.blockers if isinstance(path, BlockedBy) else frozenset())
            if blockers and not isinstance(path, NoPath):
                found = BlockedBy(blockers, approach.phase)
    return found


def plan_place(
    world: CollisionWorld,
    base: ArrayLike,
    start: ArrayLike,
    q_release: ArrayLike,
    held: HeldObject,
    *,
    rng: np.random.Generator,
    find_blockers: bool = True,
    deadline: Deadline = NO_DEADLINE,
) -> PickPlaceMotion | BlockedBy | NoPath:
    """Plan to put down the held object, then move to the robot's home configuration.

    Args:
        world: the compiled scene. The held object's own pose in it is ignored.
        base, start: as for `plan_pick`. The fingers open at `base`.
        q_release: (8,) configuration when the fingers open. It determines the object's final pose.
        held: the held object.
        rng: for the free paths.
        find_blockers: whether to find the objects in the way. If not, the result comes sooner, and is `NoPath` instead
            of `BlockedBy`.
        deadline: as for `plan_pick`.

    Returns:
        As for `plan_pick`.
    """
    inside, stand, q_start = _split(world, base, start)
    query = ContactQuery.release(world, inside, unwrap_joints(world.robot, q_start, q_release), held)
    return _plan_around(_FreePaths(query, stand, q_start, True, rng, deadline=deadline), find_blockers)


def _split(world: CollisionWorld, base: ArrayLike, start: ArrayLike) -> tuple[Array, Array, Array]:
    """Base pose (3,) of the contact, then base pose and configuration (8,) at the start.

    If both base poses agree up to rounding and whole turns, they are made equal. Otherwise whole turns are removed.
    """
    x, inside = np.array(start, dtype=float), np.array(base, dtype=float)
    if len(x) == len(world.robot.lower):
        return inside, inside, x
    inside[2] = unwrap_yaw(inside[2], x[2])
    is_there = np.abs(inside - x[:3]).max() < SAME_BASE
    return (x[:3] if is_there else inside), x[:3], x[3:]


@dataclass(frozen=True, eq=False)
class _FreePaths:
    """Free paths of a pick or put-down: between start, hover and carry configuration."""

    query: ContactQuery
    base: Array  # (3,) base pose at the start
    q: Array  # (8,) torso and arm at the start
    starts_loaded: bool  # a put-down: the object is held at the start
    rng: np.random.Generator
    rises: bool = False
    deadline: Deadline = NO_DEADLINE

    def around(self, approach: Approach, find_blockers: bool) -> PickPlaceMotion | BlockedBy | NoPath:
        """Plan the whole motion with straight lines. Objects in the way are ignored, then returned as blockers."""
        paths: list[WholeBodyPath] = []
        blockers = set(self.query.empty.world.scene.names_of(approach.hits))
        for is_loaded in (False, True):
            path = self._path(approach, is_loaded, find_blockers)
            if isinstance(path, NoPath):
                return path
            if isinstance(path, BlockedBy):
                blockers |= path.blockers
            else:
                paths.append(path)
        if blockers:
            return BlockedBy(frozenset(blockers), approach.phase if approach.hits else "transit")
        empty, loaded = (
            WholeBodyPath(X, query.opening, query.held, query.ignore)
            for X, query in ((approach.empty, self.query.empty), (approach.loaded, self.query.loaded))
        )
        # All paths are planned outwards from the contact, but the free path of the empty gripper ends at the hover.
        free_empty, free_loaded = paths
        if self.starts_loaded:
            in_order = free_loaded.reversed(), loaded.reversed(), empty, free_empty.reversed()
        else:
            in_order = free_empty, empty.reversed(), loaded, free_loaded
        return PickPlaceMotion(*in_order, self.query.held, self.query.body)

    def _path(self, approach: Approach, is_loaded: bool, find_blockers: bool) -> WholeBodyPath | BlockedBy | NoPath:
        """Free path without or with the object. The first one of the motion includes a drive to the hover if needed."""
        query, lines = (self.query.loaded, approach.loaded) if is_loaded else (self.query.empty, approach.empty)
        hover, q_hover = lines[-1, :3], lines[-1, 3:]
        query = replace(query, base=hover, ignore=query.ignore | approach.hits)
        if is_loaded != self.starts_loaded:
            return self._carry_path(query, q_hover, find_blockers)
        drive: WholeBodyPath | NoPath | None = None
        if np.abs(self.base - hover).max() > SAME_BASE:
            drive = plan_base(
                query.world,
                self.base,
                hover,
                self.q,
                opening=query.opening,
                held=query.held,
                rng=self.rng,
                deadline=self.deadline,
            )
        if isinstance(drive, NoPath):
            return drive
        path = self._arm_path(query, q_hover, self.q, find_blockers)
        if drive is None or not isinstance(path, WholeBodyPath):
            return path
        inwards = path.reversed() if is_loaded else path
        joined = replace(path, configurations=np.vstack([drive.configurations, inwards.configurations]))
        return joined.reversed() if is_loaded else joined

    def _carry_path(self, query: ArmQuery, q_hover: Array, find_blockers: bool) -> WholeBodyPath | BlockedBy | NoPath:
        """Path between the hover configuration and a carry configuration.

        A path that lowers the held object below the support is the last choice: so low, an object is regarded as lost.
        """
        scene = query.world.scene
        least = -np.inf if query.held is None else scene.body(query.held.name).bottom + LIFTED
        refuted: BlockedBy | NoPath = NoPath("no carry configuration")
        low: WholeBodyPath | None = None
        for only_home in (True, False):
            for end in _carry_configurations(query, self.query.q, q_hover, least, only_home, self.rises):
                path = self._arm_path(query, q_hover, end, find_blockers)
                if not isinstance(path, WholeBodyPath):
                    refuted = path if isinstance(refuted, NoPath) else refuted
                    continue
                X = path.configurations[:, 3:]
                steps = np.maximum(np.ceil(np.abs(np.diff(X, axis=0)).max(axis=1) / _SAMPLING), 1).astype(int)
                lines = [np.linspace(a, b, n + 1) for a, b, n in zip(X[:-1], X[1:], steps, strict=True)]
                if (_held_heights(query, np.vstack(lines)) >= scene.support.top).all():
                    return path
                low = low or path
            if low is None:
                return refuted
        return low or refuted

    def _arm_path(
        self, query: ArmQuery, q_hover: Array, q: Array, find_blockers: bool
    ) -> WholeBodyPath | BlockedBy | NoPath:
        # Planned inwards without the object and outwards with it, for picks and placements alike.
        start, goal = (q, q_hover) if query.held is None else (q_hover, q)
        return plan_arm(query, start, goal, rng=self.rng, find_blockers=find_blockers)


def _plan_around(free: _FreePaths, find_blockers: bool = True) -> PickPlaceMotion | BlockedBy | NoPath:
    """Plan a motion around the straight lines of each pattern.

    Collision-free patterns come first. Then, with `find_blockers`, the fewest objects in the way over all patterns are
    found, free paths included. A motion may also be found this time.
    """
    query = free.query
    for pattern in query.patterns:
        approach = free_approach(query, pattern)
        found = None if approach is None else free.around(approach, find_blockers=False)
        if isinstance(found, PickPlaceMotion):
            return found
    if not find_blockers:
        return NoPath("no free approach found")
    traced = [(pattern, trace(query, pattern)) for pattern in query.patterns]
    reasons = [f"{pattern.name}: {found}" for pattern, found in traced if isinstance(found, str)]
    approaches = [found for _, found in traced if not isinstance(found, str)]
    blocked: list[BlockedBy] = []
    for approach in sorted(approaches, key=lambda approach: approach.hits.bit_count()):
        if blocked and approach.hits.bit_count() >= min(len(other.blockers) for other in blocked):
            break
        found = free.around(approach, find_blockers=True)
        if isinstance(found, NoPath):
            reasons.append(f"{approach.pattern.name}: {found.reason}")
        elif isinstance(found, BlockedBy):
            blocked.append(found)
        else:
            return found
    if blocked:
        return min(blocked, key=lambda found: (len(found.blockers), sorted(found.blockers)))
    return NoPath("; ".join(dict.fromkeys(reasons)))


def _carry_configurations(
    query: ArmQuery, q_grasp: Array, q_hover: Array, least_height: float, only_home: bool, rises_by_arm: bool
) -> Array:
    """Configurations (k, 8) in which a motion may end, best first.

    The robot's home configuration comes first, then home with other torso heights. Then comes the configuration
    `q_hover` at the end of the straight lines, with a raised torso. All are free of static obstacles and
    self-collision. Those with the object's lowest point above `least_height` [m] come first.

    With `only_home`, home alone is returned if it is free and high enough. With `rises_by_arm`, the arm raises the
    object straight up if no other configuration is high enough. Continuous joints end near `q_grasp` at home.
    """

    def fits(q: Array, mask: int = FIXED_BITS) -> bool:
        return not query.hits(q[None])[0] & mask

    robot = query.world.robot
    home = unwrap_joints(robot, q_grasp, query.world.scene.robot.home)
    if only_home and fits(home, ~0) and _held_heights(query, home[None])[0] >= least_height:
        return home[None]
    torsos = [robot.lower[0] + share * (robot.upper[0] - robot.lower[0]) for share in _TORSO_SHARES]
    rises = [min(q_hover[0] + rise, robot.upper[0]) for rise in _RISES]
    others = [np.array([torso, *home[1:]]) for torso in torsos] + [np.array([torso, *q_hover[1:]]) for torso in rises]
    fitting = [q for q in (home, *others) if fits(q)]
    if rises_by_arm and not any(_held_heights(query, q[None])[0] >= least_height for q in fitting):
        lines = (
            trace_straight(query.world, query.base, q_hover, np.array([0.0, 0.0, 1.0]), rise) for rise in _RISES[:2]
        )
        fitting += [line[-1] for line in lines if line is not None and fits(line[-1])]
    fitting.sort(key=lambda q: _held_heights(query, q[None])[0] < least_height)
    return np.array(fitting or [home])


def _held_heights(query: ArmQuery, Q: Array) -> Array:
    """Heights (k,) [m] of the held object's lowest point in configurations (k, 8), infinite without an object."""
    if query.held is None:
        return np.full(len(Q), np.inf)
    world, body = query.world, query.world.scene.body(query.held.name)
    vertical = (tcp_poses(world.robot, on_base(query.base, Q)) @ query.held.T_tcp_object)[:, 2]
    if body.shape == "pieces":
        up = vertical[:, :3]
        lowest = np.min([up @ piece.position - piece.reach(-up) for piece in body.pieces], axis=0)
        return np.asarray(vertical[:, 3] + lowest)
    half, (x, y, z) = body.half_extents, np.abs(vertical[:, :3].T)
    below = half[0] * x + half[1] * y if body.shape == "box" else half[0] * np.hypot(x, y)
    return np.asarray(vertical[:, 3] - below - half[2] * z)
