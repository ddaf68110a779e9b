"""World model of the planner: one immutable snapshot of robot, movable objects and static obstacles.

The world frame has z up, with the robot's ground at z = 0. See `Scene.ground`.
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
"""[m] Half extents of the box about the robot that represents the floor as a support."""
_SUNK = 0.02
"""[m] Largest depth of an object's lowest point below its support's top, by soft contacts and rounding."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Complete input of the planner at one instant. Object i of `objects` is bit i of every mask.

    Attributes:
        robot: which robot it is.
        state: state of the robot.
        objects: movable objects: cylinders, boxes, objects of several convex pieces.
        static_obstacles: obstacles without allowed contact, including the support. The ground z = 0 always exists in
            addition.
        held: the object in the gripper, None for none. The fingers are commanded to close on it, whatever the finger
            position of the given `state`.
        aside: objects that idle arms hold in their home configuration, by arm. They move with the robot.
        parked: configurations of arms that were active before. The others are at home.
        supports: names of the static obstacles on whose level top faces objects may be put. The first is R_plane of the
            paper. "floor" is the floor, and () means only the floor. Objects may stand elsewhere too, see
            `support_under`.
        regions: named rectangles on supports, for goals.
        openings: drawers, doors, lids and knobs, whose parts are among the static obstacles.
        pull: a handle among the objects, to be pulled. None in scenes read from a model.
        ground: height of the scene's z = 0 in its model [m]: that of the ground or table on which the robot stands. All
            heights of the scene and its plans are measured from there.
        support_bodies: names of the model's bodies with exactly one support among their parts, each with the name of
            this support. Goals may use either name.
        findings: problems of objects that need the model. `planners.check` adds the others.

    Raises:
        SceneError: two objects, static obstacles or regions have the same name, a mask cannot hold all objects, or a
            region lies on no support.
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
            # A command to close completely makes the fingers press on the object between them.
            object.__setattr__(self, "state", replace(self.state, finger_position=0.0))
        for one in self.aside:
            self.index(one.held.name)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Object names in the order of their bits."""
        return tuple(body.name for body in self.objects)

    def index(self, name: str) -> int:
        """Bit of an object. Raises `UnknownObject`."""
        names = self.names
        if name not in names:
            raise UnknownObject(f"no object {name!r}; known objects: {', '.join(names) or 'none'}")
        return names.index(name)

    def body(self, name: str) -> Body:
        """The object of that name. Raises `UnknownObject`."""
        return self.objects[self.index(name)]

    def opening(self, name: str) -> Opening:
        """The opening of that name. Raises `UnknownOpening`."""
        for one in self.openings:
            if one.name == name:
                return one
        known = ", ".join(one.name for one in self.openings) or "none"
        raise UnknownOpening(f"nothing called {name!r} opens; what does: {known}")

    @property
    def support(self) -> StaticObstacle:
        """The first support, R_plane of the paper, or the floor. Raises `SceneError` if it has no level top."""
        return self.support_named(self.supports[0] if self.supports else FLOOR)

    def support_under(self, body: Body) -> StaticObstacle:
        """Support of an object, regardless of other objects: the highest level top under its centre, or the floor.

        The support of an object in the air is that on which it would fall.
        """
        level = (one for one in self.static_obstacles if one.has_level_top and one.top <= body.bottom + _SUNK)
        under = [one for one in level if one.is_under(body.position[:2])]
        return max(under, key=lambda one: one.top, default=self._floor)

    @cached_property
    def _floor(self) -> StaticObstacle:
        """The floor near the robot, as a support."""
        return StaticObstacle(FLOOR, np.append(self.state.base[:2], -_FLOOR_SIZE[2]), _FLOOR_SIZE)

    def support_named(self, name: str) -> StaticObstacle:
        """Find the static obstacle of that name, on which objects can be put.

        Raises:
            SceneError: no static obstacle of that name has a level top. The message lists those with a level top.
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
        """Names of the objects in the grippers, that of the active arm first. () for none."""
        in_hand = () if self.held is None else (self.held.name,)
        return (*in_hand, *(one.held.name for one in self.aside))

    @property
    def arms_that_hold(self) -> tuple[str, ...]:
        """Names of the arms that hold an object."""
        active = () if self.held is None else (self.robot.arm_name,)
        return (*active, *(one.arm for one in self.aside))

    def mask(self, names: Iterable[str]) -> int:
        """Mask of these objects."""
        return sum({1 << self.index(name) for name in names})

    def names_of(self, mask: int) -> tuple[str, ...]:
        """Names of the objects in a mask, without the bits of static obstacles and the robot."""
        return tuple(body.name for i, body in enumerate(self.objects) if int(mask) >> i & 1)

    def moved_since(self, before: Scene) -> int:
        """Mask of the objects with changed poses, or held in only one scene. All objects if the scenes have different
        ones.

        The robot is ignored.
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
        """The same scene with the robot in another state."""
        return replace(self, state=state)

    def with_body(self, body: Body) -> Scene:
        """The same scene with the object of that name replaced."""
        index = self.index(body.name)
        return replace(self, objects=(*self.objects[:index], body, *self.objects[index + 1 :]))

    def with_held(self, held: HeldObject | None) -> Scene:
        """The same scene with another object, or none, in the gripper."""
        return replace(self, held=held)

    def using(self, arm: str) -> Scene:
        """The same scene with another arm active. The present arm is assumed to be at home.

        Raises:
            InvalidRobot: no such arm. The message lists the arms.
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
        """The same scene with the arm active that holds an object. None if no arm holds it."""
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
        """Read a snapshot of a simulation. Both `model` and `data` stay unchanged.

        Each finger is assumed to be commanded to its position, unless an object is held. All geoms except those of the
        robot and of movable bodies are static obstacles at their present poses. Among them, bodies on one slide or
        hinge with a range are openings, see `openings`.

        Args:
            model: a model that contains the robot, with the names of `robot`.
            data: after a step or `mj_forward`.
            robot: which robot it is.
            held: name of the object in the gripper, "" for none.
            movable: names of the movable bodies, or a predicate on the names of free bodies. By default names that
                begin with "object_". Each has a single free joint. Its colliding geoms are one cylinder or box, or any
                number of boxes, cylinders, capsules, spheres, ellipsoids and meshes (as convex hulls).
            support: name of the geom on whose level top face objects are put, or of its body. "floor" means the floor.
                By default "table_top" if it exists, or the support of most objects.
            more_supports: names of other geoms or bodies on which objects may be put. By default the geoms of the
                model's custom tuple "supports".
            obstacles: predicate on `model.geom(id)` for every geom that is neither on the robot nor on a movable body.
                By default all colliding geoms are static obstacles.
            regions: named rectangles on supports, for goals.
            handles: names of the handle geoms of each opening, by the name of its body. By default geoms with "handle",
                "knob", "pull" or "grip" in their name or that of their body, or slender parts.

        Raises:
            SceneError: a movable body has other joints, a geom cannot be represented, a name is missing, or `data` has
                no poses yet. The message names the cause and lists the valid names.
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
