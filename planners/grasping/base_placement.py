"""Base poses for gripper poses, from the inverse reachability map and the free ground of a scene."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from assets.robots import RobotSpec
from irm.cache import cached_map
from irm.chain import BASE, ArmChain
from irm.free_space import FreeSpace
from irm.inverse_map import InverseReachabilityMap
from planners.collision.scene_arrays import robot_arrays
from planners.grasping.footprint import fits, inner_radius
from planners.scene import Scene, StaticObstacle

Array = NDArray[np.float64]

TORSO_MARGIN = 0.02375
"""[m] The torso stays so far off the ends of its lift in the planner's reachability map that it can still raise the
gripper: with bases for these ends, lookahead needed more clearances than the minimum in 3 of 20 scenes."""
_DOWNWARD = (0.0, math.pi / 6, math.pi / 3, math.pi / 2)
"""[rad] Rings of the map for arms without the closed form, which are slower to map: no grasp points up."""

FLOOR_MARGIN = 0.02
"""[m] that the base keeps from static obstacles."""
FLOOR_SIZE = 2.5
"""[m] from the centre of the support to the edges of the ground that is used."""
_SPARE = 6
"""Base poses looked at for each one wanted, of a base that is not round."""
WALL_HEIGHT = 0.5
"""[m] above the support: across an obstacle as tall as that no arm reaches it."""


@cache
def inverse_map(robot: RobotSpec) -> InverseReachabilityMap:
    """The robot's inverse reachability map with the planner's parameters, from the cache on disk."""
    return InverseReachabilityMap(cached_map(robot, **map_parameters(robot)))


def map_parameters(robot: RobotSpec) -> dict[str, Any]:
    """Parameters of the planner's reachability map: fingers close along a level line, so that roll 0 is enough."""
    if ArmChain.from_robot(robot).has_closed_form:
        return {"torso_margin": TORSO_MARGIN}
    return {"torso_margin": TORSO_MARGIN, "rolls": 1, "pitches": _DOWNWARD}


def free_ground(scene: Scene, with_shadows: bool = False) -> FreeSpace:
    """The ground around the support where the base may stand: clear of the outlines of static obstacles.

    Obstacles lower than the base, such as a slab that is the ground, and those above the robot do not count. Of
    a base that is not round, the largest circle in its outline is clear of them; `fits` says whether all of it is.

    Args:
        scene: its static obstacles.
        with_shadows: leave out what lies behind walls, as seen from the support.

    Raises:
        SceneError: the scene has no support.
    """
    obstacles = _beside_base(scene)
    outlines = [_shadow(scene, one) if with_shadows and _is_wall(scene, one) else one.outline for one in obstacles]
    x, y = scene.support.position[:2]
    bounds = (x - FLOOR_SIZE, y - FLOOR_SIZE, x + FLOOR_SIZE, y + FLOOR_SIZE)
    return FreeSpace.from_polygons(outlines, inner_radius(scene.robot) + FLOOR_MARGIN, bounds)


def _beside_base(scene: Scene) -> list[StaticObstacle]:
    """The static obstacles at heights of the base, the torso or the head."""
    low, high = _trunk_heights(scene.robot)
    return [one for one in scene.static_obstacles if one.upper[2] > low and one.lower[2] < high]


def _is_wall(scene: Scene, obstacle: StaticObstacle) -> bool:
    """Whether no arm reaches the support across an obstacle beside it."""
    top = scene.support.top
    is_tall = obstacle.lower[2] < top and obstacle.upper[2] > top + WALL_HEIGHT
    return is_tall and not obstacle.is_under(scene.support.position[:2])


def _shadow(scene: Scene, obstacle: StaticObstacle) -> Array:
    """The ground (v, 2) under and behind an obstacle, as seen from the centre of the support."""
    away = obstacle.outline - scene.support.position[:2]
    far = away * (3 * FLOOR_SIZE / np.linalg.norm(away, axis=1, keepdims=True))
    corners = scene.support.position[:2] + np.concatenate((away, far))
    return np.asarray(corners[ConvexHull(corners).vertices])


@cache
def _trunk_heights(robot: RobotSpec) -> tuple[float, float]:
    """[m] below and above which neither the base nor the torso with the head reaches, at any height of the torso."""
    arrays = robot_arrays(robot)
    is_base, is_torso = arrays.link == BASE, arrays.link == 0
    raised = np.where(is_torso, arrays.offsets[0, 2] + arrays.upper[0], 0.0)
    top = (arrays.position[:, 2] + raised + arrays.bound)[is_base | is_torso].max()
    corners = np.abs(arrays.rotation[:, 2]) * arrays.half
    bottom = (arrays.position[:, 2] - corners.sum(axis=1) - arrays.radius)[is_base].min()
    return float(bottom), float(top)


def farthest_reach(robot: RobotSpec) -> float:
    """[m] from the centre of the base to the TCP of the stretched arm, no farther than which it reaches.

    The arm starts at its first joint, which turns about the vertical through the sum of the first two offsets.
    """
    links = robot.chain
    lengths = [*(link.offset for link in links[2:]), robot.tcp_offset]
    reach = sum(float(np.linalg.norm(length)) for length in lengths)
    return reach + float(np.linalg.norm(np.add(links[0].offset, links[1].offset)[:2]))


class Arm(NamedTuple):
    """One arm that acts: its base poses among the static obstacles of a scene, and its joints."""

    placer: MapPlacer
    chain: ArmChain


@dataclass(frozen=True)
class MapPlacer:
    """Base poses from an inverse reachability map.

    Attributes:
        map: of the robot.
        ground: where the base may stand for a level gripper; the lower bounds of the frozen suites rest on it.
        open_ground: where it may stand for a tilted gripper: not behind walls.
        per_gripper_pose: base poses returned for each gripper pose at most.
        yaw_tolerance: [rad] by which the yaw of the map's approach may differ from the gripper's.
        robot: whose outline must fit too, None for a round one.
        outlines: corners (v, 2) of the obstacles that it must fit between.
    """

    map: InverseReachabilityMap
    ground: FreeSpace
    open_ground: FreeSpace
    per_gripper_pose: int = 3
    yaw_tolerance: float = 1e-6
    robot: RobotSpec | None = None
    outlines: tuple[Array, ...] = ()

    @classmethod
    def of_scene(cls, inverse_map: InverseReachabilityMap, scene: Scene, per_gripper_pose: int = 3) -> MapPlacer:
        """Base poses among the static obstacles of a scene."""
        placer = cls(inverse_map, free_ground(scene), free_ground(scene, with_shadows=True), per_gripper_pose)
        if not scene.robot.base_outline:
            return placer
        return replace(placer, robot=scene.robot, outlines=tuple(one.outline for one in _beside_base(scene)))

    def bases(self, gripper_poses: Array, most: int = 0) -> tuple[Array, NDArray[np.int64]]:
        """Base poses from which gripper poses can be reached.

        Args:
            gripper_poses: (k, 5) TCP x, y, z [m], yaw and pitch [rad], as in `GripperPoses`.
            most: base poses for each gripper pose, if that is more than `per_gripper_pose`.

        Returns:
            base poses (m, 3) x [m], y [m], yaw [rad]; index of the gripper pose of each (m,).
        """
        bases, index = [np.empty((0, 3))], [np.empty(0, dtype=np.int64)]
        for pitch in np.unique(gripper_poses[:, 4]):
            rows = np.flatnonzero(gripper_poses[:, 4] == pitch)
            found = self._bases_at_pitch(gripper_poses[rows], float(pitch), most)
            bases.append(found[0])
            index.append(rows[found[1]])
        order = np.argsort(np.concatenate(index), kind="stable")
        return np.ascontiguousarray(np.concatenate(bases)[order]), np.concatenate(index)[order]

    def _bases_at_pitch(self, gripper_poses: Array, pitch: float, most: int) -> tuple[Array, NDArray[np.int64]]:
        """As `bases`, for gripper poses of one pitch [rad]: the map's ring nearest to it answers.

        An object that has slipped in the gripper may have to be released a little beyond straight down.
        """
        yaws, wanted = gripper_poses[:, 3], max(self.per_gripper_pose, most)
        ranges = np.column_stack((yaws - self.yaw_tolerance, yaws + self.yaw_tolerance))
        found = self.map.query_batch(
            gripper_poses[:, :3],
            yaw_ranges=ranges,
            pitch=min(max(pitch, float(self.map.reachability_map.grid.orientations.pitch.min())), math.pi / 2),
            free_space=self.open_ground if pitch else self.ground,
            k=wanted if self.robot is None else _SPARE * wanted,
        )
        rank = np.concatenate([np.arange(count) for count in found.count])
        index = np.repeat(np.arange(len(gripper_poses)), found.count)
        if self.robot is None:
            return found.poses[index, rank], index
        fitting = fits(self.robot, found.poses[index, rank], self.outlines, FLOOR_MARGIN)
        index, rank = index[fitting], rank[fitting]
        first = np.searchsorted(index, index)
        kept = np.arange(len(index)) - first < wanted
        return found.poses[index[kept], rank[kept]], index[kept]
