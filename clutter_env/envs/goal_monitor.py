"""Progress of a rearrangement: the satisfied facts of the goal, for how long, and the distance to the next fact.

Facts are evaluated by their geometry alone, as in the planner. The `SuccessMonitor` of all environments checks that
nothing else has happened. An object of the goal, or an object that is put aside, may change its support while it is
carried in the air.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.envs.reward import MOST, REACH_SCALE
from clutter_env.envs.success import HOLD_STEPS
from clutter_env.errors import StateError
from clutter_env.scene.household import KINDS
from clutter_env.scene.layout import Layout, furniture, supports_of
from clutter_env.scene.table_scene import TableScene, object_name
from clutter_env.simulation.model import kind_model
from clutter_env.simulation.saved_state import Fields
from clutter_env.simulation.world import Measurements, World, start_poses
from planners.goals import At, Before, Clear, Fact, Goal, GoalError, Holding, Inside, On, Region, names_in, occupants
from planners.scene import AsideObject, Body, HeldObject, RobotState, Scene, StaticObstacle
from planners.scene.mujoco_reading import movable_body

Array = NDArray[np.float64]

CARRY_SCALE = 2.0
"""[1/m] The carrying term falls to a quarter at half a metre from the place."""
PROGRESS_SCALES = {"reach": 0.2, "grasp": 0.2, "carry": 0.4}
"""Weights of the terms of the progress towards the next fact, each between 0 and 1. The fact itself has the weight
1."""
SETTLING = 0.02
"""[m] Largest distance from the place where an object was last carried to its present place. It slides while it is
placed and released."""
_IN_HAND = np.eye(4)


@dataclass(frozen=True, eq=False)
class Place:
    """Desired place of an object: on a face within a rectangle, at a point, on another object, or held up.

    Attributes:
        kind: "in_area", "at_point", "on_object" or "held_up".
        centre: (3,) [m] of the rectangle, or the point, at the height of the face. Zeros for the last two kinds.
        half_extents: (2,) [m] of the rectangle, else zeros.
        yaw: [rad] of the rectangle, or of the object at the point. None for any.
        below: slot of the other object, -1 without one.
    """

    kind: str
    centre: Array
    half_extents: Array
    yaw: float | None = None
    below: int = -1


class GoalMonitor:
    """Monitors the goal of one episode from its first state on. Call `update` after every control step.

    Attributes:
        goal: the goal.
        unmet: the facts that do not hold.
        steps_met: consecutive control steps in which all facts have held and the robot has let go. It then touches no
            object that the goal places, and objects that it holds touch nothing else.
        moved: names of the objects that have been lifted off their support, in order.
        places: place of each object of the goal, by its slot.
    """

    def __init__(self, world: World, start: Scene, goal: Goal) -> None:
        """Begin with the first state of an episode, as `start_scene` describes it. The goal must fit it."""
        self.goal, self._world = goal, world
        self._start = self._scene = start
        self._facts = {fact: fact.holds(start, start) for fact in goal.facts}
        self.steps_met, self.moved = 0, list[str]()
        self._lifted: set[str] = set()  # of those in hand now
        self._left_at: dict[str, tuple[float, float]] = {}  # x, y where each was last carried
        nowhere = Place("held_up", np.zeros(3), np.zeros(2))
        self.places = {world.names.index(fact.object): self._place(fact) for fact in goal.placed}
        self.places |= {world.names.index(name): nowhere for name in goal.held}
        self._slots = [world.names.index(name) for name in self.named]
        self._standing = set(self._slots) - {world.names.index(name) for name in goal.held}
        self._last: Measurements | None = None
        self._poses = np.array([[*body.position, *body.quaternion] for body in start.objects])
        self.unmet = self._find_unmet()
        self._to_carry = {name for fact in self.unmet for name in self._displaced(fact)}

    @property
    def regions(self) -> tuple[Region, ...]:
        """The regions that the goal may name."""
        return self._start.regions

    @property
    def named(self) -> tuple[str, ...]:
        """Names of the objects that are to be somewhere, or below one that is."""
        names = [*self.goal.held, *(fact.object for fact in self.goal.placed)]
        below = [fact.place for fact in self.goal.placed if isinstance(fact, On) and fact.place in self._start.names]
        return tuple(dict.fromkeys((*names, *below)))

    @property
    def is_reached(self) -> bool:
        """Whether all facts have held for long enough."""
        return self.steps_met >= HOLD_STEPS

    @property
    def moving(self) -> tuple[str, ...]:
        """Names of the objects of the goal that do not stand, or are not held, as it wants them at the start."""
        return tuple(name for name in self.named if name in self._to_carry)

    @property
    def is_carried_out(self) -> bool:
        """Whether every object that had to move was carried to its place. A short push is not regarded as carrying."""
        names, places = self._world.names, {name: self._left_at.get(name) for name in self._to_carry}
        return all(
            place is not None and math.dist(place, self._poses[names.index(name), :2]) <= SETTLING
            for name, place in places.items()
        )

    def is_lost(self, measurements: Measurements) -> bool:
        """Whether an object that the goal places has fallen off all supports. Carried objects may be lower."""
        return bool((measurements.is_off & measurements.is_fallen)[self._slots].any())

    def update(self, measurements: Measurements) -> None:
        """Process the measurements after one more control step."""
        if measurements is not self._last:
            self._judge(measurements)
        self.steps_met = 0 if self.unmet or not self._is_let_go(measurements) else self.steps_met + 1

    def _is_let_go(self, measurements: Measurements) -> bool:
        """Whether the robot touches no object that the goal places, and every object that it holds is in the air."""
        grip = measurements.grip
        is_in_air = all(slot < 0 or carried for slot, carried in zip(grip.held, grip.is_carried, strict=True))
        return is_in_air and self._standing.isdisjoint(self._world.touched)

    def _judge(self, measurements: Measurements) -> None:
        """Look again at the facts of the objects that have moved, or have been grasped or let go."""
        names, grip = self._world.names, measurements.grip
        self._lifted &= {names[slot] for slot in grip.held if slot >= 0}
        for slot in grip.carried:
            name, (x, y) = names[slot], measurements.poses[slot, :2].tolist()
            self._left_at[name] = x, y
            if name not in self._lifted:
                self._lifted.add(name)
                self.moved += [name] if name not in self.moved[-1:] else []  # a grip may be lost for one step
        changed = self._take_over(measurements)
        if changed:
            for fact in self._facts:
                if isinstance(fact, Clear) or not changed.isdisjoint(names_in(fact)):
                    self._facts[fact] = fact.holds(self._scene, self._start)
        self.unmet = self._find_unmet()

    def _take_over(self, measurements: Measurements) -> set[str]:
        """Update the scene. Return names of the objects that have moved, or have been grasped or let go."""
        self._last, scene, names = measurements, self._scene, self._world.names
        held = {names[slot] for slot in measurements.grip.held if slot >= 0}
        objects, changed = list(scene.objects), held ^ set(scene.held_names)
        for slot in np.flatnonzero((measurements.poses != self._poses).any(axis=1)).tolist():
            pose = measurements.poses[slot]
            objects[slot] = objects[slot].at(pose[:3], pose[3:])
            changed.add(names[slot])
        self._poses = measurements.poses
        if changed:
            in_hands = [HeldObject(name, _IN_HAND) for name in sorted(held)]
            first, aside = next(iter(in_hands), None), tuple(AsideObject("", one) for one in in_hands[1:])
            self._scene = replace(scene, objects=tuple(objects), held=first, aside=aside)
        return changed

    def _find_unmet(self) -> tuple[Fact, ...]:
        return tuple(
            fact
            for fact, holds in self._facts.items()
            if not (Goal((fact,)).is_in_order(self.moved) if isinstance(fact, Before) else holds)
        )

    def _displaced(self, fact: Fact) -> Collection[str]:
        """Names of the objects that must move for a fact that does not hold at the start."""
        return occupants(self._start, fact.region) if isinstance(fact, Clear) else {getattr(fact, "object", "")}

    # Places, for the observation and the reward.

    def _place(self, fact: On | Inside | At) -> Place:
        scene = self._start
        if isinstance(fact, At):
            return Place("at_point", np.array([fact.x, fact.y, self._level_at(fact)]), np.zeros(2), fact.yaw)
        name = fact.place if isinstance(fact, On) else fact.region
        for region in scene.regions:
            if region.name == name:
                top = scene.support_named(region.support).top
                return Place("in_area", np.array([*region.centre, top]), np.array(region.half_extents), region.yaw)
        if name in scene.names:
            return Place("on_object", np.zeros(3), np.zeros(2), below=scene.index(name))
        face = scene.support_named(name)
        return Place("in_area", np.array([*face.position[:2], face.top]), face.extent[:2], 0.0)

    def _level_at(self, fact: At) -> float:
        """Height [m] of the face at a place: the highest face, or the highest face up to the fact's height."""
        faces = [self._start.support_named(name) for name in self._start.supports]
        tops = [face.top for face in faces if face.is_under(np.array([fact.x, fact.y]))]
        most = math.inf if fact.z is None else fact.z
        return max((top for top in tops if top <= most), default=self._start.support.top)

    def progress(self, measurements: Measurements) -> float:
        """Progress towards the next fact, between 0 and the sum of `PROGRESS_SCALES`: that of the nearest object.

        Reaching the object, holding it, and carrying it to its place.
        """
        wanted = {fact.object for fact in self.unmet if isinstance(fact, Holding | On | Inside | At)}
        tcp = self._world.data.site_xpos[self._world.index.tcp_site]
        best = 0.0
        for slot, place in self.places.items():
            if self._world.names[slot] not in wanted:
                continue
            body = self._scene.objects[slot]
            is_held = slot in measurements.grip.held
            terms = {
                "reach": 1.0 - math.tanh(REACH_SCALE * math.dist(tcp, body.position)),
                "grasp": float(is_held),
                "carry": is_held * (1.0 - math.tanh(CARRY_SCALE * self._distance(body, place))),
            }
            best = max(best, sum(scale * terms[name] for name, scale in PROGRESS_SCALES.items()))
        return best

    def _distance(self, body: Body, place: Place) -> float:
        """Distance [m] from the foot of an object to its place, 0 within it. 0 for an object to be held up."""
        if place.kind == "held_up":
            return 0.0
        if place.below >= 0:
            below = self._scene.objects[place.below]
            return math.dist(body.foot, (*below.position[:2], below.top))
        yaw = place.yaw or 0.0
        x, y, z = body.foot - place.centre
        along, across = math.cos(yaw) * x + math.sin(yaw) * y, math.cos(yaw) * y - math.sin(yaw) * x
        beyond = np.maximum(np.abs((along, across)) - place.half_extents, 0.0)
        return math.hypot(*beyond, z)

    # Saved states.

    def memory(self) -> dict[str, Any]:
        """The past that a saved state must keep, as JSON values."""
        return {
            "goal": self.goal.to_pddl(),
            "regions": [asdict(region) for region in self.regions],
            "facts": list(self._facts.values()),
            "steps_met": self.steps_met,
            "moved": self.moved,
            "left_at": [[name, *place] for name, place in self._left_at.items()],
        }

    @classmethod
    def recall(cls, memory: GoalMemory, world: World, start: Scene, measurements: Measurements) -> GoalMonitor:
        """The monitor that had this checked `memory` in the state of `world`, bit for bit."""
        monitor = cls(world, start, memory.goal)
        monitor._take_over(measurements)
        monitor._facts = dict(zip(monitor._facts, memory.facts, strict=True))
        monitor.steps_met, monitor.moved = memory.steps_met, list(memory.moved)
        monitor._left_at = dict(memory.left_at)
        monitor._lifted = set(monitor._scene.held_names).intersection(memory.moved[-len(measurements.grip.held) :])
        monitor.unmet = monitor._find_unmet()
        return monitor


def start_scene(robot: RobotSpec, layout: Layout, scene: TableScene, regions: Sequence[Region], goal: Goal) -> Scene:
    """The scene of a reset as the planner sees it, with the regions that the goal may name.

    Raises:
        GoalError, SceneError: a region lies on no support, or the goal means nothing in this scene.
    """
    state = RobotState(scene.base, np.array(robot.home), robot.max_finger_position)
    bodies = [
        replace(_household_body(shape), name=object_name(slot)).at(pose[:3], pose[3:])
        if shape in KINDS
        else Body(object_name(slot), "box" if shape == "box" else "cylinder", half_extents, pose[:3], pose[3:])
        for slot, (shape, half_extents, pose) in enumerate(
            zip(scene.shapes, scene.half_extents, start_poses(scene), strict=True)
        )
    ]
    obstacles = [
        StaticObstacle(box.name, np.array(box.position), np.array(box.half_extents)) for box in furniture(layout)
    ]
    found = Scene(robot, state, tuple(bodies), tuple(obstacles), supports=supports_of(layout), regions=tuple(regions))
    goal.check(found)
    return found


@cache
def _household_body(kind: str) -> Body:
    """A household object as the planner reads it from a simulation, which has its pieces in a frame at their middle."""
    return movable_body(kind_model(kind), 1)


@dataclass(frozen=True)
class GoalMemory:
    """The value of `GoalMonitor.memory`, with its types checked."""

    goal: Goal
    regions: tuple[Region, ...]
    facts: tuple[bool, ...]
    steps_met: int
    moved: tuple[str, ...]
    left_at: tuple[tuple[str, tuple[float, float]], ...]

    @classmethod
    def read(cls, value: object, num_objects: int) -> GoalMemory:
        """Read it.

        Raises:
            StateError: it is not the memory of a goal for these objects.
        """
        read = Fields(value, "memory task", ("goal", "regions", "facts", "steps_met", "moved", "left_at"))
        try:
            goal, regions = Goal.of(read["goal"]), read_regions(read["regions"])
        except GoalError as problem:
            raise StateError(f"memory task: goal of the state: {problem}") from None
        facts, moved = read.flags("facts", len(goal.facts)), read["moved"]
        names = {object_name(slot) for slot in range(num_objects)}
        if not isinstance(moved, list) or not all(isinstance(name, str) and name in names for name in moved):
            raise StateError("memory task: moved of the state must be names of objects")
        left_at = []
        for row in read["left_at"] if isinstance(read["left_at"], list) else [None]:
            match row:
                case [str(name), float(x), float(y)] if name in moved and math.isfinite(x) and math.isfinite(y):
                    left_at.append((name, (x, y)))
                case _:
                    raise StateError("memory task: left_at of the state must be rows of an object that moved, x and y")
        steps_met = read.integer("steps_met", 0, 2**31)
        return cls(goal, regions, tuple(facts.tolist()), steps_met, tuple(moved), tuple(left_at))


def read_regions(value: object) -> tuple[Region, ...]:
    """The regions of a sequence of regions, or of their fields. Raise `GoalError`."""
    known = [entry.name for entry in fields(Region)]
    if not isinstance(value, Sequence) or isinstance(value, str):
        raise GoalError(f"regions must be a list of Regions, not {value!r:.100}")
    found = []
    for entry in value:
        if isinstance(entry, Region):
            found.append(entry)
        elif isinstance(entry, Mapping) and set(entry) <= set(known):
            try:
                found.append(Region(**entry))
            except (TypeError, ValueError) as problem:
                raise GoalError(f"region {dict(entry)!r:.100}: {problem}") from None
        else:
            raise GoalError(f"{entry!r:.100} is no Region; the fields of one are {', '.join(known)}")
    return tuple(found)


def goal_potential(monitor: GoalMonitor, measurements: Measurements) -> float:
    """The potential of a state, between 0 and `reward.MOST`: the share of the facts that hold, and of the next one."""
    count = len(monitor.goal.facts)
    met = count - len(monitor.unmet)
    return MOST * (met + (monitor.progress(measurements) if monitor.unmet else 0.0)) / count
