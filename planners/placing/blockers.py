"""Objects in the way of a put-down at a place of a goal, as masks, as for grasps."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planners.collision.world import CollisionWorld
from planners.grasping.arm_configurations import ArmConfigurations, GripperPoses, gripper_hits, scan_configurations
from planners.grasping.base_placement import MANY_BASES
from planners.grasping.candidates import GraspCandidates, gripper_poses
from planners.grasping.grasp_poses import generate_grasps, opening_around
from planners.motion.approaches import ContactQuery, fewest_hits
from planners.placing.goal_places import Place, Yaws, locations_in, points_about
from planners.placing.locations import in_hand, put_down
from planners.placing.placements import PlacementSearch, can_reach, gripper_poses_at, with_lowered
from planners.scene import Body, HeldObject, Scene
from planners.scene.cover import is_covered
from planners.scene.masks import FIXED_BITS

Array = NDArray[np.float64]

_LOCATIONS, _APART = 4, 0.03
"""Locations of an area that are tested, and their least distance [m]."""
_BASES = 8
"""Base poses of each grasp from which an object may be put down without driving."""


def fewest_in_the_way(
    search: PlacementSearch, world: CollisionWorld, place: Place, leaving: Collection[str] = ()
) -> int | None:
    """Find the smallest set of objects in the way of putting the held object down at a place, as a mask.

    Objects in the way of the straight lines to and from the release are included, as for grasps.

    Args:
        search: source of base poses and arm configurations.
        world: the compiled scene, with an object held.
        place: the place.
        leaving: names of objects that will have left by then.

    Returns:
        None if the place is out of reach for all base poses and arm configurations, whatever objects leave.
    """
    scene, (held, _) = world.scene, in_hand(world.scene)
    gone, lowered = scene.mask((*leaving, *scene.held_names)), _lowered(world, place)
    fewest: int | None = None
    for point, yaws in _some_locations(world.scene, place, leaving):
        wanted = wanted_poses(scene, place, point, yaws)
        known = () if fewest is None else (fewest,)
        poses, found = _scan(search, lowered, wanted, place.face.top, gone, scene.state.base[None], known=known)
        for best in np.argsort(np.bitwise_count(found.hits), kind="stable"):
            if fewest is not None and int(found.hits[best]).bit_count() >= fewest.bit_count():
                break
            query = ContactQuery.release(lowered, poses.bases[found.pair[best]], found.q[best], held, gone)
            hits = fewest_hits(query)
            if hits is not None and (fewest is None or hits.bit_count() < fewest.bit_count()):
                fewest = hits
        if fewest == 0:
            break
    return fewest


class PutDownMasks(NamedTuple):
    """Masks of the objects in the way of each put-down of an object at its place. 0 stands for a free put-down.

    Attributes:
        straight: for a move from where the object stands now. Objects that the robot hits at the release, over all base
            poses from which the object can be taken or put down.
        ever: for a move from anywhere. Objects that gripper and object hit, for any base pose and arm configuration.
            Nothing is claimed about held objects: they may be taken with another grasp.
    """

    straight: tuple[int, ...] = (0,)
    ever: tuple[int, ...] = (0,)


def put_down_masks(
    search: PlacementSearch,
    candidates: GraspCandidates,
    scene: Scene,
    name: str,
    place: Place,
    leaving: Collection[str],
) -> PutDownMasks:
    """Find the objects in the way of a put-down, for all grasps of the grasp set.

    Nothing is claimed about places with an area, objects of several pieces, and objects under a shelf.

    Args:
        search: source of base poses and arm configurations.
        candidates: source of arms, grasp set and compiled scenes.
        scene: the scene with the objects where they stand.
        name: name of the object.
        place: the place that it goes to.
        leaving: names of objects to ignore.
    """
    body = scene.body(name)
    if place.location is None or body.shape == "pieces" or is_covered(scene, body.foot):
        return PutDownMasks()
    level, gone = place.face.top, scene.mask({name, *leaving, *scene.held_names})
    ways = [
        (
            _lowered(candidates.compiled.world(view), place),
            taken,
            wanted_poses(view, place, place.location, (place.yaw,)),
        )
        for view, taken in in_any_hand(candidates, scene, body)
    ]
    if any(_is_any_free(search, world, wanted, level, gone) for world, _, wanted in ways):
        return PutDownMasks()
    straight, ever = set[int](), set[int]()
    for world, taken, wanted in ways:
        robot, (held, _) = world.scene.robot, in_hand(world.scene)
        bases = search.arms[robot.arm_name].bases(taken, _BASES)[0] if len(taken) else scene.state.base[None]
        straight |= set(map(int, _scan(search, world, wanted, level, gone, bases)[1].hits))
        # Elsewhere within the tolerance of the pose, gripper and object alone may hit fewer objects.
        beside = [wanted_poses(world.scene, place, point, (place.yaw,)) for point in points_about(place)[1:]]
        poses = np.concatenate((wanted, *beside))
        hits = gripper_hits(world, poses, opening_around(robot, body, held), held=held, ignore=gone)
        ever |= {int(one) for one in hits if not int(one) & FIXED_BITS}
        free = [k for k in range(len(wanted), len(poses)) if not int(hits[k]) & FIXED_BITS]
        poses = poses[[k for k in free if not any(mask & ~int(hits[k]) == 0 for mask in straight)]]
        if len(poses):
            straight |= set(map(int, _scan(search, world, poses, level, gone, bases, known=straight)[1].hits))
    return PutDownMasks(_minimal(straight), (0,) if name in scene.held_names else _minimal(ever))


def is_put_down_free(
    search: PlacementSearch,
    candidates: GraspCandidates,
    scene: Scene,
    name: str,
    place: Place,
    leaving: Collection[str],
) -> bool:
    """Whether some hand that holds an object can release it at a place without hitting an object that stays.

    Under a shelf, the straight drives in and out are included. Args as for `put_down_masks`; the place may be an area,
    of which a few locations are tested.
    """
    gone = scene.mask({name, *leaving, *scene.held_names})
    for view, _ in in_any_hand(candidates, scene, scene.body(name)):
        world = _lowered(candidates.compiled.world(view), place)
        pose = [] if place.location is None else [(place.location, (place.yaw,))]
        for point, yaws in pose or _some_locations(view, place, leaving):
            if _is_any_free(search, world, wanted_poses(view, place, point, yaws), place.face.top, gone):
                return True
    return False


def can_be_released(
    search: PlacementSearch, candidates: GraspCandidates, scene: Scene, name: str, place: Place
) -> bool:
    """Whether some hand can release an object at its place once all other objects are gone.

    True, too, where that is not known: in areas, on other objects, for an object that does not stand, and for a held
    one, which may be put aside and taken otherwise.
    """
    body = scene.body(name)
    if place.location is None or place.below or not body.is_upright or name in scene.held_names:
        return True
    gone, hands = scene.mask(scene.names), list(in_any_hand(candidates, scene, body))
    # Objects are also released from where they were taken. Such base poses are only found among many.
    return any(
        _is_any_free(
            search,
            candidates.compiled.world(view),
            wanted_poses(view, place, point, (place.yaw,)),
            place.face.top,
            gone,
            most,
        )
        for most in (0, MANY_BASES)
        for point in points_about(place)
        for view, _ in hands
    )


def _is_any_free(
    search: PlacementSearch, world: CollisionWorld, wanted: Array, level: float, gone: int, most: int = 0
) -> bool:
    """Whether an arm configuration from some base pose releases the object at one of the gripper poses (k, 5).

    `most`: base poses for each gripper pose, if that is more than plans begin with.
    """
    held, body = in_hand(world.scene)
    opening = opening_around(world.scene.robot, body, held)
    # Most hands that do not fit hit something themselves, whatever the arm does.
    wanted = wanted[gripper_hits(world, wanted, opening, held=held, ignore=gone) == 0]
    if not len(wanted):
        return False
    return len(_scan(search, world, wanted, level, gone, np.zeros((0, 3)), first_free=True, most=most)[1].q) > 0


def _minimal(masks: Collection[int]) -> tuple[int, ...]:
    """Masks that contain no other mask."""
    return tuple(mask for mask in masks if not any(other != mask and other & ~mask == 0 for other in masks))


def _lowered(world: CollisionWorld, place: Place) -> CollisionWorld:
    return with_lowered(world, place.below) if place.below else world


def _some_locations(scene: Scene, place: Place, leaving: Collection[str]) -> Iterator[tuple[Array, Yaws]]:
    """A few locations (2,) of a place, or all about a pose, where the held object fits, with its yaws."""
    staying = replace(scene, objects=tuple(one for one in scene.objects if one.name not in leaving))
    looked_at: list[Array] = []
    apart, most = (_APART, _LOCATIONS) if place.location is None else (0.0, len(points_about(place)))
    everywhere = locations_in(staying, in_hand(scene)[1], place, (), (), lambda every: np.ones(len(every), np.bool_))
    for point, yaws in everywhere:
        if all(np.hypot(*(point - other)) >= apart for other in looked_at):
            yield point, yaws
            looked_at.append(point)
        if len(looked_at) == most:
            return


def _scan(
    search: PlacementSearch,
    world: CollisionWorld,
    wanted: Array,
    level: float,
    ignore: int,
    more_bases: Array,
    first_free: bool = False,
    known: Collection[int] = (),
    most: int = 0,
) -> tuple[GripperPoses, ArmConfigurations]:
    """Arm configurations that release the held object at gripper poses (k, 5), with the objects that each hits.

    The object then stands `level` [m] high. The base may stand at any base pose, and at more base poses (k, 3).
    `ignore` is a mask of bits to ignore. With `first_free`, only configurations of the first base pose with a
    collision-free one are returned. Otherwise those that hit more than a `known` mask are left out.
    """
    scene, (held, body) = world.scene, in_hand(world.scene)
    robot = scene.robot
    bases, index = search.arms[robot.arm_name].bases(wanted, most)
    near = [np.flatnonzero(can_reach(scene, wanted, base)) for base in more_bases]
    bases = np.concatenate(
        (bases, *(np.tile(base, (len(rows), 1)) for base, rows in zip(more_bases, near, strict=True)))
    )
    poses = GripperPoses(bases, wanted[np.concatenate((index, *near))])
    opening, placed = opening_around(robot, body, held), put_down(scene, wanted[0], level)
    grid = search.grid(robot.arm_name)
    return poses, scan_configurations(
        world, poses, grid, opening, body=placed, held=held, ignore=ignore, first_free=first_free, known=known
    )


def wanted_poses(scene: Scene, place: Place, point: Array, yaws: Yaws) -> Array:
    """Gripper poses (k, 5) that release the held object at a point (2,) of a place, with one of its yaws."""
    location = np.array([[*point, place.face.top]])
    return np.concatenate([gripper_poses_at(scene, location, yaw)[0] for yaw in yaws])


def in_any_hand(candidates: GraspCandidates, scene: Scene, body: Body) -> Iterator[tuple[Scene, Array]]:
    """The scene with an object in hand, once for each relative grasp, with the gripper poses (k, 5) that take it so.

    For a standing cylinder, all directions of a family give the same relative grasp.
    """
    held_by = scene.holding(body.name)
    if held_by is not None:
        yield held_by, np.zeros((0, 5))
        return
    is_round = body.shape == "cylinder" and body.is_upright
    for view in map(scene.using, candidates.arms):
        for family in candidates.families:
            grasps = generate_grasps(body, view.robot, (family,))
            for alike in [grasps] if is_round and grasps else [(grasp,) for grasp in grasps]:
                yield view.with_held(HeldObject.grasped(body, alike[0].T_world_tcp)), gripper_poses(alike)
