"""Placements of the held object: a location, a base pose and an arm configuration without collision."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from planners.clock import NO_DEADLINE, Deadline
from planners.collision.world import CollisionWorld
from planners.grasping.arm_configurations import (
    ConfigurationGrid,
    GripperPoses,
    driven_configurations,
    gripper_hits,
    scan_configurations,
)
from planners.grasping.base_placement import Arm, farthest_reach
from planners.grasping.candidates import SamplingConfig
from planners.grasping.grasp_poses import gripper_opening
from planners.motion.approaches import can_put_down
from planners.placing.locations import placement_levels, put_down, rotated
from planners.placing.surfaces import KeepClear, Surface
from planners.placing.swept_volume import GraspVolumes
from planners.scene import Body, Scene, StaticObstacle
from planners.scene.bodies import release_pitch
from planners.scene.cover import is_covered
from planners.strategies import Strategy

Array = NDArray[np.float64]

_YAWS, _TORSOS, _ROLLS = 24, 4, 12
"""Directions of the gripper tried at each location; torso heights and upper-arm rolls tried for each."""
_GAP = 0.001
"""[m] between the object and the table when the fingers open."""
_FACES_DOWN = math.radians(75)
"""[rad] A gripper of a larger pitch has no front that would have to face away from the base."""


@dataclass(frozen=True, eq=False)
class Placement:
    """A way to put down the held object.

    Attributes:
        body: the object where it will stand.
        base: (3,) x [m], y [m], yaw [rad].
        q: (8,) torso [m] and arm [rad] when the fingers open.
        yaw, pitch: [rad] of the gripper.
        opening: of the gripper [m] after the release.
        surfaces: the supports that were looked at, with the regions that the object keeps out of.
    """

    body: Body
    base: Array
    q: Array
    yaw: float
    pitch: float
    opening: float
    surfaces: tuple[Surface, ...] = field(default=(), repr=False)

    @property
    def location(self) -> Array:
        """(2,) x, y [m] of the object."""
        return np.asarray(self.body.position[:2])


@dataclass(frozen=True)
class PlacementSearch:
    """Finds placements; see `find`.

    Attributes:
        arms: those that act, by name: an object is put down by the one that holds it.
        near_home: only the configuration nearest to home, for end-effector-controlled robots.
        supports: names of those on which objects are put; none for the scene's first alone, R_plane of the paper.
        volumes: what grasps sweep, as far as it is known already.
    """

    arms: Mapping[str, Arm]
    near_home: bool = False
    supports: tuple[str, ...] = ()
    volumes: GraspVolumes = field(default_factory=GraspVolumes, repr=False, compare=False)

    def supports_in(self, scene: Scene) -> tuple[StaticObstacle, ...]:
        """The supports on which objects are put; raises `SceneError` if one is missing."""
        return tuple(scene.support_named(name) for name in self.supports) or (scene.support,)

    def find(
        self,
        world: CollisionWorld,
        keep_clear: KeepClear,
        strategy: Strategy,
        rng: np.random.Generator,
        deadline: Deadline = NO_DEADLINE,
    ) -> Iterator[Placement]:
        """Placements of the held object, best first; lazily, since the first one usually suffices.

        The paper's grid of locations on each support comes first, then ever finer ones. At each level the locations
        within reach of where the base stands come first, the farthest of them first (R_work); then, after a base
        motion, all locations, the nearest first (section 3.3). Supports do not matter for this order.

        Args:
            world: the scene, compiled, with an object held.
            keep_clear: grasps that the object must not stand in the way of.
            strategy: whether locations come in order of priority or at random, and how many are tried.
            rng: for the finer grids.
            deadline: when to stop.
        """
        scene, surfaces = world.scene, self.surfaces(world, keep_clear)
        yield from (replace(found, surfaces=surfaces) for found in self._preferred(world, surfaces, strategy, deadline))
        levels = _free_levels(surfaces, self._radius(scene), scene.state.base, rng)
        for from_here, after_a_drive in self._locations(scene, levels, strategy, rng):
            for look, locations in ((self._from_here, from_here), (self._after_a_drive, after_a_drive)):
                for location in itertools.takewhile(lambda _: not deadline.is_over, locations):
                    yield from (replace(found, surfaces=surfaces) for found in look(world, location))

    def surfaces(self, world: CollisionWorld, keep_clear: KeepClear) -> tuple[Surface, ...]:
        """The supports as the held object may use them."""
        assert world.scene.held is not None
        body = world.scene.body(world.scene.held.name)
        height = body.top - body.bottom + 2 * _GAP
        supports = self.supports_in(world.scene)
        return tuple(Surface.of(world, support, body, height, keep_clear, self.volumes) for support in supports)

    def _preferred(  # for subclasses
        self,
        world: CollisionWorld,  # noqa: ARG002
        surfaces: Sequence[Surface],  # noqa: ARG002
        strategy: Strategy,  # noqa: ARG002
        deadline: Deadline,  # noqa: ARG002
    ) -> Iterator[Placement]:
        """Placements that come before those of the paper; none in ordinary plans."""
        return iter(())

    def _locations(
        self, scene: Scene, levels: Iterator[Array], strategy: Strategy, rng: np.random.Generator
    ) -> Iterator[tuple[Array, Array]]:
        """The locations to try from where the base stands, and after a base motion, level by level.

        In random order as many are drawn in all, from the locations of all levels.
        """
        most = strategy.locations_per_level
        if strategy.locations == "random":
            every = list(levels)
            count = sum(min(len(level), most) for level in every)
            drawn = rng.permutation(_nearest_first(np.concatenate(every), scene.state.base))[:count]
            yield drawn[self._is_within_reach(scene, drawn)], drawn
            return
        for nearest_first in levels:
            within_reach = nearest_first[self._is_within_reach(scene, nearest_first)]
            yield within_reach[::-1][:most], nearest_first[:most]

    def _from_here(self, world: CollisionWorld, location: Array) -> Iterator[Placement]:
        """The placement at a location (3,) from where the base stands, if there is one."""
        scene = world.scene
        gripper_poses = self._free(world, self._gripper_poses(world.scene, location))
        near = gripper_poses[_can_reach(scene, scene.state.base, gripper_poses)]
        if len(near):
            bases = np.tile(np.array(scene.state.base), (len(near), 1))
            yield from self._configurations(world, GripperPoses(bases, near), location[2])

    def _after_a_drive(self, world: CollisionWorld, location: Array) -> Iterator[Placement]:
        """The placement at a location (3,) from wherever the base may stand, if there is one."""
        gripper_poses = self._free(world, self._gripper_poses(world.scene, location))
        if len(gripper_poses):
            bases, index = self.arms[world.scene.robot.arm_name].placer.bases(gripper_poses)
            if len(bases):
                yield from self._configurations(world, GripperPoses(bases, gripper_poses[index]), location[2])

    def _is_within_reach(self, scene: Scene, locations: Array) -> NDArray[np.bool_]:
        """Whether locations (k, 3) are not plainly out of reach from where the base stands: (k,)."""
        if not len(locations):
            return np.zeros(0, dtype=np.bool_)
        gripper_poses = np.concatenate([self._gripper_poses(scene, location) for location in locations])
        can_reach = _can_reach(scene, scene.state.base, gripper_poses).reshape(len(locations), _YAWS)
        return np.asarray(can_reach.any(axis=1))

    def _free(self, world: CollisionWorld, gripper_poses: Array) -> Array:
        """The gripper poses, of (k, 5), that hit nothing, with the object and with the fingers opened."""
        hits = gripper_hits(world, gripper_poses, self._opening(world.scene), held=world.scene.held)
        return gripper_poses[hits == 0]

    def _gripper_poses(self, scene: Scene, location: Array) -> Array:
        """Gripper poses (24, 5) that hold the object just above a location: x, y, z [m], yaw and pitch [rad]."""
        assert scene.held is not None
        body = scene.body(scene.held.name)
        pitch = release_pitch(body, scene.held)
        T_release_object = rotated(0.0, pitch) @ scene.held.T_tcp_object
        offset, half_height = T_release_object[:3, 3], body.at_pose(T_release_object).half_extent_along((0.0, 0.0, 1.0))
        yaws = np.arange(_YAWS) * (2 * np.pi / _YAWS)
        c, s = np.cos(yaws), np.sin(yaws)
        shift = np.stack((c * offset[0] - s * offset[1], s * offset[0] + c * offset[1]), axis=-1)
        height = location[2] + half_height + _GAP - offset[2]
        return np.column_stack((location[:2] - shift, np.full(len(yaws), height), yaws, np.full(len(yaws), pitch)))

    def _configurations(
        self, world: CollisionWorld, poses: GripperPoses, level: float, grid: ConfigurationGrid | None = None
    ) -> Iterator[Placement]:
        """The best of these poses for which there is a configuration that the gripper can come to and leave."""
        scene = world.scene
        assert scene.held is not None
        if grid is None:
            chain = self.arms[scene.robot.arm_name].chain
            grid = SamplingConfig(_TORSOS, _ROLLS, self.near_home).grid(chain)
        opening, own = self._opening(scene), scene.mask(scene.held_names)
        placed = put_down(scene, poses.gripper_poses[0], level)
        if is_covered(scene, (*placed.position[:2], level)):
            found = driven_configurations(
                world, placed, poses, grid, opening, held=scene.held, ignore=own, first_free=True
            )
        else:
            found = scan_configurations(world, poses, grid, opening, held=scene.held, first_free=True)
        for best in np.argsort(-found.quality):
            base, pose = poses.bases[found.pair[best]], poses.gripper_poses[found.pair[best]]
            if can_put_down(world, base, found.q[best], scene.held):
                yaw, pitch = map(float, pose[3:])
                placed = put_down(scene, pose, level)
                yield Placement(placed, base, found.q[best], yaw, pitch, opening)
                return

    def _radius(self, scene: Scene) -> float:
        """[m] around a location that the held object takes."""
        assert scene.held is not None
        return scene.body(scene.held.name).radius + _GAP

    def _opening(self, scene: Scene) -> float:
        assert scene.held is not None
        return gripper_opening(scene.robot, scene.body(scene.held.name).half_width)


def _free_levels(surfaces: Sequence[Surface], radius: float, base: Array, rng: np.random.Generator) -> Iterator[Array]:
    """Level by level the free locations (n, 3) on all surfaces, nearest first; on the first surface if equally near."""
    levels = [placement_levels(surface.support, rng) for surface in surfaces]
    for grids in itertools.zip_longest(*levels, fillvalue=np.zeros((0, 2))):
        free = [surface.free(grid, radius) for surface, grid in zip(surfaces, grids, strict=True)]
        yield _nearest_first(np.concatenate(free), base)


def _nearest_first(locations: Array, base: Array) -> Array:
    """Locations (n, 3) by their distance from the base."""
    order = np.argsort(np.linalg.norm(locations[:, :2] - base[:2], axis=1), kind="stable")
    return np.asarray(locations[order])


def _can_reach(scene: Scene, base: Array, gripper_poses: Array) -> NDArray[np.bool_]:
    """Gripper poses (k, 5) not plainly out of reach: not farther than the stretched arm, and not facing backwards."""
    reach = farthest_reach(scene.robot)
    away = gripper_poses[:, :2] - base[:2]
    bearing = np.arctan2(away[:, 1], away[:, 0])
    turn = np.abs((gripper_poses[:, 3] - bearing + np.pi) % (2 * np.pi) - np.pi)
    faces_down = gripper_poses[:, 4] > _FACES_DOWN
    return (np.linalg.norm(away, axis=1) < reach) & ((turn < np.pi / 2) | faces_down)
