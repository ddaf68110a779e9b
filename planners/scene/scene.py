"""The world as the planner sees it: one immutable snapshot of robot, movable objects and static obstacles.

World frame: z up, the ground on which the robot stands at z = 0; see `Scene.ground`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

import mujoco
import numpy as np

from assets.robots import RobotSpec
from planners.regions import Region
from planners.scene.bodies import (
    AsideObject,
    Body,
    HeldObject,
    ParkedArm,
    RobotState,
    UnknownObject,
    pose_matrix,
)
from planners.scene.findings import Finding, model_findings
from planners.scene.masks import MAX_OBJECTS
from planners.scene.mujoco_reading import (
    IsObstacle,
    Movable,
    MovableBodies,
    RobotJoints,
    declared_supports,
    find_supports,
    is_object_name,
    likely_support,
    measured_from,
    openings_of,
    require_floor,
    robot_state_of,
    static_obstacles_of,
    support_bodies,
)
from planners.scene.openings import Opening, Pull, UnknownOpening
from planners.scene.robot_names import robot_prefix
from planners.scene.solid import FLOOR, SceneError, StaticObstacle

SUPPORT = "table_top"
"""Name of the support in the scenes of this package."""
_FLOOR_SIZE = np.array([1.5, 1.5, 0.5])
"""[m] Half extents of the box under the floor, about the robot, that the floor is as a support."""
_SUNK = 0.02
"""[m] that the lowest point of an object may be below the top of what it stands on: soft contacts, rounding."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything that the planner may know, at one instant. Object i of `objects` is bit i of every mask.

    Attributes:
        robot: which robot it is.
        state: where it is.
        objects: what may be moved: cylinders, boxes, objects of several convex pieces.
        static_obstacles: what may not be touched, the support among it; the ground z = 0 is always there.
        held: the object in the gripper, None for none. The fingers are commanded to close on it, whatever finger
            position `state` was given with.
        aside: objects that idle arms hold in their home configuration, by arm; they move with the robot.
        parked: where arms that were active before were left; the others are at home.
        supports: names of the static obstacles on whose level top faces objects may be put, the first of them R_plane
            of the paper; "floor" is the floor, and () the floor alone. Objects may stand anywhere: see `support_under`.
        regions: named rectangles on supports, for goals.
        openings: drawers, doors, lids and knobs, whose parts are among the static obstacles.
        pull: a handle that stands among the objects, to be pulled; None in scenes as they are.
        ground: [m] height of the scene's z = 0 in the model that it was read from: that of the ground, or of the table,
            on which the robot stands. All heights of the scene and of its plans are measured from there.
        support_bodies: names of bodies of the model of which one support alone is a part, each with the name of that
            support; goals that are solved may use either.
        findings: what is odd about the objects that only the model tells; `planners.check` adds the rest.

    Raises:
        SceneError: two objects, static obstacles or regions have the same name, there are too many objects for a mask,
            or a region lies on no support.
        UnknownObject: the object in the gripper is not among the objects.
    """

    robot: RobotSpec
    state: RobotState
    objects: tuple[Body, ...]
    static_obstacles: tuple[StaticObstacle, ...]
    held: HeldObject | None = None
    supports: tuple[str, ...] = (SUPPORT,)
    aside: tuple[AsideObject, ...] = ()
    parked: tuple[ParkedArm, ...] = ()
    regions: tuple[Region, ...] = ()
    openings: tuple[Opening, ...] = ()
    pull: Pull | None = None
    ground: float = 0.0
    support_bodies: tuple[tuple[str, str], ...] = ()
    findings: tuple[Finding, ...] = ()

    def __post_init__(self) -> None:
        for name in ("objects", "static_obstacles", "supports", "regions", "openings"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        if len(self.objects) > MAX_OBJECTS:
            raise SceneError(f"{len(self.objects)} objects; at most {MAX_OBJECTS} fit a mask")
        for kind in (self.names, tuple(obstacle.name for obstacle in self.static_obstacles), self.supports):
            if len(set(kind)) != len(kind):
                raise SceneError(f"duplicate names among {', '.join(kind)}")
        taken = {*self.names, *self.supports}
        for region in self.regions:
            if not isinstance(region, Region):
                raise SceneError(f"regions are of the class planners.Region, not {region!r:.100}")
            if region.name in taken:
                raise SceneError(f"region {region.name!r} has the name of another region, a support or an object")
            if region.support not in self.supports:
                known = ", ".join(self.supports) or "none"
                raise SceneError(f"region {region.name!r} is on {region.support!r}, no support; known: {known}")
            taken.add(region.name)
        if self.held is not None:
            self.index(self.held.name)
            # Commanded to close completely, the fingers press on what is between them.
            object.__setattr__(self, "state", replace(self.state, finger_position=0.0))
        for one in self.aside:
            self.index(one.held.name)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Object names in the order of their bits."""
        return tuple(body.name for body in self.objects)

    def index(self, name: str) -> int:
        """Bit of an object; raises `UnknownObject`."""
        names = self.names
        if name not in names:
            raise UnknownObject(f"no object {name!r}; known objects: {', '.join(names) or 'none'}")
        return names.index(name)

    def body(self, name: str) -> Body:
        """The object of that name; raises `UnknownObject`."""
        return self.objects[self.index(name)]

    def opening(self, name: str) -> Opening:
        """What opens of that name; raises `UnknownOpening`."""
        for one in self.openings:
            if one.name == name:
                return one
        known = ", ".join(one.name for one in self.openings) or "none"
        raise UnknownOpening(f"nothing called {name!r} opens; what does: {known}")

    @property
    def support(self) -> StaticObstacle:
        """The first support, R_plane of the paper, else the floor; raises `SceneError` if it has no level top."""
        return self.support_named(self.supports[0] if self.supports else FLOOR)

    def support_under(self, body: Body) -> StaticObstacle:
        """What carries an object, other objects aside: the highest level top under its centre, or the floor.

        An object in the air is over the support that it would fall on.
        """
        level = (one for one in self.static_obstacles if one.has_level_top and one.top <= body.bottom + _SUNK)
        under = [one for one in level if one.is_under(body.position[:2])]
        return max(under, key=lambda one: one.top, default=self._floor)

    @cached_property
    def _floor(self) -> StaticObstacle:
        """The floor near the robot, as a support."""
        return StaticObstacle(FLOOR, np.append(self.state.base[:2], -_FLOOR_SIZE[2]), _FLOOR_SIZE)

    def support_named(self, name: str) -> StaticObstacle:
        """The static obstacle of that name, on which objects can be put.

        Raises:
            SceneError: none of that name has a level top; the message lists those that have one.
        """
        for obstacle in self.static_obstacles:
            if obstacle.name == name and obstacle.has_level_top:
                return obstacle
        if name == FLOOR:
            return self._floor
        level = [obstacle for obstacle in self.static_obstacles if obstacle.has_level_top]
        known = ", ".join(f"{obstacle.name} ({obstacle.top:.2f} m)" for obstacle in level) or "none"
        raise SceneError(f"no support {name!r}; static obstacles with a level top: {known}")

    @property
    def held_names(self) -> tuple[str, ...]:
        """Names of the objects in the grippers, that of the active arm first; () for none."""
        in_hand = () if self.held is None else (self.held.name,)
        return (*in_hand, *(one.held.name for one in self.aside))

    @property
    def arms_that_hold(self) -> tuple[str, ...]:
        """Names of the arms that hold an object."""
        active = () if self.held is None else (self.robot.arm_name,)
        return (*active, *(one.arm for one in self.aside))

    def mask(self, names: Iterable[str]) -> int:
        """The bits of these objects."""
        return sum({1 << self.index(name) for name in names})

    def names_of(self, mask: int) -> tuple[str, ...]:
        """The objects whose bits are set; the bits of static obstacles and of the robot are left out."""
        return tuple(body.name for i, body in enumerate(self.objects) if int(mask) >> i & 1)

    def moved_since(self, before: Scene) -> int:
        """Mask of the objects with other poses than before, or that are held in one scene alone; all, if others exist.

        The robot does not matter.
        """
        if self.names != before.names:
            return (1 << max(len(self.names), len(before.names))) - 1
        mask = self.mask(self.held_names) ^ before.mask(before.held_names)
        for index, (now, then) in enumerate(zip(self.objects, before.objects, strict=True)):
            if now is not then and not np.array_equal(
                (*now.position, *now.quaternion), (*then.position, *then.quaternion)
            ):
                mask |= 1 << index
        return mask

    def with_state(self, state: RobotState) -> Scene:
        """The same scene with the robot elsewhere."""
        return replace(self, state=state)

    def with_body(self, body: Body) -> Scene:
        """The same scene with the object of that name replaced."""
        index = self.index(body.name)
        return replace(self, objects=(*self.objects[:index], body, *self.objects[index + 1 :]))

    def with_held(self, held: HeldObject | None) -> Scene:
        """The same scene with another object, or none, in the gripper."""
        return replace(self, held=held)

    def using(self, arm: str) -> Scene:
        """The same scene with another arm active; the one that is active now is taken to be at home.

        Raises:
            InvalidRobot: there is no such arm; the message lists the arms.
        """
        if arm == self.robot.arm_name:
            return self
        robot = self.robot.using(arm)
        left_at = next((one.q for one in self.parked if one.arm == arm), robot.home[1:])
        state = RobotState(self.state.base, np.array((self.state.q[0], *left_at)), 0.0)
        parked = (ParkedArm(self.robot.arm_name, self.state.q[1:]), *(one for one in self.parked if one.arm != arm))
        held = next((one.held for one in self.aside if one.arm == arm), None)
        aside = tuple(one for one in self.aside if one.arm != arm)
        if self.held is not None:
            aside = (*aside, AsideObject(self.robot.arm_name, self.held))
        return replace(self, robot=robot, state=state, held=held, aside=aside, parked=parked)

    def holding(self, name: str) -> Scene | None:
        """The same scene with the arm active that holds that object; None if none holds it."""
        if self.held is not None and self.held.name == name:
            return self
        return next((self.using(one.arm) for one in self.aside if one.held.name == name), None)

    @classmethod
    def from_mujoco(
        cls,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        robot: RobotSpec,
        held: str = "",
        *,
        movable: Movable = is_object_name,
        support: str | None = None,
        more_supports: Collection[str] | None = None,
        obstacles: IsObstacle | None = None,
        regions: Iterable[Region] = (),
        handles: Mapping[str, Sequence[str]] = MappingProxyType({}),
    ) -> Scene:
        """A snapshot of a simulation; neither `model` nor `data` is written.

        Each finger counts as commanded to where it is, unless an object is held.
        What is neither the robot nor movable is a static obstacle where it is now. Of these, bodies on one slide or
        hinge with a range open: see `openings`.

        Args:
            model: it contains the robot, with the names of `robot`.
            data: after a step or `mj_forward`.
            robot: which robot it is.
            held: name of the object in the gripper, "" for none.
            movable: names of the bodies that may be moved, or a predicate on the names of free bodies; by default
                names that begin with "object_". Each has one free joint; of geoms that can touch, one cylinder or box,
                or any number of boxes, cylinders, capsules, spheres, ellipsoids and meshes (their convex hulls).
            support: name of the geom on whose level top face objects are put, or of the body that it belongs to;
                "floor" for the floor; by default "table_top" where there is one, else what most objects stand on.
            more_supports: names of other geoms or bodies on which objects may be put; by default those that the model
                declares, the geoms of its custom tuple "supports".
            obstacles: predicate that is asked with `model.geom(id)` for every geom that is neither on the robot nor on
                a movable body; by default geoms that can touch something are static obstacles.
            regions: named rectangles on supports, for goals.
            handles: by the name of a body that opens, the names of the geoms by which it is taken; by default those
                with "handle", "knob", "pull" or "grip" in the name of the geom or its body, else its slender parts.

        Raises:
            SceneError: a movable body with joints of its own, a geom that cannot be represented, a name that is
                missing; the message says which, and lists the valid names. Or `data` has no poses yet.
            UnknownObject: no object named `held`.
        """
        if not data.geom_xmat.any():
            raise SceneError("the simulation has no poses yet; call mujoco.mj_forward(model, data) first")
        bodies = MovableBodies.of(model, robot, movable)
        ground = RobotJoints.of(model, data, robot).ground
        findings = model_findings(model, robot, bodies.bodies.tolist(), data)
        data = measured_from(ground, model, data)
        found = static_obstacles_of(model, data, robot, bodies.bodies, obstacles)
        if isinstance(more_supports, str):
            raise SceneError(f"more_supports is a collection of names, not one string; use [{more_supports!r}]")
        others = declared_supports(model) if more_supports is None else more_supports
        objects = bodies.read(data)
        if support is None:
            is_there = any(SUPPORT in (one.obstacle.name, one.body) for one in found if one.obstacle.has_level_top)
            support = SUPPORT if is_there else likely_support(found, objects)
        supports = find_supports(found, (support, *others), objects)
        if FLOOR in supports and all(one.obstacle.name != FLOOR for one in found):
            require_floor(model, data, ground)
        scene = cls(
            robot,
            robot_state_of(model, data, robot),
            objects,
            tuple(one.obstacle for one in found),
            supports=supports,
            regions=tuple(regions),
            openings=openings_of(model, data, robot, found, handles),
            ground=ground,
            support_bodies=support_bodies(found, supports),
            findings=findings,
        )
        if not held:
            return scene
        site = data.site(robot_prefix(model, robot) + robot.tcp_site)
        body = bodies.read_one(data, scene.index(held))
        return scene.with_held(HeldObject.grasped(body, pose_matrix(site.xpos, site.xmat)))
