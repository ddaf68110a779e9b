"""Why an object is taken as it is: what refuses each of its grasps, and what every way to take it costs.

Computed again from a scene and a grasp set, with the collision model and the tables of the lower bound. Nothing of it
is needed for planning.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from planners.clearing.lower_bound import self_clearable_sets
from planners.collision.world import CollisionWorld, objects_on
from planners.drawing.choices import swept_by
from planners.grasping.arm_configurations import gripper_hits
from planners.grasping.candidates import GraspCandidate, GraspCandidates, GraspsOfPose
from planners.grasping.families import Family
from planners.motion.arm import tcp_pose
from planners.placing.locations import placement_grid
from planners.placing.negative_goal_region import Mask, SupportGrid, footprint_mask, is_free, negative_goal_region
from planners.placing.surfaces import MARGIN, static_mask
from planners.scene import FLOOR, Scene, StaticObstacle
from planners.scene.cover import needs_drive
from planners.scene.masks import STATIC_BIT
from planners.scene.moving import without_pull
from planners.tamp.solution import BoundAction, Solution
from planners.workspace import Workspace

Array = NDArray[np.float64]
Part: TypeAlias = Literal["hand", "arm", "way out", "on it"]
"""What a blocker is hit by: the hand, the rest of the robot, the drive out under a shelf; or it stands on it."""
_NEAR = 0.4
"""Range [m] around the TCP for static obstacles that the hand may touch."""
_EXPANSIONS = 300
"""Search nodes for the cost of one way. Its proof takes some tens in a scene of 15 objects."""
_SAME_TURN, _SAME_PLACE = math.radians(1.0), 0.005
"""Differences [rad] of yaw or pitch, and [m] of the position, below which two gripper poses are the same grasp."""


@dataclass(frozen=True, eq=False)
class RefusedBy:
    """What is in the way of a grasp.

    Attributes:
        name: name of an object.
        part: what it is hit by.
    """

    name: str
    part: Part


@dataclass(frozen=True, eq=False)
class GraspAnswer:
    """One gripper pose of the grasp set, and what is in its way.

    Attributes:
        pose: (5,) TCP x, y, z [m], yaw and pitch [rad].
        opening: of the gripper [m].
        arm: name of the arm.
        grasp: the grasp with the fewest objects in its way. None if no base pose and arm configuration are free of
            static obstacles.
        blockers: the objects in its way, each once. () for a free grasp, or without one.
        furniture: names of the static obstacles that the hand alone touches, only without a grasp. () if it is the arm
            that cannot come there.
    """

    pose: Array
    opening: float
    arm: str
    grasp: GraspCandidate | None
    blockers: tuple[RefusedBy, ...] = ()
    furniture: tuple[str, ...] = ()


@dataclass(frozen=True)
class Way:
    """Grasps of an object with the same objects in their way, and what it costs to take the object so.

    Attributes:
        blockers: names of the objects in the way.
        moves: objects to put aside first, blockers of the blockers included. None: there is no order to do so.
        first: their names, in an order in which they can be taken.
        proved: whether `moves` is the fewest. Otherwise it is a number that is enough.
    """

    blockers: tuple[str, ...]
    moves: int | None
    first: tuple[str, ...] = ()
    proved: bool = True


@dataclass(frozen=True, eq=False)
class ObjectAnswer:
    """All grasps of one object.

    Attributes:
        name: name of the object.
        grasps: one for each gripper pose and arm.
        ways: the ways to take it, by the names of the blockers, cheapest first.
        taken: index of the grasp by which a plan takes it. None if it does not.
    """

    name: str
    grasps: tuple[GraspAnswer, ...]
    ways: tuple[Way, ...]
    taken: int | None = None


def why_grasps(
    scene: Scene, families: Sequence[Family], plan: Solution | None = None, names: Collection[str] | None = None
) -> tuple[ObjectAnswer, ...]:
    """Find what is in the way of every grasp of every object, and what each way to take it costs.

    Args:
        scene: the scene. What is held is left out.
        families: the grasp set.
        plan: a plan made for the scene. The gripper poses that it takes objects by are shown with its own base poses
            and arm configurations, which may hit other objects than the best ones.
        names: names of the objects to answer for. None for all.
    """
    scene = without_pull(scene)
    workspace = Workspace.of(scene.robot, scene, grasps=tuple(families))
    candidates, hands = workspace.looking_closely().grasps(), _Hands()
    picks = {} if plan is None else _first_picks(plan)
    found = []
    for name in scene.names:
        if name not in scene.held_names and (names is None or name in names):
            every = list(candidates.by_gripper_pose(scene, name))
            taken = _take(every, candidates, scene, picks[name]) if name in picks else None
            masks = {grasp.blockers for one in every for grasp in one.grasps}
            grasps = tuple(_answer(candidates, hands, name, one) for one in every)
            found.append(ObjectAnswer(name, grasps, _ways(candidates, scene, name, masks), taken))
    return tuple(found)


def _first_picks(plan: Solution) -> dict[str, BoundAction]:
    """First pick of each object that a plan takes, by its name."""
    picks = [action for action in plan.actions if action.name == "PickUp" and action.grip is not None]
    return {action.target: action for action in reversed(picks)}


def _take(every: list[GraspsOfPose], candidates: GraspCandidates, scene: Scene, pick: BoundAction) -> int:
    """Put the grasp of a pick in the place of the grasps with its gripper pose, or last. Return its index."""
    assert pick.grip is not None
    (state, _), view, name = pick.grip, scene.using(pick.scene.robot.arm_name), pick.target
    T = tcp_pose(view.robot, state)
    pose = np.array([*T[:3, 3], math.atan2(-T[0, 1], T[1, 1]), math.atan2(-T[2, 0], T[2, 2])])
    turns = [np.abs(np.remainder(one.pose[3:] - pose[3:] + np.pi, 2 * np.pi) - np.pi).max() for one in every]
    away = [
        math.inf
        if one.scene.robot.arm_name != view.robot.arm_name
        else max(float(turn) / _SAME_TURN, float(np.abs(one.pose[:3] - pose[:3]).max()) / _SAME_PLACE)
        for one, turn in zip(every, turns, strict=True)
    ]
    index = int(np.argmin(away)) if away and min(away) < 1.0 else len(every)
    opening = every[index].opening if index < len(every) else view.robot.opening(state.finger_position)
    own = GraspCandidate(
        name,
        state.base,
        state.q,
        float(pose[3]),
        float(pose[4]),
        opening,
        0,
        0.0,
        needs_drive(view, view.body(name).foot),
        view.robot.arm_name,
    )
    among = scene.mask(scene.names) & ~scene.mask({name, *scene.held_names})
    on_it = objects_on(candidates.compiled.world(view), name)
    own = replace(own, blockers=int(candidates.hits_among(view, name, [own], among)[0]) & among | on_it)
    every[index : index + 1] = [GraspsOfPose(view, pose, opening, (own,))]
    return index


def _answer(candidates: GraspCandidates, hands: _Hands, name: str, found: GraspsOfPose) -> GraspAnswer:
    scene, arm = found.scene, found.scene.robot.arm_name
    if not found.grasps:
        furniture = hands.furniture(scene, found.pose, found.opening)
        return GraspAnswer(found.pose, found.opening, arm, None, furniture=furniture)
    grasp, world = found.grasps[0], candidates.compiled.world(scene)
    ignore = scene.mask({name, *scene.held_names})
    by_hand = int(gripper_hits(world, found.pose[None], found.opening, ignore=ignore)[0])
    on_it = objects_on(world, name)
    blockers = []
    for index, other in enumerate(scene.names):
        if grasp.blockers >> index & 1:
            rest: Part = "way out" if grasp.drives else "arm"
            part: Part = "on it" if on_it >> index & 1 else "hand" if by_hand >> index & 1 else rest
            blockers.append(RefusedBy(other, part))
    return GraspAnswer(found.pose, found.opening, arm, grasp, tuple(blockers))


def _ways(candidates: GraspCandidates, scene: Scene, name: str, masks: Collection[int]) -> tuple[Way, ...]:
    """The ways to take an object by grasps with these blockers. For the other objects, all known grasps count."""
    ways = []
    for mask in sorted(masks):
        blockers = tuple(scene.names_of(mask))
        if not mask:
            ways.append(Way((), 0))
            continue

        def options(other: str, mask: int = mask) -> Sequence[int]:
            return [mask] if other == name else candidates.blockers(scene, other)

        found = next(self_clearable_sets(options, name, scene.names, expansions=_EXPANSIONS))
        ways.append(Way(blockers, found.count, found.objects, found.proved))
    return tuple(sorted(ways, key=lambda way: (math.inf if way.moves is None else way.moves, len(way.blockers))))


class _Hands:
    """Static obstacles that a hand touches, each tested by itself."""

    def __init__(self) -> None:
        self._worlds: dict[tuple[str, str], CollisionWorld] = {}

    def furniture(self, scene: Scene, pose: Array, opening: float) -> tuple[str, ...]:
        """Names of the static obstacles, or the floor, that the open gripper touches at a pose (5,)."""
        near = [
            one
            for one in scene.static_obstacles
            if (one.lower - _NEAR < pose[:3]).all() and (pose[:3] < one.upper + _NEAR).all()
        ]
        bare: list[tuple[str, tuple[StaticObstacle, ...]]] = [(FLOOR, ()), *((one.name, (one,)) for one in near)]
        return tuple(name for name, things in bare if self._touches(scene, name, things, pose, opening))

    def _touches(
        self, scene: Scene, name: str, things: tuple[StaticObstacle, ...], pose: Array, opening: float
    ) -> bool:
        key = scene.robot.arm_name, name
        if key not in self._worlds:
            alone = replace(
                scene, objects=(), static_obstacles=things, held=None, aside=(), supports=(), regions=(), openings=()
            )
            self._worlds[key] = CollisionWorld.from_scene(alone)
        hits = int(gripper_hits(self._worlds[key], pose[None], opening)[0])
        is_hit = bool(hits >> STATIC_BIT & 1)
        # The floor is in every world: it is named only by itself.
        return is_hit and (not things or not self._touches(scene, FLOOR, (), pose, opening))


@dataclass(frozen=True)
class PlaceAnswer:
    """Why a candidate location is refused to an object that is put aside. Nothing of it holds for an allowed one.

    Attributes:
        standing: names of the objects that it would stand too near to.
        furniture: names of the static obstacles that it would stand too near to.
        off: whether it would stand over the edge of the support, or on a place that the goal reserves.
        ways: names of the objects in whose way it would stand when they are taken later: the Negative Goal Region.
    """

    standing: tuple[str, ...] = ()
    furniture: tuple[str, ...] = ()
    off: bool = False
    ways: tuple[str, ...] = ()


def why_places(plan: Solution) -> tuple[tuple[PlaceAnswer, ...], ...]:
    """Find why candidate locations of a plan's clearances are refused: as `ClearancePicture.candidates` of each."""
    found = []
    for index, put in enumerate(plan.actions):
        if put.surfaces:
            before = [action for action in plan.actions[:index] if action.name == "PickUp"]
            later = [action for action in plan.actions[index:] if action.name == "PickUp"]
            found.append(_places(plan, put, before[-1].scene if before else put.scene, later))
    return tuple(found)


def _places(plan: Solution, put: BoundAction, scene: Scene, later: Sequence[BoundAction]) -> tuple[PlaceAnswer, ...]:
    """Answers about the candidates of one put-down, in the order of the surfaces."""
    body = scene.body(put.target)
    height, answers = body.top - body.bottom, list[PlaceAnswer]()
    for surface in put.surfaces:
        grid, support, places = surface.grid, surface.support, placement_grid(surface.support)

        def refused(mask: Mask, grid: SupportGrid = grid, places: Array = places) -> Mask:
            return ~is_free(grid, mask, places, body.radius)

        beside = [one for one in scene.objects if one.bottom < support.top + height and one.top > support.top]
        standing = {one.name: refused(footprint_mask(grid, [one], MARGIN)) for one in beside if one.name != body.name}
        alone = replace(scene, static_obstacles=(support,), openings=())
        edge = static_mask(alone, support, grid, height, MARGIN)
        furniture = {}
        for one in scene.static_obstacles:
            if one.name != support.name:
                among = replace(alone, static_obstacles=(support, one))
                furniture[one.name] = refused(static_mask(among, support, grid, height, MARGIN) & ~edge)
        volumes = {one.target: swept_by(one) for one in later if one.target != plan.target}
        ways = {name: refused(negative_goal_region(grid, height, volume).ngr1) for name, volume in volumes.items()}
        if plan.target:
            ways[plan.target] = refused(surface.region.ngr1)
        is_kept, is_refused = refused(surface.region.mask), refused(surface.blocked)
        is_off = refused(edge)
        for row in range(len(places)):
            near, fixed, kept = (
                tuple(name for name, mask in masks.items() if mask[row]) for masks in (standing, furniture, ways)
            )
            # The picks that are drawn may sweep less than the region keeps clear, which is for grasps, not motions.
            kept = (kept or tuple(ways)) if is_kept[row] else ()
            is_else = bool(is_refused[row] and not near and not fixed and not kept)
            answers.append(PlaceAnswer(near, fixed, bool(is_off[row]) or is_else, kept))
    return tuple(answers)
