"""Decisions of a search: the view, or the moved object, that reveals most per second, and the record of earlier
tries."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planners.cause import Cause
from planners.collision.world import CollisionWorld
from planners.expert.actor import straight_seconds
from planners.goals import Goal, closed, inside, open_
from planners.motion.base import unwrap_yaw
from planners.planner import Planner
from planners.scene import Body, Scene
from planners.scene.masks import MAX_OBJECTS
from planners.scene.moving import moved
from planners.search.knowledge import Knowledge
from planners.search.options import (
    FULLY,
    Disclosure,
    Prospect,
    Viewpoint,
    disclosures,
    may_hold,
    opened,
    spots,
    viewpoints,
)
from planners.search.own_shadow import OwnShadow, arms_near
from planners.strategies import STRATEGIES
from planners.tamp.solution import BoundAction, Infeasible, Solution

Array = NDArray[np.float64]
Places = Mapping[str, NDArray[np.bool_]]
"""Cells where the target can be, by support."""

ORDERS = ("expected", "random", "front", "shadow")
"""Methods to choose the object to move: by probability revealed per second, with views, or three baselines without
views."""
_MOVE_SECONDS = 35.0
"""Approximate time [s] of moving an object."""
_LOOK_SECONDS = 2.5
"""Approximate time [s] of looking."""
_OPEN_SECONDS = 35.0
"""Approximate time [s] of opening a drawer or door."""
_OPENED = 3
"""Most openings of the same drawer or door in one search: it may jam."""
_JAMS = "it does not open as far as planned"
_LEAST_GAIN = 0.02
"""Least probability that a view must reveal."""
_NEW_EYE = 0.06
"""Distance [m] of the camera from former positions from which on a view is a new one."""
_MISSES = 2
"""Number of times that a place in line of sight may stay unseen, for example because it is narrower than a pixel. Then
it no longer adds to the gain of views."""
_ASIDE = replace(STRATEGIES["lookahead"], tries=30, attempts=1)
"""Strategy for putting objects aside: quick, since another spot or another object will do."""
_HIDES = 0.05
"""Share of an image that the robot itself may hide."""
_SPEED = 0.6
"""Share of the largest joint velocities and accelerations between viewpoints."""
_EVERY = 4
"""Stride of the samples of a planned motion that are checked."""
_LURKING = 0.02
"""Radius [m] of a possible unseen object where the arm would pass."""


class Decisions:
    """Chooses the next action of an episode's search, and plans it.

    Attributes:
        refusals: reasons why an object cannot be put aside, or a drawer or door cannot be opened, by its name.
    """

    def __init__(
        self, knowledge: Knowledge, shadow: OwnShadow, planner: Planner, order: str, rng: np.random.Generator
    ) -> None:
        """Begin without earlier tries. `shadow` tells how much the robot hides of its own view."""
        self._knowledge, self._shadow, self._planner, self._order, self._rng = knowledge, shadow, planner, order, rng
        self._home = np.array(knowledge.robot.home)
        self._aside = self._home.copy()  # torso and arm, with the arm where it hides little
        self._attempted: list[str] = []
        self._pulled: Counter[str] = Counter()
        self.refusals: dict[str, str] = {}
        self.start_over()

    # Record of earlier tries.

    def start_over(self) -> None:
        """Reset the record after a motion: views may show more than before, and a refused opening may succeed."""
        self._refused: set[str] = set()
        self._looked_from: list[Array] = []
        self._missed = {name: np.zeros(cells.shape, np.int64) for name, cells in self._knowledge.places().items()}

    def count_look(self) -> None:
        """Record that images were taken here. Places in line of sight that are left should have been seen."""
        known = self._knowledge
        self._looked_from.append(known.eye)
        for name, cells in known.places().items():
            in_line = Prospect(known.belief, {name: cells}, known.scene(), len(cells.ravel())).masks(known.eye) == 0
            self._missed[name][cells] += in_line.any(axis=1)

    # Choice of the next action.

    def ranked(self, places: Places, target: str) -> tuple[Viewpoint | None, list[str], Disclosure | None]:
        """Best view by probability revealed per second, better objects to move, best first, and a still better
        opening."""
        scene = self._knowledge.scene()
        prospect, world = Prospect(self._knowledge.belief, places, scene), CollisionWorld.from_scene(scene)
        names, worth = self._ranked_objects(prospect, self._viewpoints(scene, prospect), target)
        useful: list[Viewpoint] = []
        if self._order == "expected" and not target:
            # Places that stayed unseen in line of sight are not looked at again until something has moved.
            fresh = {name: cells & (self._missed[name] < _MISSES) for name, cells in places.items()}
            share = sum(cells.sum() for cells in fresh.values()) / sum(cells.sum() for cells in places.values())
            views = self._viewpoints(scene, Prospect(self._knowledge.belief, fresh, scene), float(share))
            useful = [one for one in views if one.gain >= _LEAST_GAIN and self._is_new(one)]
        by_rate = sorted(useful, key=lambda one: -one.rate)
        best = next((one for one in by_rate if self.is_free(self.drive_to(one), world)), None)
        rate = max(worth / _MOVE_SECONDS, 0.0 if best is None else best.rate)
        opening = None if target else self._best_to_open(scene, places, rate)
        return best, names if best is None or best.rate < worth / _MOVE_SECONDS else [], opening

    def _best_to_open(self, scene: Scene, places: Places, rate: float) -> Disclosure | None:
        """Opening that reveals most per second, if that exceeds a rate [1/s]."""
        weighed = disclosures(scene, self._knowledge.belief, places, *self._camera, seconds=self._seconds_to)
        found = [one for one in weighed if one.view.gain >= _LEAST_GAIN and one.name not in self.unopened]
        best = max(found, key=_opening_rate, default=None)
        return best if best is not None and _opening_rate(best) > rate else None

    def _ranked_objects(self, prospect: Prospect, views: Sequence[Viewpoint], target: str) -> tuple[list[str], float]:
        """Names of objects to move, best first, and the gain of moving the first one."""
        names = [body.name for body in prospect.bodies if body.name != target]
        fresh = [name for name in names if name not in self._attempted]
        if self._order == "random":
            return list(self._rng.permutation(fresh)), 0.0
        if self._order == "front":
            x = {body.name: body.position[0] - body.half_extents[0] for body in prospect.bodies}
            return sorted(fresh, key=lambda name: x[name]), 0.0
        if self._order == "shadow":
            alone = {body.name: prospect.hidden_by(body, [self._knowledge.eye]) for body in prospect.bodies}
            return sorted(fresh, key=lambda name: -alone[name]), 0.0
        # the viewpoint among the nearest ones that would show most
        best: dict[str, float] = dict.fromkeys(names, 0.0)
        for view in sorted(views, key=lambda one: one.seconds)[:12]:
            for name, share in prospect.shadows(view.eye).items():
                if name in best:
                    best[name] = max(best[name], share * _MOVE_SECONDS / (_MOVE_SECONDS + view.seconds))
        again = {name: 0.5 ** self._attempted.count(name) for name in names}
        order = sorted((name for name in names if best[name] > 0), key=lambda name: -best[name] * again[name])
        return order, best[order[0]] if order else 0.0

    def plan_aside(self, names: Sequence[str], places: Places) -> tuple[str, tuple[BoundAction, ...]] | None:
        """The first object that can be put aside, with a plan. None if every plan fails."""
        scene = self._knowledge.scene()
        prospect = Prospect(self._knowledge.belief, places, scene)
        views = self._viewpoints(scene, prospect)
        eyes = [one.eye for one in views[:: max(len(views) // 6, 1)]]
        for name in names:
            self.refusals[name] = "no free spot for it has been seen"
            for region in spots(scene, scene.body(name), self._knowledge.belief, prospect, eyes, self._rng):
                outcome = self.solved(replace(scene, regions=(region,)), inside(name, region.name))
                if isinstance(outcome, Solution) and outcome.actions:
                    self._attempted.append(name)
                    return name, outcome.actions
                if isinstance(outcome, Infeasible):
                    self.refusals[name] = outcome.cause
                    if outcome.cause.lies_in_grasps:
                        break  # independent of the spot
        return None

    @property
    def unopened(self) -> list[str]:
        """Names of shut drawers and doors that cannot be opened at present. `refusals` has the causes."""
        jammed = {name for name, count in self._pulled.items() if count >= _OPENED}
        still_open = {one.name for one in opened(self._knowledge.empty)}
        return sorted((jammed | self._refused) - still_open)

    def plan_opening(self, wanted: Disclosure, places: Places) -> tuple[str, str, tuple[BoundAction, ...]] | None:
        """Plan to open a drawer or door, or first to shut a searched one that is in the way. None if both fail.

        Returns:
            The action, "open" or "shut", the name of the drawer or door, and the plan.
        """
        scene, name = self._knowledge.scene(), wanted.name
        goal = open_(name, share=FULLY - 0.05)
        looked_into = [one.name for one in opened(scene) if one.name in wanted.shut or not may_hold(one, places)]
        outcome = Infeasible(Cause.UNREACHABLE, "") if wanted.shut else self.solved(scene, goal)
        if isinstance(outcome, Solution):
            self._pulled[name] += 1
            self.refusals[name] = _JAMS
            return "open", name, outcome.actions
        for other in looked_into:
            shut = self.solved(scene, closed(other))
            there = moved(scene, other, scene.opening(other).shut)
            if isinstance(shut, Solution) and (wanted.shut or isinstance(self.solved(there, goal), Solution)):
                return "shut", other, shut.actions
        self._refused.add(name)
        self.refusals[name] = outcome.cause
        return None

    def view_of_unseen(self, actions: Sequence[BoundAction], name: str) -> Viewpoint | None:
        """View that shows most of the unseen places in the path of motions to an object. None if all views show too
        little.

        Only the "expected" order looks from elsewhere.
        """
        if self._order != "expected":
            return None
        scene = self._knowledge.scene()
        prospect = Prospect(self._knowledge.belief, self._knowledge.places(), scene)
        rows = self._passed_through(actions, prospect.points[:, 0], scene, name)
        if not rows:
            return None
        prospect.points = prospect.points[rows]
        views = [one for one in self._viewpoints(scene, prospect) if one.gain >= 0.5 and self._is_new(one)]
        return max(views, key=lambda one: one.rate, default=None)

    def _passed_through(self, actions: Sequence[BoundAction], feet: Array, scene: Scene, name: str) -> list[int]:
        """Indices of the places (m, 3) [m] where an object of the target's height would be in the path of motions.

        Places near the named object come first, as many as the collision world can hold.
        """
        away, room = feet - scene.body(name).position, MAX_OBJECTS - len(scene.objects)
        chosen: list[int] = []
        for index in np.argsort(np.hypot(*away[:, :2].T), kind="stable"):
            if len(chosen) < room and all(math.dist(feet[index], feet[other]) > 2 * _LURKING for other in chosen):
                chosen.append(int(index))
        half = np.array((_LURKING, _LURKING, self._knowledge.target.height / 2))
        unseen = [Body(f"unseen_{i}", "cylinder", half, feet[i], np.array((1.0, 0, 0, 0))) for i in chosen]
        world = CollisionWorld.from_scene(replace(scene, objects=(*scene.objects, *unseen), held=None))
        hit, known = 0, scene.mask(scene.names)
        for trajectory in (action.trajectory for action in actions):
            X = np.column_stack((trajectory.base, trajectory.q))[::_EVERY]
            hit |= world.path_hits(X, self._knowledge.robot.max_opening, ignore=known)
        return [index for number, index in enumerate(chosen) if hit >> (len(scene.objects) + number) & 1]

    def solved(self, scene: Scene, goal: Goal) -> Solution | Infeasible:
        """Solve a goal. Put-downs aside are planned quickly."""
        return self._planner.solve(scene, goal.target or goal, "lookahead" if goal.target else _ASIDE, self._rng)

    def _viewpoints(self, scene: Scene, prospect: Prospect, share: float = 1.0) -> list[Viewpoint]:
        """Viewpoints in front of the support, with gains. The places of a prospect are a share of all places."""
        return [
            replace(one, gain=share * prospect.gain(one.eye), seconds=self._seconds_to(one))
            for one in viewpoints(scene, prospect.points, *self._camera)
        ]

    @property
    def _camera(self) -> tuple[Array, tuple[float, float]]:
        """Camera position (3,) [m] in the base frame, and range [m] of the torso's height."""
        T = np.linalg.inv(self._knowledge.reading.T_world_base) @ np.append(self._knowledge.eye, 1.0)
        limits = self._knowledge.robot.chain[0]
        return T[:3], (limits.lower + 0.01, limits.upper - 0.01)

    def _seconds_to(self, view: Viewpoint) -> float:
        """Time [s] to get to a viewpoint and look."""
        return _LOOK_SECONDS + self.seconds(self.drive_to(view))

    def _is_new(self, view: Viewpoint) -> bool:
        """Whether no image was taken from there since something moved."""
        return all(math.dist(view.eye, eye) > _NEW_EYE for eye in self._looked_from)

    # Motions to viewpoints.

    def drive_to(self, view: Viewpoint) -> Array:
        """Whole-body configuration at a viewpoint, with the arm aside."""
        drive = np.concatenate((view.base, [view.torso], self._aside[1:]))
        drive[2] = unwrap_yaw(drive[2], self._knowledge.reading.drive[2])
        return drive

    def arm_aside(self, points: Sequence[Array]) -> Array:
        """The soonest reached configuration in which the arm hides little of some points (3,) [m], maybe the present
        one."""
        known = self._knowledge
        drive, world, robot = known.reading.drive, CollisionWorld.from_scene(known.scene()), known.robot
        limits = np.array([(joint.lower, joint.upper) for joint in robot.chain[1:]])
        arms = [arm for arm in arms_near(self._home[1:]) if (limits[:, 0] < arm).all() and (arm < limits[:, 1]).all()]
        goals = [drive, *sorted((np.append(drive[:4], arm) for arm in arms), key=self.seconds)]
        hides: list[float] = []
        for goal in goals:
            hides.append(self._shadow.share(goal, points) if self.is_free(goal, world) else 1.0)
            if hides[-1] <= _HIDES:
                break
        best = goals[int(np.argmin(hides))]
        self._aside[1:] = best[4:]
        return best

    def is_free(self, goal: Array, world: CollisionWorld | None = None) -> bool:
        """Whether all joints can move together from the present to another whole-body configuration."""
        known = self._knowledge
        world, motion = world or CollisionWorld.from_scene(known.scene()), np.stack((known.reading.drive, goal))
        return not world.path_hits(motion, known.robot.max_opening, known.held, first_only=True)

    def seconds(self, goal: Array) -> float:
        """Time [s] of the motion to a whole-body configuration."""
        return straight_seconds(self._knowledge.robot, self._knowledge.reading.drive, goal, _SPEED)


def _opening_rate(one: Disclosure) -> float:
    """Probability revealed per second, with the time for drawers and doors that are shut first."""
    return one.view.gain / (_OPEN_SECONDS * (1 + len(one.shut)) + one.view.seconds)
