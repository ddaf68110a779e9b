"""Where and how to put down the object in hand: a location, a base pose and an arm configuration that hit nothing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from irm.arm.kinematics import ArmChain
from planners.collision.world import CollisionWorld
from planners.grasping.arm_configurations import ConfigurationGrid, GripperPoses, gripper_hits, scan_configurations
from planners.grasping.candidates import BasePlacer, GraspCandidate
from planners.grasping.grasp_poses import gripper_opening
from planners.motion.pick_and_place import can_put_down
from planners.placing.locations import PlacementConfig, placement_levels, stand_at
from planners.placing.negative_goal_region import SupportGrid, clearance_order, footprint_mask, swept_mask
from planners.placing.static_footprint import static_mask
from planners.placing.swept_volume import grasp_volume
from planners.scene import Body, Scene
from planners.strategies import Strategy

__all__ = ["Placement", "PlacementSearch", "keep_clear_mask"]

Array = NDArray[np.float64]

_GAP = 0.001
"""[m] between the object and the table when the fingers let go."""
_MARGIN = 0.006
"""[m] kept between the object put down and whatever stands around."""


@dataclass(frozen=True, eq=False)
class Placement:
    """A way to put down the object in hand.

    Attributes:
        body: the object where it will stand.
        base: (3,) x [m], y [m], yaw [rad].
        q: (8,) torso [m] and arm [rad] when the fingers open.
        yaw: [rad] of the hand.
        opening: of the gripper [m] after letting go.
        drives: whether the base has to move first.
    """

    body: Body
    base: Array
    q: Array
    yaw: float
    opening: float
    drives: bool

    @property
    def location(self) -> Array:
        """(2,) x, y [m] of the object."""
        return np.asarray(self.body.position[:2])


def keep_clear_mask(
    world: CollisionWorld, grid: SupportGrid, grasps: Sequence[GraspCandidate], height: float
) -> NDArray[np.bool_]:
    """Cells where an object `height` [m] tall would stand in the way of these grasps."""
    if not grasps:
        return grid.empty()
    return swept_mask(grid, grasp_volume(world, grasps), height)


@dataclass(frozen=True)
class PlacementSearch:
    """Finds placements; see `find`.

    Attributes:
        placer: base poses for hand poses.
        chain: the arm.
        config: the grid of locations, and how far it is refined.
        yaws: directions of the hand tried at each location.
        torsos, rolls: values of torso height and upper-arm roll tried for each.
        candidates_per_level: locations tried per refinement of the grid.
        near_home: only the configuration nearest to home, for robots that are told TCP poses.
    """

    placer: BasePlacer
    chain: ArmChain
    config: PlacementConfig = field(default_factory=PlacementConfig)
    yaws: int = 24
    torsos: int = 4
    rolls: int = 12
    candidates_per_level: int = 120
    near_home: bool = False

    def find(
        self, scene: Scene, keep_clear: Sequence[GraspCandidate], strategy: Strategy, rng: np.random.Generator
    ) -> Iterator[Placement]:
        """Placements of the object in hand, best first; lazily, since the first one usually does.

        The paper's grid of locations comes first, then ever finer ones. At each level the locations that can be
        served from where the base stands come before those that need a drive (R_work before R_plane - R_work).

        Args:
            scene: with an object in hand.
            keep_clear: grasps whose volume the object must stay out of.
            strategy: whether locations come in order of priority or at random.
            rng: for the finer grids.
        """
        assert scene.held is not None
        world = CollisionWorld.from_scene(scene)
        body = scene.body(scene.held.name)
        grid = SupportGrid.over(scene.support)
        standing = [other for other in scene.objects if other.name != body.name]
        height = body.top - body.bottom + 2 * _GAP
        occupied = footprint_mask(grid, standing, _MARGIN) | static_mask(scene, grid, height, _MARGIN)
        forbidden = keep_clear_mask(world, grid, keep_clear, height)
        here = scene.state.base[:2]
        for locations in self._levels(scene, strategy, rng):
            nowhere = np.zeros(len(locations), dtype=bool)
            order = clearance_order(grid, forbidden, occupied, body.radius + _GAP, locations, nowhere, here)
            if strategy.locations == "random":
                order = rng.permutation(order)
            chosen = locations[order[: self.candidates_per_level]]
            yield from self._from_here(scene, world, chosen[::-1] if strategy.locations == "priority" else chosen)
            yield from self._after_a_drive(scene, world, chosen)

    def _levels(self, scene: Scene, strategy: Strategy, rng: np.random.Generator) -> Iterator[Array]:
        """The paper's grid of locations, then finer ones; all at once where they are drawn at random."""
        levels = placement_levels(scene.support, rng, self.config)
        if strategy.locations == "random":
            yield np.concatenate(list(levels))
        else:
            yield from levels

    def _from_here(self, scene: Scene, world: CollisionWorld, locations: Array) -> Iterator[Placement]:
        """Placements from where the base stands."""
        base = np.array(scene.state.base)
        for gripper_poses in self._free_gripper_poses(scene, world, locations):
            near = _can_reach(scene, base, gripper_poses)
            if near.any():
                bases = np.tile(base, (int(near.sum()), 1))
                yield from self._configurations(scene, world, GripperPoses(bases, gripper_poses[near]), drives=False)

    def _after_a_drive(self, scene: Scene, world: CollisionWorld, locations: Array) -> Iterator[Placement]:
        """Placements from wherever the base may stand."""
        for gripper_poses in self._free_gripper_poses(scene, world, locations):
            bases, index = self.placer.bases(gripper_poses)
            if len(bases):
                yield from self._configurations(scene, world, GripperPoses(bases, gripper_poses[index]), drives=True)

    def _free_gripper_poses(self, scene: Scene, world: CollisionWorld, locations: Array) -> Iterator[Array]:
        """Per location, the level hands (k, 4) there that hit nothing, with the object and the fingers opened."""
        assert scene.held is not None
        body = scene.body(scene.held.name)
        offset = scene.held.T_tcp_object[:3, 3]
        yaws = np.arange(self.yaws) * (2 * np.pi / self.yaws)
        c, s = np.cos(yaws), np.sin(yaws)
        shift = np.stack((c * offset[0] - s * offset[1], s * offset[0] + c * offset[1]), axis=-1)
        height = scene.support.top + (body.top - body.bottom) / 2 + _GAP - offset[2]
        for location in locations:
            gripper_poses = np.column_stack((location - shift, np.full(len(yaws), height), yaws))
            free = gripper_hits(world, gripper_poses, self._opening(scene, body), held=scene.held) == 0
            if free.any():
                yield gripper_poses[free]

    def _configurations(
        self, scene: Scene, world: CollisionWorld, poses: GripperPoses, drives: bool
    ) -> Iterator[Placement]:
        """The first of these poses for which a configuration exists that the hand can come to and leave."""
        assert scene.held is not None
        body = scene.body(scene.held.name)
        opening = self._opening(scene, body)
        found = scan_configurations(world, poses, self._grid(), opening, held=scene.held, first_free=True)
        for best in np.argsort(-found.quality):
            base, hand = poses.bases[found.pair[best]], poses.gripper_poses[found.pair[best]]
            if can_put_down(world, base, found.q[best], scene.held):
                yield Placement(_put_down(scene, hand), base, found.q[best], float(hand[3]), opening, drives)
                return

    def _opening(self, scene: Scene, body: Body) -> float:
        return gripper_opening(scene.robot, body.half_width)

    def _grid(self) -> ConfigurationGrid:
        return (
            ConfigurationGrid.near_home(self.chain)
            if self.near_home
            else ConfigurationGrid.over(self.chain, self.torsos, self.rolls)
        )


def _can_reach(scene: Scene, base: Array, gripper_poses: Array) -> NDArray[np.bool_]:
    """Hands (k, 4) not plainly out of reach: a cheap test before the arm is looked at."""
    links = scene.robot.chain
    reach = sum(float(np.linalg.norm(link.offset)) for link in links[2:]) + float(
        np.linalg.norm(scene.robot.tcp_offset)
    )
    away = gripper_poses[:, :2] - base[:2]
    bearing = np.arctan2(away[:, 1], away[:, 0])
    turn = np.abs((gripper_poses[:, 3] - bearing + np.pi) % (2 * np.pi) - np.pi)
    return (np.linalg.norm(away, axis=1) < reach + 0.1) & (turn < np.pi / 2)


def _put_down(scene: Scene, hand: Array) -> Body:
    """The object in hand as it stands after being let go at a hand pose."""
    assert scene.held is not None
    body = scene.body(scene.held.name)
    c, s = np.cos(hand[3]), np.sin(hand[3])
    T_world_tcp = np.eye(4)
    T_world_tcp[:2, :2] = [[c, -s], [s, c]]
    T_world_tcp[:3, 3] = hand[:3]
    dropped = body.at_pose(T_world_tcp @ scene.held.T_tcp_object)
    upright = replace(dropped, quaternion=np.array([np.cos(dropped.yaw / 2), 0.0, 0.0, np.sin(dropped.yaw / 2)]))
    return stand_at(upright, dropped.position[:2], scene.support)
