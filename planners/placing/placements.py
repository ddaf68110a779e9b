"""Placements of the held object: a location, a base pose and an arm configuration without collision.

Canonical placements are the same in similar scenes, so that plans can be learned. Their locations are cells of a fixed
grid. The best cells are near the location of the pick and have free space around. The base always drives to a pose
where it faces the gripper with the gripper's yaw. The placements of the paper follow if no cell works.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from planners.clock import NO_DEADLINE, Deadline
from planners.collision.world import SUPPORT_SLACK, CollisionWorld
from planners.grasping.arm_configurations import ConfigurationGrid, GripperPoses, gripper_hits, scan_configurations
from planners.grasping.base_placement import MANY_BASES, Placer, facing_bases, farthest_reach
from planners.grasping.candidates import GraspCandidate
from planners.grasping.grasp_poses import opening_around
from planners.hollows import Hollow, hollow_about
from planners.motion.approaches import Approach, ContactQuery, can_put_down, planned_approach
from planners.placing.goal_places import (
    NARROW,
    PITCH,
    Place,
    Yaws,
    distances,
    distances_to_polygon,
    inner_radius,
    locations_in,
)
from planners.placing.locations import in_hand, placement_cells, placement_levels, put_down, rotated
from planners.placing.negative_goal_region import SweptVolume, is_free
from planners.placing.surfaces import KeepClear, Surface
from planners.placing.swept_volume import grasp_volume
from planners.regions import EDGE
from planners.scene import Body, Scene, StaticObstacle
from planners.scene.bodies import release_pitch
from planners.scene.cover import direction_out, driven_out_of, is_covered
from planners.strategies import Strategy

Array = NDArray[np.float64]

_YAWS, _TORSOS, _ROLLS = 24, 4, 12
"""Gripper yaws tried at each location, torso heights and upper-arm rolls tried for each yaw."""
_FAILURES, _NEAR_FAILURE = 12, 0.03
"""Failed locations in a place after which the search ends, and the distance [m] around each in which no other is
tried."""
_ROW = 0.01
"""Spacing [m] of rows when the depth of a place under a shelf is measured."""
_GAP = 0.001
"""Height [m] of the object above the table when the fingers open."""
FALLS = (0.01, 0.02, 0.03, 0.04, 0.06, 0.08, 0.1, 0.12)
"""Heights [m] of a fall into a container whose bottom the hand cannot reach, in the order of the tries. After a fall of
more than 80 mm, a can topples in one of ten cases."""
_LOCATIONS_OF_FALLS, _BETWEEN_FALLS = 12, 0.02
"""Number of locations for a fall, with any yaw or along the walls, from the middle outwards, and their least spacing
[m]."""
_TIPS = 0.01
"""Least distance [m] of an object's centre from the edge of a face."""
_RIM = np.column_stack((np.cos(np.arange(24) * np.pi / 12), np.sin(np.arange(24) * np.pi / 12)))
"""Points around a circle of radius 1."""
_FACES_DOWN = math.radians(75)
"""Pitch [rad] above which a gripper has no front that would have to face away from the base."""
_CLEAR, _CLEAR_WORTH = 0.03, 3.0
"""Free space [m] around the object up to which it is worth a longer distance, and the distance that a metre of it is
worth."""
_KEPT_SURFACES = 64
"""Surfaces of so many regions to keep clear are kept."""
_DECIMALS = 6
"""Decimals of canonical costs and turns, so that rounding decides nothing."""


@dataclass(frozen=True, eq=False)
class Placement:
    """A location with a base pose and an arm configuration to put down the held object.

    Attributes:
        body: the object at its final pose.
        base: (3,) x [m], y [m], yaw [rad].
        q: (8,) torso [m] and arm [rad] when the fingers open.
        yaw, pitch: yaw and pitch of the gripper [rad].
        opening: gripper opening [m] after the release.
        surfaces: the supports that were searched, with their keep-out regions for the object.
        below: name of the object that it will stand on, "" for none.
        drop: height [m] that it will fall when the fingers open.
    """

    body: Body
    base: Array
    q: Array
    yaw: float
    pitch: float
    opening: float
    surfaces: tuple[Surface, ...] = field(default=(), repr=False)
    below: str = ""
    drop: float = 0.0

    @property
    def location(self) -> Array:
        """(2,) x, y [m] of the object."""
        return np.asarray(self.body.position[:2])


@dataclass(frozen=True)
class PlacementSearch:
    """Search for placements. See `find`.

    Attributes:
        arms: base poses for each acting arm, by its name. The arm that holds an object puts it down.
        supports: names of the supports for objects put aside. Empty means the scene's first support only, R_plane of
            the paper.
        canonical: whether canonical placements come first.
        near_home: whether only the arm configuration nearest to home is tried, for end-effector-controlled robots.
        turns_least: whether releases come first at which the gripper is turned least from where it took the object.
        closely: whether many base poses are tried where the first ones release nothing at any location.
    """

    arms: Mapping[str, Placer]
    supports: tuple[str, ...] = ()
    canonical: bool = False
    near_home: bool = False
    turns_least: bool = False
    closely: bool = False
    _volumes: dict[tuple[str, bytes, bytes], SweptVolume] = field(default_factory=dict, repr=False, compare=False)
    _depths: dict[tuple[object, ...], tuple[Array, float]] = field(default_factory=dict, repr=False, compare=False)
    _surfaces: dict[tuple[object, ...], tuple[Surface, ...]] = field(default_factory=dict, repr=False, compare=False)
    _approaches: dict[tuple[object, ...], tuple[ContactQuery, Approach] | None] = field(
        default_factory=dict, repr=False, compare=False
    )

    def supports_in(self, scene: Scene) -> tuple[StaticObstacle, ...]:
        """Supports for objects put aside. Raises `SceneError` if one is missing."""
        return tuple(scene.support_named(name) for name in self.supports) or (scene.support,)

    def find(
        self,
        world: CollisionWorld,
        keep_clear: KeepClear,
        strategy: Strategy,
        rng: np.random.Generator,
        deadline: Deadline = NO_DEADLINE,
    ) -> Iterator[Placement]:
        """Find placements of the held object, best first, lazily: the first one usually suffices.

        The paper's grid of locations on each support comes first, then finer and finer grids. At each level the
        locations within reach of the present base pose come first, the farthest first (R_work). Then come all locations
        after a base motion, the nearest first (section 3.3). This order ignores which support a location is on.

        Args:
            world: the compiled scene, with an object held.
            keep_clear: grasps that the object must not block.
            strategy: order of the locations (by priority or random), and the number of tries.
            rng: random numbers for the finer grids.
            deadline: when to stop.
        """
        scene, surfaces = world.scene, self.surfaces(world, keep_clear)
        if self.canonical:
            cells = self._cells_best_first(scene, surfaces)[: strategy.locations_per_level]
            yield from (replace(found, surfaces=surfaces) for found in self._straight(world, cells, deadline))
        for most in self._looks():
            has_any = False
            for placement in self._aside(world, surfaces, strategy, rng, deadline, most):
                has_any = True
                yield replace(placement, surfaces=surfaces)
            if has_any:
                return

    def _aside(
        self,
        world: CollisionWorld,
        surfaces: tuple[Surface, ...],
        strategy: Strategy,
        rng: np.random.Generator,
        deadline: Deadline,
        most: int,
    ) -> Iterator[Placement]:
        """Placements of the held object on some surfaces. Arguments as for `find` and `_after_a_drive`."""
        scene, after_one = world.scene, partial(self._after_a_drive, most=most)
        levels, free_of = _free_levels(surfaces, _radius(scene), scene.state.base, rng), _free_of(world)
        for locations, from_here, after_a_drive in self._locations(scene, levels, strategy, rng):
            poses, free = gripper_poses_at(scene, locations), dict[int, Array]()
            for look, rows in ((self._from_here, from_here), (after_one, after_a_drive)):
                for row in itertools.takewhile(lambda _: not deadline.is_over, rows.tolist()):
                    if row not in free:
                        free[row] = free_of(poses[row])
                    if len(free[row]):
                        yield from look(world, locations[row], free[row])

    def find_at(
        self,
        world: CollisionWorld,
        place: Place,
        keep_clear: KeepClear,
        leaving: Collection[str] = (),
        others: Sequence[Body] = (),
        failed: list[Array] | None = None,
        deadline: Deadline = NO_DEADLINE,
        stacked: Sequence[Body] = (),
    ) -> Iterator[Placement]:
        """Find placements of the held object at a place of a goal, lazily as in `find`.

        Args:
            world: the compiled scene, with an object held.
            place: the place.
            keep_clear: grasps that the object must not block, and regions of other objects.
            leaving: names of objects that will have left when the others come.
            others: objects that come there later and still need to fit.
            failed: locations (2,) [m] without a placement, extended in place. Locations near them are skipped, and
                after `_FAILURES` of them the search ends. Locations where the gripper does not fit are added under a
                shelf only.
            deadline: when to stop.
            stacked: objects that are put on this one later, from below. Locations with room for them come first.
        """
        lowered = with_lowered(world, place.below) if place.below else world
        surfaces = () if place.below else self.surfaces(world, keep_clear, (place.face,))
        failed = [] if failed is None else failed
        asked, has_any = (place, keep_clear, surfaces, leaving, others), False
        for most in self._looks():
            # What has failed from few base poses is tried again.
            known = [] if most else failed
            at = _AtPlace(self, world.scene, lowered, *asked, known, deadline, stacked, most)
            for found in at.placements():
                has_any = True
                yield replace(found, surfaces=surfaces, below=place.below)
            if has_any:
                return

    def depth(self, world: CollisionWorld, place: Place) -> tuple[Array, float]:
        """Find the direction (2,) into a place under a shelf, and the depth [m] that the held object can reach there.

        Other objects are ignored, so the result is cached by area, object size, pitch and arm. The depth is -inf if
        every tried location fails.
        """
        scene, (held, body), area = world.scene, in_hand(world.scene), place.area
        assert area is not None
        size, pitch = tuple(body.half_extents.round(_DECIMALS)), round(release_pitch(body, held), 2)
        key = replace(area, name=area.support), size, pitch, scene.robot.arm_name
        if key in self._depths:
            return self._depths[key]
        in_hands = tuple(one for one in scene.objects if one.name in scene.held_names)
        alone = CollisionWorld.from_scene(replace(scene, objects=in_hands))
        everywhere = locations_in(alone.scene, body, place, (), (), lambda points: np.ones(len(points), np.bool_))
        points = np.unique([point for point, _ in everywhere], axis=0).reshape(-1, 2)

        def put_at(point: Array) -> Placement | None:
            return next(self.about(alone, np.array([*point, place.face.top])), None)

        tried: list[Array] = []
        spread = math.sqrt(4 * math.prod(area.half_extents) / _FAILURES)
        found = None
        for point in sorted(points, key=lambda one: math.dist(one, scene.state.base[:2])):
            if found is None and all(math.dist(point, other) > spread for other in tried):
                found = put_at(point)
                tried.append(point)
        inwards, depth = np.zeros(2), -math.inf
        if found is not None:
            inwards = -direction_out(driven_out_of(scene, found.body), found.base)
            rows = np.round(points @ inwards / _ROW).astype(int)
            low, high = round(float(inwards @ found.location) / _ROW), int(rows.max()) + 1
            while high - low > 1:  # an object that fits in a row also fits in the rows before it
                middle = (low + high) // 2
                row = points[rows == middle]
                if any(put_at(row[round(share * (len(row) - 1))]) is not None for share in (0.5, 0.2, 0.8) if len(row)):
                    low = middle
                else:
                    high = middle
            depth = low * _ROW
        self._depths[key] = inwards, depth
        return inwards, depth

    def about(
        self, world: CollisionWorld, location: Array, yaws: Sequence[float | None] = (None,)
    ) -> Iterator[Placement]:
        """Find placements of the held object at a location (3,) [m], which may be in the air.

        Placements from the present base pose come first, then from any base pose. `yaws` [rad] are the object's, None
        for any.
        """
        yield from self._held_at(world, location, _free_poses(world)(location, yaws))

    def _held_at(self, world: CollisionWorld, location: Array, free: Array, most: int = 0) -> Iterator[Placement]:
        """Placements at a location from collision-free gripper poses (k, 5). `most` as for `_after_a_drive`."""
        if len(free):
            yield from self._from_here(world, location, free)
            yield from self._after_a_drive(world, location, free, most)

    def _looks(self) -> tuple[int, ...]:
        """Base poses for each gripper pose in each look for placements. The next look is for want of any."""
        return (0, MANY_BASES) if self.closely else (0,)

    def holding_at(self, world: CollisionWorld, point: Array) -> Iterator[Placement]:
        """Find placements with the held object's centre at a point (3,) [m], in the air, upright as it was taken."""
        _, body = in_hand(world.scene)
        yield from self.about(world, np.array([*point[:2], point[2] - (body.position[2] - body.bottom)]))

    def surfaces(
        self, world: CollisionWorld, keep_clear: KeepClear, supports: Sequence[StaticObstacle] = ()
    ) -> tuple[Surface, ...]:
        """Supports with their keep-out regions for the held object. By default, the supports for objects put aside."""
        _, body = in_hand(world.scene)
        height, supports = body.top - body.bottom + 2 * _GAP, supports or self.supports_in(world.scene)
        target = SweptVolume() if keep_clear.target is None else self.volume(world, keep_clear.target)
        obstacles = [self.volume(world, grasp) for grasp in keep_clear.obstacles]
        reserved, scene = keep_clear.reserved, world.scene
        standing = tuple(one for one in scene.objects if one.name != body.name)
        grasps = tuple(grasp.key for grasp in keep_clear.grasps)
        # With another grasp of the same object, the surfaces are the same.
        key = standing, tuple(supports), scene.static_obstacles, height, keep_clear.target is None, grasps, reserved
        if key not in self._surfaces:
            if len(self._surfaces) >= _KEPT_SURFACES:
                self._surfaces.clear()
            found = (Surface.of(scene, one, body, height, target, obstacles, reserved) for one in supports)
            self._surfaces[key] = tuple(found)
        return self._surfaces[key]

    def volume(self, world: CollisionWorld, grasp: GraspCandidate) -> SweptVolume:
        """Swept volume of a grasp, cached. It does not depend on the other objects of the world."""
        if grasp.key not in self._volumes:
            self._volumes[grasp.key] = grasp_volume(world, grasp, self.approach(world, grasp))
        return self._volumes[grasp.key]

    def approach(self, world: CollisionWorld, grasp: GraspCandidate) -> tuple[ContactQuery, Approach] | None:
        """Approach to a grasp and retreat, by `planned_approach`. Other objects are ignored.

        The result is cached by grasp and object pose.
        """
        key = grasp.key, world.scene.body(grasp.object).pose.tobytes()
        if key not in self._approaches:
            world = world.for_arm(grasp.arm)
            self._approaches[key] = planned_approach(world, grasp.base, grasp.q, grasp.object)
        return self._approaches[key]

    def _straight(self, world: CollisionWorld, locations: Array, deadline: Deadline) -> Iterator[Placement]:
        """Canonical placements of the held object at locations (n, 3) [m], the least turned base first."""
        scene, placer = world.scene, self.arms[world.scene.robot.arm_name]
        grid = ConfigurationGrid.about_home(placer.chain, scene.robot.in_front)
        wanted = gripper_poses_at(scene, locations)
        yaws = wanted[0, :, 3] if len(wanted) else np.zeros(0)  # the yaws are the same at all locations
        turns, free_of = np.round(np.abs(np.remainder(yaws + np.pi, 2 * np.pi) - np.pi), _DECIMALS), _free_of(world)
        for turn in np.unique(turns):
            for location, poses in zip(locations, wanted, strict=True):
                if deadline.is_over:
                    return
                free = free_of(poses[turns == turn])
                bases, index = facing_bases(placer, free)
                for base, pose in zip(bases, free[index], strict=True):
                    yield from self._configurations(world, GripperPoses(base[None], pose[None]), location[2], grid)

    def _cells_best_first(self, scene: Scene, surfaces: Sequence[Surface]) -> Array:
        """Free cells (n, 3) [m] of some surfaces, ranked by distance from the pick and by free space around."""
        _, body = in_hand(scene)
        radius = _radius(scene)
        cells = [surface.free(placement_cells(surface.support), radius) for surface in surfaces]
        margins = [_margins(surface, free, radius) for surface, free in zip(surfaces, cells, strict=True)]
        free, margin = np.concatenate(cells), np.concatenate(margins)
        distance = np.linalg.norm(free[:, :2] - body.position[:2], axis=1)
        cost = distance + _CLEAR_WORTH * np.maximum(_CLEAR - margin, 0.0)
        return np.asarray(free[np.argsort(np.round(cost, _DECIMALS), kind="stable")])

    def _locations(
        self, scene: Scene, levels: Iterator[Array], strategy: Strategy, rng: np.random.Generator
    ) -> Iterator[tuple[Array, NDArray[np.intp], NDArray[np.intp]]]:
        """Locations (n, 3) level by level, with indices to try from the present base pose and after a base motion.

        In random order, the same number is drawn from the locations of all levels together.
        """
        most = strategy.locations_per_level
        if strategy.locations == "random":
            every = list(levels)
            count = sum(min(len(level), most) for level in every)
            drawn = rng.permutation(_nearest_first(np.concatenate(every), scene.state.base))[:count]
            yield drawn, np.flatnonzero(_is_within_reach(scene, drawn)), np.arange(len(drawn))
            return
        for nearest_first in levels:
            within_reach = np.flatnonzero(_is_within_reach(scene, nearest_first))
            yield nearest_first, within_reach[::-1][:most], np.arange(len(nearest_first))[:most]

    def _from_here(self, world: CollisionWorld, location: Array, gripper_poses: Array) -> Iterator[Placement]:
        """Placement at a location (3,) from the present base pose, by free gripper poses (k, 5), if any."""
        near = gripper_poses[can_reach(world.scene, gripper_poses)]
        bases = np.tile(np.array(world.scene.state.base), (len(near), 1))
        return self._configurations(world, GripperPoses(bases, near), location[2])

    def _after_a_drive(
        self, world: CollisionWorld, location: Array, gripper_poses: Array, most: int = 0
    ) -> Iterator[Placement]:
        """Placement at a location (3,) after a base motion, by free gripper poses (k, 5), if any.

        `most`: base poses for each gripper pose, if that is more than plans begin with.
        """
        bases, index = self.arms[world.scene.robot.arm_name].bases(gripper_poses, most)
        return self._configurations(world, GripperPoses(bases, gripper_poses[index]), location[2])

    def grid(self, arm: str) -> ConfigurationGrid:
        """Arm configurations to try for each gripper pose."""
        chain = self.arms[arm].chain
        few = ConfigurationGrid.over(chain, _TORSOS, _ROLLS)
        return ConfigurationGrid.near_home(chain) if self.near_home else few

    def _configurations(
        self, world: CollisionWorld, poses: GripperPoses, level: float, grid: ConfigurationGrid | None = None
    ) -> Iterator[Placement]:
        """The best of these poses for which the arm can put down the object and retreat."""
        if not len(poses.bases):
            return
        scene, (held, body) = world.scene, in_hand(world.scene)
        grid = grid or self.grid(scene.robot.arm_name)
        poses = _least_turned_first(scene, poses) if self.turns_least else poses
        opening, own = opening_around(scene.robot, body, held), scene.mask(scene.held_names)
        placed = put_down(scene, poses.gripper_poses[0], level)
        found = scan_configurations(world, poses, grid, opening, body=placed, held=held, ignore=own, first_free=True)
        for best in np.argsort(-found.quality):
            base, pose = poses.bases[found.pair[best]], poses.gripper_poses[found.pair[best]]
            if can_put_down(world, base, found.q[best], held):
                yaw, pitch = map(float, pose[3:])
                placed = put_down(scene, pose, level)
                yield Placement(placed, base, found.q[best], yaw, pitch, opening)
                return


@dataclass(frozen=True)
class _AtPlace:
    """Search for placements of the held object at one place of a goal. See `PlacementSearch.find_at`.

    Attributes:
        search: source of base poses and arm configurations.
        scene: the scene with the object in hand.
        world: the same scene compiled, with the object below the place lowered.
        place, keep_clear, leaving, others, failed, deadline, stacked: as for `PlacementSearch.find_at`.
        surfaces: the face of the place with its keep-out regions. Empty on top of an object.
        most: base poses for each gripper pose, if that is more than plans begin with.
    """

    search: PlacementSearch
    scene: Scene
    world: CollisionWorld
    place: Place
    keep_clear: KeepClear
    surfaces: tuple[Surface, ...]
    leaving: Collection[str]
    others: Sequence[Body]
    failed: list[Array]
    deadline: Deadline
    stacked: Sequence[Body] = ()
    most: int = 0

    def placements(self) -> Iterator[Placement]:
        """Find placements at the locations of the place, then from above for containers too deep for the hand."""
        for point, yaws in self._locations():
            if self._is_near_failure(point):
                continue
            if self.deadline.is_over or len(self.failed) >= _FAILURES:
                return
            yield from self._put_down_at(point, yaws)
        hollow = self._hollow()
        if hollow is not None and len(self._drops) == 1:
            yield from self._let_fall(hollow)

    def _locations(self) -> Iterator[tuple[Array, Yaws]]:
        """Locations (2,) [m] to try, with the yaws of the object there.

        The farthest row comes first. If half of the tries fail under a shelf, the reachable depth is measured, and the
        deepest reachable row comes next. So no object blocks the locations behind it.
        """
        for point, yaws in self._farthest_first():
            if self._is_covered and len(self.failed) >= _FAILURES // 2:
                yield from self._deepest_first()
                return
            yield point, yaws

    def _farthest_first(self) -> Iterator[tuple[Array, Yaws]]:
        """Locations that keep room for the others, those with most of the object on the face first."""
        fits = list(zip(self._feet, (PITCH, PITCH, NARROW), strict=False))
        has_rooms = (True, False) if self.stacked else (False,)
        found = itertools.chain.from_iterable(
            self._with_foot(foot, pitch, has_room) for has_room in has_rooms for foot, pitch in fits
        )
        if len(self._drops) > 1 or (self.place.hollow is not None and not self.others):
            # Walls are farthest from the middle.
            return iter(sorted(found, key=lambda one: math.dist(one[0], self._middle)))
        return found

    def _with_foot(self, foot: float, pitch: float, has_room: bool) -> Iterator[tuple[Array, Yaws]]:
        """Locations at which a circle of radius `foot` [m] lies on the face, `pitch` [m] apart.

        `has_room`: whether there is to be room for what is stacked on the object.
        """

        def is_allowed(points: Array) -> NDArray[np.bool_]:
            free = self._is_allowed(points, foot)
            return free & self._has_room_above(points) if has_room else free

        return locations_in(
            self.scene, self._body, self.place, self.leaving, self.others, is_allowed, pitch, self._is_near_failure
        )

    def _deepest_first(self) -> list[tuple[Array, Yaws]]:
        """Locations within the reachable depth. The deepest row comes first, and each row from its middle.

        The sides are the worst, since walls are there. Rows keep room for the others.
        """
        inwards, depth = self.search.depth(self.world, self.place)
        across = np.array([-inwards[1], inwards[0]])

        def order(one: tuple[Array, Yaws]) -> tuple[int, float]:
            return -round(float(inwards @ one[0]) / _ROW), round(
                abs(float(across @ (one[0] - self._middle))), _DECIMALS
            )

        every = locations_in(self.scene, self._body, self.place, self.leaving, (), self._is_allowed)
        return sorted((one for one in every if inwards @ one[0] < depth + _ROW / 2), key=order)

    def _put_down_at(self, point: Array, yaws: Yaws) -> Iterator[Placement]:
        """Placements at a location (2,) [m] from the lowest height that has any. A location without one has failed."""
        has_room = self._is_covered
        for drop in self._drops:
            location, has_any = np.array([*point, self.place.face.top + drop]), False
            free = self._free_at(location, yaws)
            has_room |= len(free) > 0
            for found in self._released_at(location, free, drop):
                has_any = True
                yield found
            if has_any:
                return
        if has_room:
            self.failed.append(point)

    def _let_fall(self, hollow: Hollow) -> Iterator[Placement]:
        """Find placements from which the held object falls into a container, the shortest fall and the middle first.

        They serve where the hand does not fit between the walls at the bottom. The object's lowest point starts below
        the rim. If others come later, locations that leave room for them come before the middle.
        """
        middle, points = np.array(hollow.area.centre), list[tuple[Array, Yaws]]()
        inside = locations_in(self.world.scene, self._body, self.place, self.leaving, self.others, self._is_allowed)
        if not self.others:
            inside = iter(sorted(inside, key=lambda one: (len(one[1]) > 1, math.dist(one[0], middle))))
        for point, yaws in inside:
            known = [other for other, how in points if how == yaws]
            if len(known) < _LOCATIONS_OF_FALLS and all(math.dist(point, one) > _BETWEEN_FALLS for one in known):
                points.append((point, yaws))
        for drop in (one for one in FALLS if one < hollow.depth):
            for point, yaws in points:
                if self.deadline.is_over:
                    return
                location = np.array([*point, self.place.face.top + drop])
                yield from self._released_at(location, self._free_at(location, yaws), drop)

    def _released_at(self, location: Array, free: Array, drop: float) -> Iterator[Placement]:
        """Placements by gripper poses (k, 5) at a location (3,) [m], from which the object falls by `drop` [m]."""
        for found in self.search._held_at(self.world, location, free, self.most):
            yield replace(found, body=found.body.lowered(drop), drop=drop)

    def _is_allowed(self, points: Array, foot: float | None = None) -> NDArray[np.bool_]:
        """Whether an object at points (n, 2) stands on the face, clear of grasps and reserved regions: (n,).

        A circle of radius `foot` [m] must lie on the face, by default the last of `_feet`.
        """
        foot, radius = self._feet[-1] if foot is None else foot, _radius(self.scene)
        free = self.place.face.is_under(points[:, None] + foot * _RIM).all(axis=1)
        for surface in self.surfaces if self.keep_clear.grasps else ():
            free &= is_free(surface.grid, surface.region.mask, points, radius)
        for region in self.keep_clear.reserved:
            if region.support == self.place.face.name:
                free &= ~region.touches_disc(points, radius)
        return np.asarray(free)

    def _has_room_above(self, points: Array) -> NDArray[np.bool_]:
        """Whether the objects that are stacked on this one at points (n, 2) hit nothing that stays: (n,)."""
        free, level = np.ones(len(points), np.bool_), self.place.face.top + self._body.top - self._body.bottom
        gone = {self._body.name, *self.leaving, *self.scene.held_names, *(one.name for one in self.stacked)}
        standing = [one for one in self.scene.objects if one.name not in gone]
        for above in self.stacked:
            top = level + above.top - above.bottom
            for wall in self.scene.static_obstacles:
                if wall.lower[2] < top and wall.upper[2] > level:
                    free &= distances_to_polygon(points, wall.outline) > above.radius + _GAP
            for one in standing:
                if one.bottom < top and one.top > level:
                    free &= distances(points, one) > above.radius + _GAP
            level = top
        return free

    def _is_near_failure(self, point: Array) -> bool:
        return any(math.dist(point, other) < _NEAR_FAILURE for other in self.failed)

    @cached_property
    def _feet(self) -> tuple[float, ...]:
        """Radii [m] of the part of the object that must lie on the face, in the order of the tries.

        In an area it is the circle inside the object, at a pose just enough to keep it from tipping over the edge.
        """
        area, face = self.place.area, self.place.face
        # In a container, the walls hold an object that would tip over the edge of a small floor.
        if area is None or self.place.hollow is not None:
            return (_TIPS,)
        inside = inner_radius(self._body)
        if area.name != face.name and not face.is_under(area.corners).all():
            # The area reaches over the edge, so the object may too.
            return inside - EDGE, max(_TIPS, inside / 2), _TIPS
        return (inside - EDGE,)

    @cached_property
    def _drops(self) -> tuple[float, ...]:
        """Heights [m] that the object may fall at each location."""
        area = self.place.area
        return (0.0,) if area is None or not area.drop else (0.0, area.drop)

    @cached_property
    def _is_covered(self) -> bool:
        return is_under_shelf(self.scene, self.place)

    @cached_property
    def _middle(self) -> Array:
        return np.array((0.0, 0.0) if self.place.area is None else self.place.area.centre)

    @cached_property
    def _free_at(self) -> Callable[[Array, Sequence[float | None]], Array]:
        return _free_poses(self.world)

    @cached_property
    def _body(self) -> Body:
        return in_hand(self.scene)[1]

    def _hollow(self) -> Hollow | None:
        """The container that the place is in, if any."""
        if self.place.hollow or self.place.area is None or self.place.below:
            return self.place.hollow
        return hollow_about(self.scene, self.place.face)


def _radius(scene: Scene) -> float:
    """Radius [m] around a location that the held object covers."""
    return in_hand(scene)[1].radius + _GAP


def _least_turned_first(scene: Scene, poses: GripperPoses) -> GripperPoses:
    """Poses by how far the gripper is turned about the vertical from where it took the held object."""
    held, body = scene.held, in_hand(scene)[1]
    assert held is not None
    across = (scene.body(body.name).pose @ np.linalg.inv(held.T_tcp_object))[:2, 1]  # along which the fingers close
    turn = np.remainder(poses.gripper_poses[:, 3] - np.arctan2(-across[0], across[1]) + np.pi, 2 * np.pi) - np.pi
    order = np.argsort(np.round(np.abs(turn), _DECIMALS), kind="stable")
    return GripperPoses(poses.bases[order], poses.gripper_poses[order])


def with_lowered(world: CollisionWorld, name: str) -> CollisionWorld:
    """The same world with an object lowered by the padding, so that another one can be put down on it."""
    return world.with_body(world.scene.body(name).lowered(world.padding + SUPPORT_SLACK))


def gripper_poses_at(scene: Scene, locations: Array, yaw: float | None = None) -> Array:
    """Gripper poses (n, 24, 5) that hold the object just above locations (n, 3): x, y, z [m], yaw and pitch [rad].

    With a `yaw` [rad] of the object, the single gripper pose (n, 1, 5) that leads to this yaw.
    """
    held, body = in_hand(scene)
    pitch = release_pitch(body, held)
    T_release_object = rotated(0.0, pitch) @ held.T_tcp_object
    offset, half_height = T_release_object[:3, 3], body.at_pose(T_release_object).reach((0.0, 0.0, -1.0))
    yaws = np.arange(_YAWS) * (2 * np.pi / _YAWS)
    if yaw is not None:
        resting = put_down(scene, np.array([0.0, 0.0, 0.0, 0.0, pitch]), 0.0)
        yaws = np.array([np.remainder(yaw - resting.yaw + np.pi, 2 * np.pi) - np.pi])
    c, s = np.cos(yaws), np.sin(yaws)
    shift = np.stack((c * offset[0] - s * offset[1], s * offset[0] + c * offset[1]), axis=-1)
    poses = np.empty((len(locations), len(yaws), 5))
    poses[..., :2] = locations[:, None, :2] - shift
    poses[..., 2] = (locations[:, 2] + half_height + _GAP - offset[2])[:, None]
    poses[..., 3], poses[..., 4] = yaws, pitch
    return poses


def _free_poses(world: CollisionWorld) -> Callable[[Array, Sequence[float | None]], Array]:
    """Function for collision-free gripper poses (k, 5) that hold the object above a location (3,) [m], at yaws."""
    free, poses = _free_of(world), dict[tuple[float | None, ...], Array]()

    def at(location: Array, yaws: Sequence[float | None]) -> Array:
        if (key := tuple(yaws)) not in poses:
            poses[key] = np.concatenate([gripper_poses_at(world.scene, np.zeros((1, 3)), yaw)[0] for yaw in yaws])
        return free(poses[key] + np.append(location, (0.0, 0.0)))

    return at


def _free_of(world: CollisionWorld) -> Callable[[Array], Array]:
    """Filter for gripper poses (k, 5): collision-free with the object and with the fingers opened."""
    held, body = in_hand(world.scene)
    opening = opening_around(world.scene.robot, body, held)
    return lambda poses: poses[gripper_hits(world, poses, opening, held=held) == 0]


def _margins(surface: Surface, locations: Array, radius: float) -> Array:
    """Free space [m] around discs of that radius at locations (n, 3), to the accuracy of a cell: (n,)."""
    grid, free = surface.grid, ~surface.blocked
    distance = grid.resolution * distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1]
    cell = ((locations[:, :2] - (grid.x0, grid.y0)) / grid.resolution).astype(int)
    cell = np.clip(cell, 0, np.array(grid.shape) - 1)
    return np.asarray(distance[cell[:, 0], cell[:, 1]] - radius)


def is_under_shelf(scene: Scene, place: Place) -> bool:
    """Whether a place is an area with something above it, so that objects come from a side."""
    return place.area is not None and is_covered(scene, (*place.area.centre, place.face.top))


def _free_levels(surfaces: Sequence[Surface], radius: float, base: Array, rng: np.random.Generator) -> Iterator[Array]:
    """Free locations (n, 3) on all surfaces, level by level, nearest first. Ties go to the first surface."""
    levels = [placement_levels(surface.support, rng) for surface in surfaces]
    for grids in itertools.zip_longest(*levels, fillvalue=np.zeros((0, 2))):
        free = [surface.free(grid, radius) for surface, grid in zip(surfaces, grids, strict=True)]
        yield _nearest_first(np.concatenate(free), base)


def _nearest_first(locations: Array, base: Array) -> Array:
    """Locations (n, 3) sorted by distance from the base."""
    order = np.argsort(np.linalg.norm(locations[:, :2] - base[:2], axis=1), kind="stable")
    return np.asarray(locations[order])


def _is_within_reach(scene: Scene, locations: Array) -> NDArray[np.bool_]:
    """Whether locations (k, 3) may be within reach of the present base pose, by `can_reach`: (k,)."""
    return np.asarray(can_reach(scene, gripper_poses_at(scene, locations)).any(axis=1))


def can_reach(scene: Scene, gripper_poses: Array, base: Array | None = None) -> NDArray[np.bool_]:
    """Whether gripper poses (..., 5) pass a coarse test of reach: the length of the arm, and no facing backwards.

    The base is where it stands, or at another base pose (3,).
    """
    reach = farthest_reach(scene.robot)
    away = gripper_poses[..., :2] - (scene.state.base if base is None else base)[:2]
    bearing = np.arctan2(away[..., 1], away[..., 0])
    turn = np.abs((gripper_poses[..., 3] - bearing + np.pi) % (2 * np.pi) - np.pi)
    faces_down = gripper_poses[..., 4] > _FACES_DOWN
    return (np.linalg.norm(away, axis=-1) < reach) & ((turn < np.pi / 2) | faces_down)
