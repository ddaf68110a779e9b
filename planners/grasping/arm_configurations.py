"""Arm configurations for gripper poses, and what each of them hits: the scan behind grasps and placements."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.chain import ArmChain, pose_of
from irm.ik.solvers import free_angles, solver_arrays
from irm.kernel_arguments import packed
from planners.collision.driven_world import DriveWorlds, drive_worlds
from planners.collision.scene_arrays import RobotArrays
from planners.collision.world import CollisionWorld
from planners.grasping.scan_kernel import Few, make_memory, many_configuration_hits, many_gripper_hits, scan
from planners.scene import SELF_BIT, Body, HeldObject
from planners.scene.cover import (
    BACK,
    LEAST_LIFT,
    direction_out,
    distances_out,
    driven_out_of,
    needs_drive,
    objects_before,
)
from planners.scene.masks import FIXED_BITS

Array = NDArray[np.float64]
_TORSO_STEP, _ABOUT_HOME = 0.05, 24
"""[m] between torso heights about home, and angles of the free joint about home in a full turn: 15° apart."""
_HEIGHT_AND_PITCH = (5, 1)
"""Axis numbers of a joint that slides along z and of a hinge about y, as in `irm.chain.ArmChain`."""
_OFF_LIMIT = 0.002
"""[m] that the torso keeps from its lower limit where it is down."""
_SAME_DRIVE = 9
"""Decimals of yaws [rad] and directions that count as the same."""


class GripperPoses(NamedTuple):
    """k pairs of a base pose and a gripper pose.

    Attributes:
        bases: (k, 3) x [m], y [m], yaw [rad].
        gripper_poses: (k, 5) TCP x, y, z [m], yaw and pitch [rad]: the orientation is Rz(yaw) Ry(pitch), so that a
            positive pitch points down and the fingers always close along a level line.
    """

    bases: Array
    gripper_poses: Array


class ConfigurationGrid(NamedTuple):
    """Values of the two free parameters of the closed form.

    Attributes:
        torsos: (t,) heights of the torso [m].
        rolls: (r,) angles of the arm's free joint [rad], Fetch's upper-arm roll; see
            `irm.ik.solutions.free_angles`.
        nearest_home: of the configurations for one gripper pose only the one nearest to the home configuration counts.
            A robot that follows TCP poses ends up there, as its controller keeps the joints near home.
        home: the configuration that counts as home; None for the robot's own.
    """

    torsos: Array
    rolls: Array
    nearest_home: bool = False
    home: Array | None = None

    @classmethod
    def over(cls, chain: ArmChain, torsos: int = 6, rolls: int = 18) -> ConfigurationGrid:
        """Evenly spaced torso heights, off the limits, and angles of the free joint."""
        heights = np.unique(np.linspace(chain.lower[0], chain.upper[0], torsos + 2)[1:-1])
        return cls(np.asarray(heights, np.float64), free_angles(chain, rolls))

    @classmethod
    def to_the_limits(cls, chain: ArmChain, torsos: int = 12, rolls: int = 36) -> ConfigurationGrid:
        """A finer grid, down to the lower limit of the torso, for what is held low and not lifted."""
        lower, upper = chain.lower[0], chain.upper[0]
        heights = np.unique(np.linspace(lower + min(_OFF_LIMIT, (upper - lower) / 2), upper, torsos + 1)[:-1])
        return cls(np.asarray(heights, np.float64), free_angles(chain, rolls))

    @classmethod
    def near_home(cls, chain: ArmChain) -> ConfigurationGrid:
        """A finer grid for robots that follow TCP poses; `nearest_home` is set."""
        return cls.over(chain, torsos=10, rolls=36)._replace(nearest_home=True)

    @classmethod
    def about_home(cls, chain: ArmChain, home: Sequence[float]) -> ConfigurationGrid:
        """Torso heights and angles of the free joint that include those of a `home`; `nearest_home` is set.

        Heights are 5 cm apart, those off the limits by less than half of it left out; angles 15° apart.
        """
        steps = np.arange(-np.ceil((chain.upper[0] - chain.lower[0]) / _TORSO_STEP), 0) * _TORSO_STEP
        heights = home[0] + np.concatenate(([0.0], np.column_stack((steps, -steps))[::-1].ravel()))
        inside = (heights >= chain.lower[0] + _TORSO_STEP / 2) & (heights <= chain.upper[0] - _TORSO_STEP / 2)
        free, angles = solver_arrays(chain).free, free_angles(chain, _ABOUT_HOME)
        if free >= 0:
            turns = np.arange(1, _ABOUT_HOME // 2) * (2 * np.pi / _ABOUT_HOME)
            angles = home[free] + np.concatenate(([0.0], np.column_stack((turns, -turns)).ravel(), [np.pi]))
            angles = angles[(angles >= chain.lower[free]) & (angles <= chain.upper[free])]
        grid = np.asarray(heights[inside], np.float64), np.asarray(angles, np.float64)
        return cls(*grid, nearest_home=True, home=np.array(home, np.float64))


class ArmConfigurations(NamedTuple):
    """m arm configurations.

    Attributes:
        q: (m, 8) torso [m] and arm [rad].
        pair: (m,) index of the pair of base pose and gripper pose.
        hits: (m,) objects hit, as masks.
        quality: (m,) larger is better.
    """

    q: Array
    pair: NDArray[np.int64]
    hits: NDArray[np.uint64]
    quality: Array


def scan_configurations(
    world: CollisionWorld,
    poses: GripperPoses,
    grid: ConfigurationGrid,
    opening: float,
    *,
    body: Body | None = None,
    held: HeldObject | None = None,
    ignore: int = 0,
    first_free: bool = False,
    known: Collection[int] = (),
    few: Few | None = None,
) -> ArmConfigurations:
    """Arm configurations that hit no static obstacle, not the robot itself, and as few objects as possible.

    A base pose is left out if the robot in its home configuration would hit a static obstacle there. A configuration is
    left out if another one hits only a part of what it hits. Of those with the same hits, the best are kept by quality:
    manipulability, more for a high elbow, less for travel from the home configuration.

    Under a shelf the base drives straight in and out with the arm rigid; see `cover.drive_out`. Hits are then those of
    the configuration, of the drive, and of the object `body`, moved out. A base pose is left out if outside, where the
    base drives in from, the robot would hit a static obstacle with what it holds, both as it carries it and at home.

    Args:
        world: the scene, compiled.
        poses: pairs of base pose and gripper pose to try.
        grid: free parameters to try for each.
        opening: of the gripper [m].
        body: the object that is grasped or put down, where it then stands; None if no shelf can be above it.
        held: the held object.
        ignore: mask of bits that do not count.
        first_free: stop after the first pair, in the order given, for which some configuration hits nothing.
        known: masks of other configurations; what hits more than one of them is left out.
        few: to find new masks of few objects alone.
    """
    parts: list[ArmConfigurations] = []
    for drive, rows in _drives(world, body, poses, held, ignore):
        chosen = poses if drive is None else GripperPoses(poses.bases[rows], poses.gripper_poses[rows])
        found = _scan(world, drive, chosen, grid, opening, held, ignore, first_free, known, few)
        found = found._replace(pair=rows[found.pair])
        if drive is None or (first_free and len(found.q)):
            return found
        parts.append(found)
    none = np.zeros(0, np.int64)
    parts.append(ArmConfigurations(np.zeros((0, len(world.robot.lower))), none, np.zeros(0, np.uint64), np.zeros(0)))
    return ArmConfigurations(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def hits_of(
    world: CollisionWorld, poses: GripperPoses, Q: Array, opening: float, body: Body, ignore: int
) -> NDArray[np.uint64]:
    """What configurations `Q` (k, n) that grasp an object hit, as `scan_configurations` counts it: masks (k,)."""
    masks = np.zeros(len(Q), np.uint64)
    for drive, rows in _drives(world, body, poses, None, ignore):
        inside, driven = (world, world) if drive is None else drive.worlds
        shift, before = (np.zeros((0, 2)), 0) if drive is None else (_rows(drive.shift), drive.before)
        queries = (one.query(opening, None, ignore) for one in (inside, driven))
        masks[rows] = many_configuration_hits(*queries, shift, _rows(poses.bases[rows]), _rows(Q[rows])) | before
    return masks


class _Driven(NamedTuple):
    """A drive out after backing off, for k pairs of poses: its worlds, `shift` (k, 2) [m] from each base pose to where
    it begins, and the mask of what the object would touch on the way (k,)."""

    worlds: DriveWorlds
    shift: Array
    before: NDArray[np.uint64]


def _drives(
    world: CollisionWorld, body: Body | None, poses: GripperPoses, held: HeldObject | None, ignore: int
) -> Iterator[tuple[_Driven | None, NDArray[np.int64]]]:
    """The drives out of where an object stands, one for each side, and the rows of the poses; None: no drive."""
    if body is None or not needs_drive(world.scene, body.foot):
        yield None, np.arange(len(poses.bases))
        return
    support, yaws = driven_out_of(world.scene, body), poses.gripper_poses[:, 3]
    shifts = -BACK * np.column_stack((np.cos(yaws), np.sin(yaws)))
    directions = direction_out(support, poses.bases).round(_SAME_DRIVE)
    for direction in np.unique(directions, axis=0):
        rows = np.flatnonzero((directions == direction).all(axis=1))
        distances = np.array(distances_out(support, poses.gripper_poses[rows, :2] + shifts[rows], direction))
        if held is not None:
            outside = poses.bases[rows]
            outside[:, :2] += shifts[rows] + np.outer(distances, direction)
            fits = _fit_outside(world, held, outside)
            rows, distances = rows[fits], distances[fits]
        if len(rows):
            before = objects_before(world.scene, body, shifts[rows], direction) & ~np.uint64(ignore)
            left = body if held is None else None
            worlds = drive_worlds(world, direction, float(distances.max()), LEAST_LIFT, left)
            yield _Driven(worlds, shifts[rows], before), rows


def _scan(
    world: CollisionWorld,
    drive: _Driven | None,
    poses: GripperPoses,
    grid: ConfigurationGrid,
    opening: float,
    held: HeldObject | None,
    ignore: int,
    first_free: bool,
    known: Collection[int],
    few: Few | None,
) -> ArmConfigurations:
    """The scan where the robot stands, or there and on a drive."""
    bases, gripper_poses = _rows(poses.bases), _rows(poses.gripper_poses)
    inside, driven, shift = (world, world, np.zeros((0, 2))) if drive is None else (*drive.worlds, _rows(drive.shift))
    by_gripper = gripper_hits(inside, gripper_poses, opening, held=held, ignore=ignore)
    if drive is not None:
        backed_off = gripper_poses.copy()
        backed_off[:, :2] += shift
        by_gripper |= gripper_hits(driven, backed_off, opening, held=held, ignore=ignore) | drive.before
    query = inside.query(opening, held, ignore, first_free)
    home = np.array(world.scene.robot.home) if grid.home is None else grid.home
    on_drive = driven.query(opening, held, ignore, first_free)
    # Those whose gripper hits fewest objects come first: what they find rules out most of the others.
    by_hits = np.argsort(np.bitwise_count(by_gripper & ~np.uint64(FIXED_BITS)), kind="stable")
    order = np.arange(len(bases)) if first_free else by_hits
    memory, (torsos, rolls, nearest_home, _) = make_memory(query, known, few), grid
    scan(query, on_drive, shift, memory, home, bases, gripper_poses, by_gripper, order, torsos, rolls, nearest_home)
    kept, rows = memory.kept, np.flatnonzero(memory.kept.pair[: memory.kept.size[0]] >= 0)
    return ArmConfigurations(kept.q[rows], kept.pair[rows], kept.hits[rows], kept.quality[rows])


def gripper_rotation(yaw: float, pitch: float) -> Array:
    """(3, 3) Rz(yaw) Ry(pitch) of a gripper pose, as in `GripperPoses`."""
    (x, y), down, level = (math.cos(yaw), math.sin(yaw)), math.sin(pitch), math.cos(pitch)
    return np.array([(level * x, -y, down * x), (level * y, x, down * y), (-down, 0.0, level)])


def gripper_hits(
    world: CollisionWorld, gripper_poses: Array, opening: float, *, held: HeldObject | None = None, ignore: int = 0
) -> NDArray[np.uint64]:
    """What the gripper alone, and the held object, hit at gripper poses (k, 5), as in `GripperPoses`: masks (k,)."""
    query = world.query(opening, held, ignore | 1 << SELF_BIT, robot=gripper_arrays(world.robot))
    hits: NDArray[np.uint64] = many_gripper_hits(query, _rows(gripper_poses))
    return hits


def _rows(values: Array) -> Array:
    """In the one layout that the kernels are compiled for."""
    return np.require(values, np.float64, ["C", "W"])


@lru_cache(maxsize=64)
def gripper_arrays(arrays: RobotArrays) -> RobotArrays:
    """The gripper of a packed robot as a robot of its own, with solids in the TCP frame; packed.

    Its base pose is x, y and yaw of the TCP, its joints are height and pitch.
    """
    last = arrays.link == len(arrays.axes) - 1
    T_tcp_link = np.linalg.inv(pose_of(arrays.tip))
    offsets, axes, tip = np.zeros((2, 3)), np.array(_HEIGHT_AND_PITCH, dtype=np.int64), np.zeros(3)
    for array in (offsets, axes, tip):
        array.setflags(write=False)
    gripper = arrays._replace(
        offsets=offsets,
        axes=axes,
        tip=tip,
        core=arrays.core[last],
        half=arrays.half[last],
        radius=arrays.radius[last],
        bound=arrays.bound[last],
        link=np.ones(int(last.sum()), dtype=np.int64),
        position=arrays.position[last] @ T_tcp_link[:3, :3].T + T_tcp_link[:3, 3],
        rotation=T_tcp_link[:3, :3] @ arrays.rotation[last],
        slide=arrays.slide[last] @ T_tcp_link[:3, :3].T,
        slides=arrays.slides[last],
        self_pairs=np.empty((0, 2), dtype=np.int64),
        held_from=int(last.sum()),
    )
    return packed(gripper)


def _fit_outside(world: CollisionWorld, held: HeldObject, bases: Array) -> NDArray[np.bool_]:
    """Whether the robot fits with what it holds, carried or at home, where drives begin, at base poses (k, 3): (k,)."""
    ways = np.array([world.scene.state.q, world.scene.robot.home])
    fixed = [world.hits_many(base, ways, 0.0, held) & np.uint64(FIXED_BITS) for base in bases]
    return np.array([not hits.all() for hits in fixed], dtype=np.bool_)
