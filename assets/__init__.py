"""What things are: robots, furniture, PDDL text, trained weights. Imports nothing else of the project."""

from assets.acting_joints import ActingJoints
from assets.files import folder, names, path
from assets.pr2 import PR2
from assets.robot_parts import ArmSpec, ChainLink, InvalidRobot, LinkMesh, rotation_of
from assets.robot_spec import RobotSpec
from assets.robots import FETCH, UnknownRobot, robot

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
