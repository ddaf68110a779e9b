"""The world as the planner sees it: one immutable snapshot of robot, furniture and objects.

World frame: origin on the floor under the table's centre, x from the robot towards the table, y left, z up.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np

from assets.robots import RobotSpec
from planners.scene.bodies import Body, FurnitureBox, HeldObject, RobotState, SceneError, UnknownObject
from planners.scene.masks import MAX_OBJECTS
from planners.scene.mujoco_reading import furniture_of, objects_of, robot_state_of

__all__ = ["SUPPORT", "Scene"]

SUPPORT = "table_top"
"""The piece of furniture whose top face is R_plane."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything the planner may know, at one instant. Object i of `objects` is bit i of every mask."""

    robot: RobotSpec
    state: RobotState
    objects: tuple[Body, ...]
    furniture: tuple[FurnitureBox, ...]
    held: HeldObject | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "objects", tuple(self.objects))
        object.__setattr__(self, "furniture", tuple(self.furniture))
        if len(self.objects) > MAX_OBJECTS:
            raise SceneError(f"{len(self.objects)} objects; at most {MAX_OBJECTS} fit a mask")
        for kind in (self.names, tuple(box.name for box in self.furniture)):
            if len(set(kind)) != len(kind):
                raise SceneError(f"duplicate names among {', '.join(kind)}")
        if self.held is not None:
            self.index(self.held.name)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Object names in the order of their bits."""
        return tuple(body.name for body in self.objects)

    def index(self, name: str) -> int:
        """Bit of an object.

        Raises:
            UnknownObject: no such object; the message lists the known ones.
        """
        names = self.names
        if name not in names:
            raise UnknownObject(f"no object {name!r}; known objects: {', '.join(names) or 'none'}")
        return names.index(name)

    def body(self, name: str) -> Body:
        """The object of that name; raises `UnknownObject`."""
        return self.objects[self.index(name)]

    @property
    def support(self) -> FurnitureBox:
        """The table top; raises `SceneError` where there is none."""
        for box in self.furniture:
            if box.name == SUPPORT:
                return box
        raise SceneError(f"no furniture {SUPPORT!r}; known: {', '.join(box.name for box in self.furniture) or 'none'}")

    def mask(self, names: Iterable[str]) -> int:
        """The bits of these objects."""
        return sum({1 << self.index(name) for name in names})

    def names_of(self, mask: int) -> tuple[str, ...]:
        """The objects whose bits are set; furniture and self bits are not objects and are left out."""
        return tuple(body.name for i, body in enumerate(self.objects) if int(mask) >> i & 1)

    def with_state(self, state: RobotState) -> Scene:
        """The same scene with the robot elsewhere."""
        return replace(self, state=state)

    def with_body(self, body: Body) -> Scene:
        """The same scene with the object of that name replaced."""
        index = self.index(body.name)
        return replace(self, objects=(*self.objects[:index], body, *self.objects[index + 1 :]))

    def with_held(self, held: HeldObject | None) -> Scene:
        """The same scene with another object, or none, in hand."""
        return replace(self, held=held)

    @classmethod
    def from_mujoco(cls, model: mujoco.MjModel, data: mujoco.MjData, robot: RobotSpec, held: str = "") -> Scene:
        """A snapshot of a simulation; neither `model` nor `data` is written.

        Args:
            model: objects are bodies "object_…" with a free joint and one geom; furniture is box geoms of static
                bodies; the robot has the names of `robot`.
            data: after a step or `mj_forward`.
            robot: which robot it is.
            held: name of the object in hand, "" for none.

        Raises:
            SceneError: an object that is neither cylinder nor box, or furniture that is not axis-aligned.
            UnknownObject: no object named `held`.
        """
        state, objects = robot_state_of(model, data, robot), objects_of(model, data)
        scene = cls(robot, state, objects, tuple(furniture_of(model, data)))
        if not held:
            return scene
        scene.index(held)
        T_world_tcp, T_world_object = np.eye(4), np.eye(4)
        site, body = data.site(robot.tcp_site), data.geom(held)
        T_world_tcp[:3, :3], T_world_tcp[:3, 3] = site.xmat.reshape(3, 3), site.xpos
        T_world_object[:3, :3], T_world_object[:3, 3] = body.xmat.reshape(3, 3), body.xpos
        return scene.with_held(HeldObject(held, np.linalg.inv(T_world_tcp) @ T_world_object))
