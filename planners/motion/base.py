"""Drives between base poses with a fixed arm configuration. The whole robot is checked, not only its footprint."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from assets.robots import RobotSpec
from planners.clock import NO_DEADLINE, Deadline
from planners.collision.ground_map import GroundMap
from planners.collision.world import OVERLAP, STEP, SUPPORT_SLACK, CollisionWorld
from planners.motion.arm import SHORTCUTS
from planners.motion.lattice import NEAR, search_lattice, ways_to
from planners.motion.path import CLEARANCE, NO_WAY, SAME_BASE, NoPath, WholeBodyPath, on_base
from planners.motion.rrt import shortcut
from planners.scene import HeldObject
from planners.scene.masks import FIXED_BITS, SELF_BIT

_RETREATS = (0.0, 0.15, 0.35, 0.6, 0.9)
"""Distances [m] that the base backs away from the table before it drives sideways, in the order of the tries."""
_SPACING, _TURNS = 0.06, 16
"""Spacing [m] of base poses in the lattice, and number of yaws. Passages 0.1 m wider than the robot are found."""
_COARSE_STEP = 0.015
"""Step [m] between checks on the lattice. Accepted drives are checked again at `collision.world.STEP`."""
_MOST_NODES = 100_000
"""Most nodes of the lattice to reach."""

_AWAY, _WAYS, _SIZES = (0.03, 0.08, 0.2, 0.4), 16, 19
"""Distances [m] and number of directions for leaving touched objects, and number of sizes by which these are shrunk."""

CANNOT_MOVE = NoPath("the base cannot move")
OUT_OF_TIME = NoPath("the time was up before a drive was found")
_STANDS = 1e-6
"""Distance [m] below which the base stands still."""
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BaseRoadmap:
    """The ground of a scene, with the results of exhausted searches for drives.

    Attributes:
        ground: its parts that are connected for the base, for any arm configuration.
    """

    ground: GroundMap
    _explored: dict[tuple[int, float, bytes, float, int], tuple[object, Array]] = field(
        default_factory=dict, repr=False
    )

    def search(
        self,
        world: CollisionWorld,
        X: Array,
        opening: float,
        held: HeldObject | None,
        rng: np.random.Generator,
        ignore: int = 0,
        deadline: Deadline = NO_DEADLINE,
    ) -> Array | None:
        """Search a drive (k, 11) between two whole-body configurations (2, 11) on the lattice. None if it fails.

        Once a search has reached everything that is reachable from a start, later searches from there are answered at
        once.
        """
        start, goal, ground = X[0], X[1, :3], self.ground
        # Keep the objects behind the ids alive, so that no other object gets the same id.
        key, kept = (id(world.obstacles), world.padding, start.tobytes(), opening, id(held)), (world.obstacles, held)
        if key in self._explored and not _is_near(self._explored[key][1], goal):
            return None
        checks, ways = (
            world.query(opening, held, ignore, first_only=True),
            ways_to(goal, ground.parts, ground.origin, ground.cell),
        )
        path, reached = search_lattice(
            checks, start, goal, ways, ground.origin, ground.cell, _SPACING, _TURNS, _COARSE_STEP, _MOST_NODES, deadline
        )
        if reached is None:
            return None
        if not len(path):
            self._explored[key] = kept, reached
            return None
        return np.asarray(shortcut(checks, path, STEP, SHORTCUTS, rng))

    def excludes(self, start: Array, base: Array) -> bool:
        """Whether something was explored from a base pose (3,) and all of it leaves out another base pose."""
        here = np.asarray(start, dtype=float).tobytes()
        explored = [poses for key, (_, poses) in self._explored.items() if key[2].startswith(here)]
        return bool(explored) and not any(_is_near(poses, base) for poses in explored)


def _is_near(reached: Array, goal: Array) -> bool:
    """Whether a base pose (3,) can be tried from one of the reached poses (m, 3)."""
    away = np.abs(reached - goal)
    turn = np.abs(np.remainder(away[:, 2] + math.pi, 2 * math.pi) - math.pi)
    return bool(((away[:, :2] <= NEAR * _SPACING).all(axis=1) & (turn <= NEAR * 2 * math.pi / _TURNS)).any())


def plan_base(
    world: CollisionWorld,
    start: ArrayLike,
    goal: ArrayLike,
    q: ArrayLike,
    *,
    opening: float | None = None,
    held: HeldObject | None = None,
    rng: np.random.Generator | None = None,
    roadmap: BaseRoadmap | None = None,
    deadline: Deadline = NO_DEADLINE,
) -> WholeBodyPath | NoPath:
    """Plan a collision-free motion of the base: straight if possible, else backing away first, else on a lattice.

    Motions with `CLEARANCE` from everything come first. A robot that touches objects at the start moves away from them
    first.

    Args:
        world: the compiled scene.
        start: (3,) base pose.
        goal: (3,) base pose. Its yaw may be any number of turns away.
        q: (8,) configuration of torso and arm on the way.
        opening: gripper opening [m]. By default, it is closed around a held object, else fully open.
        held: the held object.
        rng: for shortcuts of drives on the lattice. Default: seed 0.
        roadmap: roadmap of the scene's static obstacles. By default, it is made when needed.
        deadline: when to stop a search on the lattice.

    Returns:
        The path, or the reason why none was found: `NO_WAY` if start and goal are free, but not connected.
    """
    here, there, configuration = (np.array(v, dtype=float) for v in (start, goal, q))
    if opening is None:
        opening = 0.0 if held is not None else world.scene.robot.max_opening
    there[2] = unwrap_yaw(there[2], here[2])
    if world.scene.robot.base_drive == "fixed":
        return _standing(world, on_base(np.stack((here, there)), configuration), opening, held)
    # Torso, arm and held object do not move relative to the base: the robot may be closer to itself than CLEARANCE.
    itself = 1 << SELF_BIT
    wide = world.with_padding(CLEARANCE), itself & ~world.hits(here, configuration, opening, held)
    for padded, ignore in (wide, (world, 0)):
        for waypoints in _simple_paths(here, there):
            X = on_base(driveable(world.scene.robot, waypoints), configuration)
            if not padded.path_hits(X, opening, held, ignore, first_only=True):
                return WholeBodyPath(X, opening, held)
    away = _moved_away(world, here, configuration, opening, held)
    if away is not None:
        onwards = plan_base(
            world, away, there, configuration, opening=opening, held=held, rng=rng, roadmap=roadmap, deadline=deadline
        )
        if isinstance(onwards, NoPath):
            return onwards
        return replace(onwards, configurations=np.vstack([on_base(here, configuration), onwards.configurations]))
    for name, place in (("start", here), ("goal", there)):
        touched = world.hits(place, configuration, opening, held)
        if touched:
            return NoPath(f"drive: the {name} touches {' and '.join(world.names_of(touched))}")
    roadmap, rng = roadmap or BaseRoadmap(GroundMap(world.scene)), rng or np.random.default_rng(0)
    if not roadmap.ground.are_connected(here, there)[0]:
        return NO_WAY
    X = on_base(np.stack((here, there)), configuration)
    for padded, ignore in (wide, (world, 0)):
        if any(padded.hits(place, configuration, opening, held, ignore) for place in (here, there)):
            continue
        path = roadmap.search(padded, X, opening, held, rng, ignore, deadline)
        if path is not None:
            path = on_base(driveable(world.scene.robot, path[:, :3]), configuration)
        if path is not None and not world.path_hits(path, opening, held):
            return WholeBodyPath(path, opening, held)
    return OUT_OF_TIME if deadline.is_over else NO_WAY


def _standing(world: CollisionWorld, X: Array, opening: float, held: HeldObject | None) -> WholeBodyPath | NoPath:
    """Path (2, 11) of a fixed base, only possible if start and goal are the same."""
    if np.abs(X[1, :3] - X[0, :3]).max() > SAME_BASE:
        return CANNOT_MOVE
    touched = world.path_hits(X, opening, held)
    return NoPath(f"{' and '.join(world.names_of(touched))} touched") if touched else WholeBodyPath(X, opening, held)


def _moved_away(world: CollisionWorld, start: Array, q: Array, opening: float, held: HeldObject | None) -> Array | None:
    """Free base pose (3,) near the start, on a straight line away from the objects that the robot touches.

    None if it is free already, if it touches static obstacles, or if the search fails.
    """
    touched = world.hits(start, q, opening, held)
    if not touched or touched & FIXED_BITS:
        return None
    bodies = [world.scene.body(name) for name in world.scene.names_of(touched)]
    for by in np.linspace(0.0, world.padding + SUPPORT_SLACK + OVERLAP, _SIZES)[1:]:
        smaller = world.with_smaller(touched, by)
        if not smaller.hits(start, q, opening, held):
            break
    else:
        return None
    from_them = start[:2] - np.mean([body.position[:2] for body in bodies], axis=0)
    heading = math.atan2(from_them[1], from_them[0])
    for padded in (world.with_padding(CLEARANCE), world):
        for distance in _AWAY:
            for turn in _ways_out(world.scene.robot, start[2] - heading):
                end = start + distance * np.array([math.cos(heading + turn), math.sin(heading + turn), 0.0])
                if not padded.hits(end, q, opening, held, 1 << SELF_BIT) and not smaller.path_hits(
                    on_base(np.stack((start, end)), q), opening, held, first_only=True
                ):
                    return np.asarray(end)
    return None


def _ways_out(robot: RobotSpec, ahead: float) -> list[float]:
    """Directions [rad] in which the base can leave at once, best first. 0 points away, `ahead` is the base's own."""
    if robot.base_drive == "differential":
        return [ahead, ahead + math.pi]
    return sorted(np.arange(_WAYS) * 2 * math.pi / _WAYS, key=lambda turn: -math.cos(turn))


def driveable(robot: RobotSpec, waypoints: Array) -> Array:
    """Waypoints (n, 3) between which a differential base turns on the spot and drives straight ahead or back."""
    if robot.base_drive != "differential":
        return waypoints
    way, last = [waypoints[0]], waypoints[-1]
    for here, there in pairwise(waypoints):
        if math.hypot(*(there[:2] - here[:2])) < _STANDS:
            continue
        yaw, heading = way[-1][2], math.atan2(there[1] - here[1], there[0] - here[0])
        choices = [unwrap_yaw(heading + turn, near) for turn in (0.0, math.pi) for near in (yaw, last[2])]
        heading = min(choices, key=lambda choice: abs(choice - yaw) + abs(last[2] - choice))
        way += [np.array([*way[-1][:2], heading]), np.array([*there[:2], heading])]
    return np.stack([*way, last])


def unwrap_yaw(yaw: float, near: float) -> float:
    """The same yaw [rad], at most half a turn from another one."""
    return near + math.remainder(yaw - near, 2 * math.pi)


def _simple_paths(start: Array, goal: Array) -> Iterator[Array]:
    """Waypoints (n, 3) with the turn on the way, before or after it. Then the same with a retreat first."""
    for retreat in _RETREATS:
        x = min(start[0], goal[0]) - retreat
        first, last = np.array([x, start[1], start[2]]), np.array([x, goal[1], goal[2]])
        if retreat == 0.0:
            yield np.stack((start, goal))
            yield np.stack((start, np.array([*start[:2], goal[2]]), goal))
            yield np.stack((start, np.array([*goal[:2], start[2]]), goal))
        yield np.stack((start, first, last, goal))
        yield np.stack((start, first, np.array([x, start[1], goal[2]]), last, goal))
        yield np.stack((start, first, np.array([x, goal[1], start[2]]), last, goal))
