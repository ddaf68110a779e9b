"""Base poses for gripper poses, on free ground: from the inverse reachability map, or facing the gripper.

A robot whose base does not move has one, where it stands.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from assets.robots import RobotSpec
from irm.answers import NO
from irm.chain import BASE, ArmChain
from irm.free_space import FreeSpace
from irm.ik.solvers import ExactSolver
from irm.inverse_map import InverseReachabilityMap
from irm.reachability_map import cached_map
from irm.rotations import world_to_base
from planners.collision.ground_map import GroundMap
from planners.collision.scene_arrays import robot_arrays
from planners.grasping.arm_configurations import gripper_arrays
from planners.grasping.grasp_poses import wrap_to_pi
from planners.scene import Scene, StaticObstacle

Array = NDArray[np.float64]
TORSO_MARGIN = 0.02375
"""[m] The torso stays so far off the ends of its lift in the planner's reachability map that it can still raise the
gripper: with bases for these ends, lookahead needed more clearances than the minimum in 3 of 20 scenes."""
_DOWNWARD = (0.0, math.pi / 6, math.pi / 3, math.pi / 2)
"""[rad] Rings of the map for arms without the closed form, which are slower to map: no grasp points up."""
GROUND_MARGIN = 0.02
"""[m] that the base keeps from static obstacles."""
GROUND_SIZE = 2.5
"""[m] from the centre of the first support to the edges of the ground that is used."""
_AROUND, _FARTHEST = 1.6, 12.0
"""[m] of ground around every other support and object, from where the arm reaches it; and no farther than that."""
_YAW_TOLERANCE = 1e-6
"""[rad] by which the yaw of the map's approach may differ from the gripper's: rounding."""
MANY_BASES = 40
"""Base poses for each gripper pose of a closer look. More are hardly ever there: with 160 no bound of 48 scenes was
lower."""
_SPARE, _SPARE_MORE = 6, 64
"""Base poses looked at for each one wanted: of a base that is not round; for gripper poses beside the base, and where
the robot cannot drive to some."""
WALL_HEIGHT = 0.5
"""[m] above the support: across an obstacle as tall as that no arm reaches it."""
STRAIGHT = (0.0,)
"""[rad] The gripper's yaw is the base's."""
TURNED = tuple(math.radians(degrees) for degrees in (20, -20, 40, -40, 60, -60))
"""[rad] Other yaws of the gripper relative to the base."""
_STANDOFF = 0.648
"""Share of the arm's reach, from the base's centre to the TCP, at which it moves well; 0.75 m for Fetch."""
_STEP, _FINER = 0.01, 64
"""[m] between distances tried, and into how many parts the last step is cut to find the edge of the free ground."""
_AT_ONCE = 8
"""Gripper poses that are decided at once."""
_YAW_COST = 0.5
"""Cost of a radian of the base's yaw, if a radian of the gripper's yaw relative to the base costs 1."""


@cache
def inverse_map(robot: RobotSpec) -> InverseReachabilityMap:
    """The robot's inverse reachability map with the planner's parameters, from the cache on disk."""
    return InverseReachabilityMap(cached_map(robot, **map_parameters(robot)))


def map_parameters(robot: RobotSpec) -> dict[str, Any]:
    """Parameters of the planner's reachability map: fingers close along a level line, so that roll 0 is enough.

    The planner checks every configuration itself, with what is held and what idle arms hold; in the map self-collision
    would only change the order of base poses.
    """
    common = {"torso_margin": TORSO_MARGIN, "self_collision": False}
    if ArmChain.from_robot(robot).has_closed_form:
        return common
    return {**common, "rolls": 1, "pitches": _DOWNWARD}


def free_ground(scene: Scene, with_shadows: bool = False) -> FreeSpace:
    """The ground around supports and objects where the base may stand: clear of the outlines of static obstacles.

    Obstacles lower than the base, such as a slab that is the ground, and those above the robot do not count. Of
    a base that is not round, the largest circle in its outline is clear of them; `fits` says whether all of it is.
    With shadows, what lies behind walls as seen from the first support is left out too, unless objects or other
    supports are there.

    Raises:
        SceneError: a support is missing, or has no level top.
    """
    top, centre, outlines = scene.support.top, scene.support.position[:2], []
    supports = (scene.support, *map(scene.support_named, scene.supports[1:]))
    places = np.array([*(one.position[:2] for one in supports), *(one.position[:2] for one in scene.objects)])
    for obstacle in _beside_base(scene):
        outline = obstacle.outline
        is_tall = obstacle.lower[2] < top and obstacle.upper[2] > top + WALL_HEIGHT
        if with_shadows and is_tall and not obstacle.is_under(centre):
            # No arm reaches the support across a wall beside it: all that it hides from the centre is left out.
            away = outline - centre
            far = away * (3 * GROUND_SIZE / np.linalg.norm(away, axis=1, keepdims=True))
            corners = centre + np.concatenate((away, far))
            shadow = ConvexHull(corners)
            if not ((places @ shadow.equations[:, :2].T + shadow.equations[:, 2]) < 0).all(axis=1).any():
                outline = corners[shadow.vertices]
        outlines.append(outline)
    low = np.minimum(centre - GROUND_SIZE, places.min(axis=0) - _AROUND)
    high = np.maximum(centre + GROUND_SIZE, places.max(axis=0) + _AROUND)
    # Farther away no ground is used, so that there are not too many cells.
    bounds = (*np.maximum(low, centre - _FARTHEST), *np.minimum(high, centre + _FARTHEST))
    return FreeSpace.from_polygons(outlines, inner_radius(scene.robot) + GROUND_MARGIN, bounds)


def _beside_base(scene: Scene) -> list[StaticObstacle]:
    """The static obstacles at heights of the base, the torso or the head."""
    low, _, high = _trunk_heights(scene.robot)
    return [one for one in scene.static_obstacles if one.upper[2] > low and one.lower[2] < high]


@cache
def _trunk_heights(robot: RobotSpec) -> tuple[float, float, float]:
    """[m] of the lowest and the highest point of the base, and above which neither it nor torso and head ever reach."""
    arrays = robot_arrays(robot)
    is_base, is_torso = arrays.link == BASE, arrays.link == 0
    raised = np.where(is_torso, arrays.offsets[0, 2] + arrays.upper[0], 0.0)
    top = (arrays.position[:, 2] + raised + arrays.bound)[is_base | is_torso].max()
    height, up = arrays.position[:, 2], (np.abs(arrays.rotation[:, 2]) * arrays.half).sum(axis=1) + arrays.radius
    return float((height - up)[is_base].min()), float((height + up)[is_base].max()), float(top)


def farthest_reach(robot: RobotSpec) -> float:
    """[m] from the centre of the base to the TCP of the stretched arm, no farther than which it reaches.

    The arm starts at its first joint, which turns about the vertical through the sum of the first two offsets.
    """
    links = robot.chain
    lengths = [*(link.offset for link in links[2:]), robot.tcp_offset]
    reach = sum(float(np.linalg.norm(length)) for length in lengths)
    return reach + float(np.linalg.norm(np.add(links[0].offset, links[1].offset)[:2]))


@dataclass(frozen=True)
class MapPlacer:
    """Base poses from an inverse reachability map.

    Attributes:
        robot: whose outline must fit too if it is not round.
        map: of the robot.
        scene: its static obstacles, supports and objects say where the base may stand.
        outlines: corners (v, 2) of the obstacles that an outline must fit between.
        ground_map: tells to which base poses the robot cannot drive; these are left out. None: to all.
        per_gripper_pose: base poses returned for each gripper pose at most.
    """

    robot: RobotSpec
    map: InverseReachabilityMap
    scene: Scene = field(repr=False)
    outlines: tuple[Array, ...]
    ground_map: GroundMap | None
    per_gripper_pose: int

    @classmethod
    def of_scene(cls, scene: Scene, per_gripper_pose: int = 3, ground_map: GroundMap | None = None) -> MapPlacer:
        """Base poses for the active arm among the static obstacles of a scene; its map is made if not given."""
        robot, outlines = scene.robot, tuple(one.outline for one in _beside_base(scene))
        return cls(robot, inverse_map(robot), scene, outlines, ground_map or GroundMap(scene), per_gripper_pose)

    @cached_property
    def chain(self) -> ArmChain:
        """The joints of torso and arm."""
        return ArmChain.from_robot(self.robot)

    @cached_property
    def ground(self) -> FreeSpace:
        """Where the base may stand for a level gripper; the lower bounds of the frozen suites rest on it."""
        return free_ground(self.scene)

    @cached_property
    def open_ground(self) -> FreeSpace:
        """Where it may stand for a tilted gripper: not behind walls."""
        return free_ground(self.scene, with_shadows=True)

    def with_more(self, per_gripper_pose: int) -> MapPlacer:
        """The same with so many base poses for each gripper pose."""
        return replace(self, per_gripper_pose=per_gripper_pose)

    def anywhere(self) -> MapPlacer:
        """The same as if the base could drive everywhere, through walls too."""
        return replace(self, ground_map=None)

    def bases(self, gripper_poses: Array, most: int = 0) -> tuple[Array, NDArray[np.int64]]:
        """Base poses from which gripper poses can be reached.

        Args:
            gripper_poses: (k, 5) TCP x, y, z [m], yaw and pitch [rad], as in `GripperPoses`.
            most: base poses for each gripper pose, if that is more than `per_gripper_pose`.

        Returns:
            base poses (m, 3) x [m], y [m], yaw [rad]; index of the gripper pose of each (m,).
        """
        bases, index = [np.empty((0, 3))], [np.empty(0, dtype=np.int64)]
        low = gripper_poses[:, 2] < _trunk_heights(self.robot)[1]
        for pitch, is_low in sorted(set(zip(gripper_poses[:, 4].tolist(), low.tolist(), strict=True))):
            rows = np.flatnonzero((gripper_poses[:, 4] == pitch) & (low == is_low))
            found = self._bases_at_pitch(gripper_poses[rows], pitch, most, is_low)
            bases.append(found[0])
            index.append(rows[found[1]])
        order = np.argsort(np.concatenate(index), kind="stable")
        return np.ascontiguousarray(np.concatenate(bases)[order]), np.concatenate(index)[order]

    def _bases_at_pitch(
        self, gripper_poses: Array, pitch: float, most: int, is_low: bool
    ) -> tuple[Array, NDArray[np.int64]]:
        """As `bases`, for gripper poses of one pitch [rad]: the map's ring nearest to it answers.

        To poses lower than the base the map may say yes with the gripper inside the base: these are left out.
        An object that has slipped in the gripper may have to be released a little beyond straight down.
        """
        wanted, is_round = max(self.per_gripper_pose, most), not self.robot.base_outline
        for spare in (1 if is_round else _SPARE, _SPARE_MORE):
            bases, index = self._from_map(gripper_poses, pitch, spare * wanted)
            driven_to = usable = self.can_drive_to(bases)
            if not is_round:
                usable = usable & fits(self.robot, bases, self.outlines, GROUND_MARGIN)
            if is_low:
                away = _outside_base(self.robot, bases, gripper_poses[index, :2])
                usable = usable & (away > _half_thickness(self.robot))
            # More of them, looked at if one of the poses lacks some and the map has more, begin with the same.
            enough = np.bincount(index[usable if is_low else driven_to], minlength=len(gripper_poses)) >= wanted
            if (enough | (np.bincount(index, minlength=len(gripper_poses)) < spare * wanted)).all():
                break
        bases, index = bases[usable], index[usable]
        kept = np.arange(len(index)) - np.searchsorted(index, index) < wanted
        return bases[kept], index[kept]

    def can_drive_to(self, bases: Array) -> NDArray[np.bool_]:
        """Which base poses (k, 3) are not proved to be out of the robot's reach."""
        return np.ones(len(bases), np.bool_) if self.ground_map is None else self.ground_map.can_reach(bases)

    def _from_map(self, gripper_poses: Array, pitch: float, most: int) -> tuple[Array, NDArray[np.int64]]:
        """The map's base poses (m, 3) on free ground, `most` for each gripper pose at most, and its index (m,)."""
        yaws = gripper_poses[:, 3]
        found = self.map.query_batch(
            gripper_poses[:, :3],
            yaw_ranges=np.column_stack((yaws - _YAW_TOLERANCE, yaws + _YAW_TOLERANCE)),
            pitch=min(max(pitch, float(self.map.reachability_map.grid.orientations.pitch.min())), math.pi / 2),
            free_space=self.open_ground if pitch else self.ground,
            k=most,
        )
        return found.poses[np.arange(most) < found.count[:, None]], np.repeat(np.arange(len(found.count)), found.count)


@dataclass(frozen=True)
class FixedBase:
    """The one base pose of a robot whose base does not move, with the methods of `MapPlacer`; it needs no map.

    Attributes:
        robot: which one.
        base: (3,) x [m], y [m], yaw [rad] where it stands.
    """

    robot: RobotSpec
    base: Array

    @cached_property
    def chain(self) -> ArmChain:
        """The joints of torso and arm."""
        return ArmChain.from_robot(self.robot)

    def with_more(self, per_gripper_pose: int) -> FixedBase:  # noqa: ARG002  there is one
        """The same."""
        return self

    def anywhere(self) -> FixedBase:
        """The same."""
        return self

    def bases(self, gripper_poses: Array, most: int = 0) -> tuple[Array, NDArray[np.int64]]:  # noqa: ARG002
        """Where it stands, for each gripper pose (k, 5) that is no farther away than the stretched arm reaches."""
        away = np.linalg.norm(gripper_poses[:, :2] - self.base[:2], axis=1)
        index = np.flatnonzero(away < farthest_reach(self.robot))
        return np.tile(self.base, (len(index), 1)), index

    def reaches_none(self, T_world_tcp: Array) -> bool:
        """Whether it is proved that the joints reach none of some TCP poses (k, 4, 4), whatever stands around."""
        solver, T = ExactSolver(self.chain), world_to_base(self.base) @ T_world_tcp
        some = (T[k : k + _AT_ONCE] for k in range(0, len(T), _AT_ONCE))  # the first that is reached ends it
        return all((solver.reach(poses)[0] == NO).all() for poses in some)


Placer: TypeAlias = MapPlacer | FixedBase


def placer_of(scene: Scene, per_gripper_pose: int = 3, ground_map: GroundMap | None = None) -> Placer:
    """Base poses for the active arm of a scene; parameters as of `MapPlacer.of_scene`."""
    if scene.robot.base_drive == "fixed":
        return FixedBase(scene.robot, np.array(scene.state.base))
    return MapPlacer.of_scene(scene, per_gripper_pose, ground_map)


def inner_radius(robot: RobotSpec) -> float:
    """[m] of a circle inside the base's outline: no base pose is free where this circle is not."""
    if not robot.base_outline:
        return robot.base_radius
    corners = np.array(robot.base_outline)
    edges = np.roll(corners, -1, axis=0) - corners
    across = edges[:, 0] * corners[:, 1] - edges[:, 1] * corners[:, 0]
    return float(np.abs(across / np.linalg.norm(edges, axis=1)).min())


def _outside_base(robot: RobotSpec, bases: Array, points: Array) -> Array:
    """[m] that points (n, 2) are at least outside the outline of the base at base poses (n, 3); negative inside."""
    away, (c, s) = points - bases[:, :2], (np.cos(bases[:, 2]), np.sin(bases[:, 2]))
    if not robot.base_outline:
        return np.asarray(np.linalg.norm(away, axis=1) - robot.base_radius)
    corners = np.array(robot.base_outline)
    local, normals = (
        np.column_stack((c * away[:, 0] + s * away[:, 1], c * away[:, 1] - s * away[:, 0])),
        _normals(corners),
    )
    return np.asarray((local @ normals.T - (corners @ normals.T).max(axis=0)).max(axis=1))


@cache
def _half_thickness(robot: RobotSpec) -> float:
    """[m] from the axis of the approach to the nearest side of the palm: nearer to the base it is inside."""
    arrays = gripper_arrays(robot_arrays(robot))
    extent = np.einsum("kij,kj->ki", np.abs(arrays.rotation), arrays.half) + arrays.radius[:, None]
    solid = ~arrays.slides
    return max(float((extent - np.abs(arrays.position))[solid, 1:].min(axis=1).max()), GROUND_MARGIN)


def fits(robot: RobotSpec, bases: Array, obstacles: Sequence[Array], margin: float) -> NDArray[np.bool_]:
    """Whether the base's outline at base poses (n, 3) keeps `margin` [m] from convex obstacles, each (v, 2) corners.

    Two convex polygons are apart if an edge of one of them separates them; at corners the margin is measured across
    the edges, and may be a little more than asked for.
    """
    if not len(bases):
        return np.ones(len(bases), dtype=np.bool_)
    corners = np.array(robot.base_outline)
    c, s = np.cos(bases[:, 2]), np.sin(bases[:, 2])
    turn = np.stack((np.stack((c, -s), axis=-1), np.stack((s, c), axis=-1)), axis=-2)
    placed = np.einsum("nij,vj->nvi", turn, corners) + bases[:, None, :2]
    own = np.einsum("nij,vj->nvi", turn, _normals(corners))
    free = np.ones(len(bases), dtype=np.bool_)
    for obstacle in obstacles:
        along = np.einsum("nvi,nki->nvk", placed, own)
        other = np.einsum("wi,nki->nwk", obstacle, own)
        gap = np.maximum(other.min(axis=1) - along.max(axis=1), along.min(axis=1) - other.max(axis=1)).max(axis=1)
        normals = _normals(obstacle)
        along, other = placed @ normals.T, obstacle @ normals.T
        sides = np.maximum(other.min(axis=0) - along.max(axis=1), along.min(axis=1) - other.max(axis=0))
        free &= np.maximum(gap, sides.max(axis=1)) >= margin
    return free


def _normals(corners: Array) -> Array:
    """Unit normals (v, 2) of the edges of a polygon."""
    edges = np.roll(corners, -1, axis=0) - corners
    normals = np.column_stack((edges[:, 1], -edges[:, 0]))
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def facing_bases(
    placer: Placer, gripper_poses: Array, turns: Sequence[float] = STRAIGHT
) -> tuple[Array, NDArray[np.int64]]:
    """Base poses that face gripper poses from a fixed distance, smooth in the gripper's pose, the least turned first.

    The distance is `_STANDOFF` of the arm's reach in whole centimetres, or where the free ground begins behind that.
    `turns` [rad] are the gripper's yaws relative to the base. Result as of `MapPlacer.bases`, but those of all gripper
    poses in one order, the least cost first. A base that does not move stands as it does.
    """
    if isinstance(placer, FixedBase):
        return placer.bases(gripper_poses)
    yaw = wrap_to_pi(gripper_poses[:, 3:4] - np.array(turns))
    distance = np.full(yaw.shape, np.inf)
    is_level = gripper_poses[:, 4] == 0.0
    for rows, ground in ((is_level, placer.ground), (~is_level, placer.open_ground)):
        if rows.any():
            distance[rows] = _distance_behind(ground, gripper_poses[rows], yaw[rows], farthest_reach(placer.robot))
    x = gripper_poses[:, :1] - distance * np.cos(yaw)
    y = gripper_poses[:, 1:2] - distance * np.sin(yaw)
    cost = np.round(_YAW_COST * np.abs(yaw) + np.abs(turns), 9)
    index, turn = np.nonzero(np.isfinite(distance))
    order = np.argsort(cost[index, turn], kind="stable")
    found = np.stack((x, y, yaw), axis=-1)[index, turn][order]
    usable = placer.can_drive_to(found)
    return np.ascontiguousarray(found[usable]), index[order][usable].astype(np.int64)


def _distance_behind(ground: FreeSpace, gripper_poses: Array, yaw: Array, reach: float) -> Array:
    """[m] behind gripper poses (k, 5) along yaws (k, t) where the base may stand: (k, t), infinite for none."""
    standoff = round(_STANDOFF * reach, 2)
    steps = np.tile(np.arange(standoff, reach, _STEP), (*yaw.shape, 1))
    x, y = gripper_poses[:, 0, None, None], gripper_poses[:, 1, None, None]
    cosine, sine = np.cos(yaw)[..., None], np.sin(yaw)[..., None]
    is_any = np.ones(yaw.shape, np.bool_)
    for _ in range(2):
        free = ground.are_free(x - steps * cosine, y - steps * sine)
        is_any &= free.any(axis=-1)
        first = np.take_along_axis(steps, free.argmax(axis=-1)[..., None], axis=-1)
        # The last step is cut finer, to find the edge of the free ground.
        steps = np.maximum(first - _STEP * np.arange(_FINER)[::-1] / _FINER, standoff)
    return np.asarray(np.where(is_any, first[..., 0], np.inf))
