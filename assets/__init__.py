"""What things are: robots, furniture, PDDL text, trained weights. Imports nothing else of the project."""

from assets.acting_joints import ActingJoints
from assets.files import folder, names, path
from assets.frames import rotation_of
from assets.robots import FETCH, PR2, ArmSpec, ChainLink, InvalidRobot, LinkMesh, RobotSpec, UnknownRobot, robot

__all__ = [
    "FETCH",
    "PR2",
    "ActingJoints",
    "ArmSpec",
    "ChainLink",
    "InvalidRobot",
    "LinkMesh",
    "RobotSpec",
    "UnknownRobot",
    "folder",
    "names",
    "path",
    "robot",
    "rotation_of",
]
