"""What things are: robots, PDDL text, trained weights. Imports of the project only `irm.chain`, to read MJCF files."""

from typing import TYPE_CHECKING, Any

from assets.files import folder, names, path

if TYPE_CHECKING:
    from assets.contacts import RobotContacts, paired_name, robot_contacts
    from assets.robots import (
        FETCH,
        PR2,
        ActingJoints,
        ArmSpec,
        ChainLink,
        InvalidRobot,
        LinkMesh,
        RobotSpec,
        UnknownRobot,
        robot,
        robot_names,
        rotation_of,
    )

__all__ = [
    "FETCH",
    "PR2",
    "ActingJoints",
    "ArmSpec",
    "ChainLink",
    "InvalidRobot",
    "LinkMesh",
    "RobotContacts",
    "RobotSpec",
    "UnknownRobot",
    "folder",
    "names",
    "paired_name",
    "path",
    "robot",
    "robot_contacts",
    "robot_names",
    "rotation_of",
]


if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        """Everything about robots, made when it is first asked for: `import assets` for a file's path stays fast."""
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from assets import contacts, robots

        return getattr(contacts if hasattr(contacts, name) else robots, name)
