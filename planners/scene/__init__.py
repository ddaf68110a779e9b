"""World model of the planner: `Scene`, its parts, object masks, and the reading of a MuJoCo simulation."""

from planners.scene.bodies import AsideObject, Body, HeldObject, ParkedArm, RobotState, UnknownObject
from planners.scene.masks import MAX_OBJECTS, SELF_BIT, STATIC_BIT
from planners.scene.openings import Opening, Pull, UnknownOpening
from planners.scene.scene import SUPPORT, Scene
from planners.scene.solid import FLOOR, SceneError, Solid, StaticObstacle

__all__ = [
    "FLOOR",
    "MAX_OBJECTS",
    "SELF_BIT",
    "STATIC_BIT",
    "SUPPORT",
    "AsideObject",
    "Body",
    "HeldObject",
    "Opening",
    "ParkedArm",
    "Pull",
    "RobotState",
    "Scene",
    "SceneError",
    "Solid",
    "StaticObstacle",
    "UnknownObject",
    "UnknownOpening",
]
