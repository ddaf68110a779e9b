"""Reasons, in words, why an object cannot be released at a place: walls, ceiling, a hand that does not fit."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planners.collision.hit_kernels import place_along
from planners.collision.scene_arrays import robot_arrays
from planners.collision.world import PADDING, CollisionWorld
from planners.grasping.arm_configurations import gripper_arrays, gripper_hits
from planners.grasping.candidates import GraspCandidates
from planners.grasping.grasp_poses import opening_around
from planners.hollows import Hollow, hollow_about
from planners.placing.blockers import in_any_hand, wanted_poses
from planners.placing.goal_places import NARROW, PITCH, Place, Yaws, distances_to_polygon, locations_in
from planners.placing.locations import in_hand
from planners.placing.placements import FALLS, with_lowered
from planners.regions import footprint
from planners.scene import Body, Scene, StaticObstacle
from planners.scene.bodies import release_pitch
from planners.scene.cover import BACK, LEAST_LIFT, is_covered

Array = NDArray[np.float64]

_LOCATIONS, _APART = 8, 0.03
"""Number of locations of a place to test, and their least distance [m]."""
_RISE = 0.01
"""Spacing [m] of the heights at which the hand is tested."""
_HIGHEST = 0.4
"""Largest height [m] above a place that is tested."""
_LEAVES = 0.19
"""Least rise [m] of the hand after a release, if it does not go back: see `planners.motion.approaches`."""
_RISES = (2, 6)
"""Numbers of heights on the hand's way up that are checked: the ends, then 38 mm apart, so that no board is missed."""
_TURNS, _SHIFTS = 36, np.arange(-4, 5) * 0.001
"""Number of yaws in half a turn, and shifts [m] along each axis, in which an object is tried in a container's mouth."""
_NEAR = 0.5
"""Range [m] around a place for obstacles that may be in the way."""


@dataclass(frozen=True)
class _Hand:
    """A relative grasp of the object, with gripper poses (k, 5) that release it at the bottom of a place.

    The gripper opens by `opening` [m] there. The way up from there is checked at a number of `rises`. If the place
    `is_covered`, the way back is, too.
    """

    scene: Scene
    poses: Array
    opening: float
    is_covered: bool = False
    rises: int = _RISES[0]

    def hits(self, world: CollisionWorld, rise: float = 0.0, back: float = 0.0) -> NDArray[np.bool_]:
        """Whether hand and object collide with the world when raised by `rise` [m] and moved `back` [m]: (k,)."""
        held, _ = in_hand(world.scene)
        moved = self.poses + np.array((0.0, 0.0, rise, 0.0, 0.0))
        moved[:, :2] -= back * np.column_stack((np.cos(moved[:, 3]), np.sin(moved[:, 3])))
        return gripper_hits(world, moved, self.opening, held=held) != 0

    def is_kept(self, world: CollisionWorld, fall: float) -> bool:
        """Whether all of its poses touch something where it lets go of what falls by `fall` [m], or on each way out."""
        rises = np.linspace(fall, fall + _LEAVES, self.rises)
        is_kept = np.any([self.hits(world, float(rise)) for rise in rises], axis=0)
        if self.is_covered and is_kept.all():
            steps = ((0.0, 0.0), *((LEAST_LIFT, back) for back in np.linspace(0.0, BACK, self.rises)))
            is_kept = np.any([self.hits(world, fall + rise, float(back)) for rise, back in steps], axis=0)
        return bool(is_kept.all())

    def extent(self) -> tuple[float, float]:
        """Height [m] from the object's lowest to the hand's highest point, and the hand's smallest width [m]."""
        held, body = in_hand(self.scene)
        world = CollisionWorld.from_scene(
            replace(self.scene, objects=(self.scene.body(held.name),), static_obstacles=())
        )
        arrays = gripper_arrays(robot_arrays(self.scene.robot))
        query = world.query(self.opening, held, 0, robot=arrays)
        X = np.ascontiguousarray(self.poses[:1, [0, 1, 3, 2, 4]])
        positions, rotations = place_along(query, X)
        count = len(arrays.core)
        half = (np.abs(rotations[0, :count]) * arrays.half[:, None]).sum(axis=2) + arrays.radius[:, None]
        high = float((positions[0, :count] + half)[:, 2].max())
        bottom = float((positions[0, count:, 2]).min()) - (body.top - body.bottom) / 2
        turns = np.arange(18) * (np.pi / 18)
        spans = []
        for turn in turns:
            along = np.array((np.cos(turn), np.sin(turn), 0.0))
            wide = (np.abs(np.einsum("i,kij->kj", along, rotations[0, :count])) * arrays.half).sum(
                axis=1
            ) + arrays.radius
            centres = positions[0, :count] @ along
            spans.append(float((centres + wide).max() - (centres - wide).min()))
        return high - bottom, min(spans)


def why_not_put(candidates: GraspCandidates, scene: Scene, name: str, place: Place) -> str:
    """Explain why no hand can release an object at a place, whatever objects can be moved away. "" if a hand can.

    A few locations are tested with all grasps of the grasp set. The arm is ignored.

    Args:
        candidates: source of arms, grasp set and compiled scenes.
        scene: the scene with the objects where they stand.
        name: name of the object.
        place: the place that it goes to.
    """
    body = scene.body(name)
    staying = (name, *scene.held_names, *((place.below,) if place.below else ()))
    bare = replace(scene, objects=tuple(one for one in scene.objects if one.name in staying))
    hands = list(_hands(candidates, bare, body, place))
    hollow = place.hollow or (hollow_about(scene, place.face) if place.area is not None and not place.below else None)
    told = (_told([replace(hand, rises=rises) for hand in hands], bare, body, place, hollow) for rises in _RISES)
    return next(filter(None, told), "") if hands else ""


def _told(hands: Sequence[_Hand], bare: Scene, body: Body, place: Place, hollow: Hollow | None) -> str:
    """What keeps all hands from letting go of an object at a place, "" if one of them can."""
    falls = (0.0, *(one for one in FALLS if hollow is not None and one < hollow.depth))
    for hand, fall in itertools.product(hands, falls):
        world = _world(hand.scene, place)
        if not hand.is_kept(world, fall):
            return ""
    walls, ceilings = _around(bare, place, body)
    for things, tell in ((ceilings, _under), (walls, _between)):
        if things and _are_enough(hands, falls, place, things):
            return tell(hands, place, hollow, body, _least(hands, falls, place, things))
    both = [*walls, *ceilings]
    if _are_enough(hands, falls, place, both):
        # A hand from the side does not come over the walls, so only hands from above matter.
        over_walls = [hand for hand in hands if not _are_enough([hand], falls, place, walls)] or hands
        tall = min(hand.extent()[0] for hand in over_walls)
        least = _least(hands, falls, place, both)
        hanging = [one for one in least if one in ceilings]
        standing = [one for one in least if one not in ceilings]
        gap = _lowest(hanging) - place.face.top
        over = _names(standing) if hollow is None else f"the walls of {hollow.name}, {1000 * hollow.depth:.0f} mm high,"
        return (
            f"over {over} and under {_names(hanging)}, {1000 * gap:.0f} mm above the floor, a hand that is "
            f"{1000 * tall:.0f} mm high with {body.name}, and goes up by {1000 * _LEAVES:.0f} mm to leave, has no room"
        )
    return ""


def never_fits(candidates: GraspCandidates, scene: Scene, name: str, place: Place) -> bool:
    """Whether the walls of a container alone keep every hand from releasing an object in it.

    The test covers the whole floor, as finely as put-downs are tried, and all heights of `FALLS` below the rim. False,
    too, for a held object, which may be put aside and taken otherwise. Arguments as for `why_not_put`.
    """
    hollow = place.hollow
    if hollow is None or name in scene.held_names:
        return False
    staying = (name, *scene.held_names, *((place.below,) if place.below else ()))
    bare = replace(scene, objects=tuple(one for one in scene.objects if one.name in staying))
    walls: list[StaticObstacle | Body] = [one for one in scene.static_obstacles if one.body == hollow.name]
    walls = [scene.body(place.below)] if place.below else walls
    falls = (0.0, *(one for one in FALLS if one < hollow.depth))
    found = False
    # The middle usually has the most clearance, so it is tested first.
    for most, apart, pitch in ((1, _APART, PITCH), (_LOCATIONS, _APART, PITCH), (math.inf, 0.0, NARROW)):
        for hand in _hands(candidates, bare, scene.body(name), place, most, apart, pitch):
            found, world = True, _with(hand, place, walls)
            if any(not hand.hits(world, fall).all() for fall in falls):
                return False
    return found


def _hands(
    candidates: GraspCandidates,
    scene: Scene,
    body: Body,
    place: Place,
    most: float = _LOCATIONS,
    apart: float = _APART,
    pitch: float = PITCH,
) -> Iterator[_Hand]:
    """Relative grasps of an object, each with its poses over some locations and yaws of a place."""
    middle = place.location if place.area is None else np.array(place.area.centre)
    assert middle is not None
    is_under = is_covered(scene, np.append(middle, place.face.top))
    views = [view for view, _ in in_any_hand(candidates, scene, body)]
    for view in sorted(views, key=lambda view: -release_pitch(body, in_hand(view)[0])):  # from above first
        held, in_it = in_hand(view)
        everywhere = locations_in(view, in_it, place, (), (), lambda points: np.ones(len(points), np.bool_), pitch)
        found = _spread(itertools.chain([(middle, (place.yaw,))], everywhere), most, apart)
        poses = np.concatenate([wanted_poses(view, place, point, yaws) for point, yaws in found])
        yield _Hand(view, poses, opening_around(view.robot, in_it, held), is_under)


def _spread(locations: Iterable[tuple[Array, Yaws]], most: float, apart: float) -> list[tuple[Array, Yaws]]:
    """The first `most` locations that are `apart` [m] or have other yaws. With 0, all that differ."""
    found: dict[tuple[float, float, Yaws], Array] = {}
    for point, yaws in locations:
        if not apart or all(key[2] != yaws or np.hypot(*(point - other)) >= apart for key, other in found.items()):
            found[*point, yaws] = point
        if len(found) == most:
            break
    return [(point, yaws) for (*_, yaws), point in found.items()]


def _world(scene: Scene, place: Place) -> CollisionWorld:
    world = CollisionWorld.from_scene(scene)
    return with_lowered(world, place.below) if place.below else world


def _around(scene: Scene, place: Place, body: Body) -> tuple[list[StaticObstacle | Body], list[StaticObstacle | Body]]:
    """Obstacles around a place, its container included, and obstacles above it."""
    middle = place.location if place.area is None else np.array(place.area.centre)
    assert middle is not None
    top, height = place.face.top, body.top - body.bottom
    near = [
        one
        for one in scene.static_obstacles
        if ((one.lower[:2] < middle + _NEAR) & (one.upper[:2] > middle - _NEAR)).all()
        and one.top > top
        and one.name != place.face.name
    ]
    over = [one for one in near if one.lower[2] > top + height / 2]
    walls: list[StaticObstacle | Body] = [one for one in near if one not in over]
    walls += [scene.body(place.below)] if place.below else []
    return walls, [*over]


def _with(hand: _Hand, place: Place, things: Sequence[StaticObstacle | Body]) -> CollisionWorld:
    """World of a hand with only some of the obstacles."""
    held = in_hand(hand.scene)[0].name
    objects = tuple(one for one in hand.scene.objects if one.name == held or one.name in [own.name for own in things])
    fixed = tuple(one for one in things if isinstance(one, StaticObstacle))
    supports = tuple(name for name in hand.scene.supports if name in [one.name for one in fixed])
    bare = replace(
        hand.scene, objects=objects, static_obstacles=fixed, supports=supports, regions=(), openings=(), pull=None
    )
    is_below = place.below in [one.name for one in objects]
    return _world(bare, place if is_below else replace(place, below=""))


def _are_enough(
    hands: Sequence[_Hand], falls: Sequence[float], place: Place, things: Sequence[StaticObstacle | Body]
) -> bool:
    """Whether these obstacles alone keep every hand from releasing, or from going up afterwards."""
    for hand in hands:
        world = _with(hand, place, things)
        if any(not hand.is_kept(world, fall) for fall in falls):
            return False
    return True


def _least(
    hands: Sequence[_Hand], falls: Sequence[float], place: Place, things: Sequence[StaticObstacle | Body]
) -> list[StaticObstacle | Body]:
    """A minimal subset of the obstacles that keeps every hand away. The last ones are kept.

    Obstacles are left out many at a time. The result is that of leaving them out one by one, since further obstacles
    only keep more hands away.
    """
    left, parts = list(things), [list(things)]
    while parts:
        part, middle = parts[0], len(parts[0]) // 2
        fewer = [one for one in left if not any(one is other for other in part)]
        if fewer and _are_enough(hands, falls, place, fewer):
            left, parts = fewer, parts[1:]
        else:
            parts = [*([part[:middle], part[middle:]] if middle else []), *parts[1:]]
    return left


def _under(
    hands: Sequence[_Hand],
    place: Place,
    hollow: Hollow | None,  # noqa: ARG001  as of `_between`
    body: Body,
    things: Sequence[StaticObstacle | Body],
) -> str:
    gap = _lowest(things) - place.face.top
    need = min(hand.extent()[0] for hand in hands)
    return (
        f"{_names(things)} hangs {1000 * gap:.0f} mm above the place, and the hand that lets go of {body.name} there "
        f"is {1000 * need:.0f} mm high with it, and goes up by {1000 * _LEAVES:.0f} mm to leave"
    )


def _between(
    hands: Sequence[_Hand],
    place: Place,
    hollow: Hollow | None,
    body: Body,
    things: Sequence[StaticObstacle | Body],
) -> str:
    walls = f"between the walls of {hollow.name}" if hollow is not None else f"beside {_names(things)}"
    if hollow is not None:
        walls += f", {1000 * hollow.width:.0f} mm apart and {1000 * hollow.depth:.0f} mm high,"
    if hollow is not None and not _has_room(body, hollow):
        return f"{walls} there are not {1000 * PADDING:.0f} mm left on every side of {body.name}"
    wide = min(hand.extent()[1] for hand in hands)
    words = f"{walls} a hand that is {1000 * wide:.0f} mm wide has no room to let go of {body.name}"
    rises = np.arange(_RISE, _HIGHEST, _RISE)
    worlds = [(hand, _with(hand, place, things)) for hand in hands]
    free = next((rise for rise in rises if any(not hand.hits(world, rise).all() for hand, world in worlds)), None)
    if free is None:
        return f"{words}, at no height"
    falls = () if hollow is None else [one for one in FALLS if one < hollow.depth]
    most = f", and {body.name} may fall {1000 * falls[-1]:.0f} mm at most" if falls else ""
    return f"{words}: it has room from {1000 * free:.0f} mm above the floor on{most}"


def _has_room(body: Body, hollow: Hollow) -> bool:
    """Whether an object fits into the mouth of a container with the distance that the robot keeps, in some yaw."""
    corners = footprint(body) - body.position[:2]
    for turn in np.arange(_TURNS) * (np.pi / _TURNS):
        c, s = np.cos(turn), np.sin(turn)
        turned = corners @ np.array([[c, s], [-s, c]])
        for shift in itertools.product(_SHIFTS, _SHIFTS):
            middle = np.add(hollow.area.centre, shift)
            away = PADDING * turned / np.linalg.norm(turned, axis=1, keepdims=True)
            if (distances_to_polygon(middle + turned + away, hollow.mouth) == 0.0).all():
                return True
    return False


def _lowest(things: Sequence[StaticObstacle | Body]) -> float:
    """Height [m] of the lowest point of hanging obstacles."""
    return min(float(one.lower[2]) for one in things if isinstance(one, StaticObstacle))


def _names(things: Sequence[StaticObstacle | Body]) -> str:
    return ", ".join(dict.fromkeys(one.name for one in things))
