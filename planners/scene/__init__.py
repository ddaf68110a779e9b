"""The world as the planner sees it: `Scene`, what it is made of, object masks, and how it is read from MuJoCo."""

from planners.scene.bodies import Body, FurnitureBox, HeldObject, RobotState, SceneError, UnknownObject
from planners.scene.masks import FURNITURE_BIT, MAX_OBJECTS, SELF_BIT
from planners.scene.scene import SUPPORT, Scene

__all__ = [
    "FURNITURE_BIT",
    "MAX_OBJECTS",
    "SELF_BIT",
    "SUPPORT",
    "Body",
    "FurnitureBox",
    "HeldObject",
    "RobotState",
    "Scene",
    "SceneError",
    "UnknownObject",
]
