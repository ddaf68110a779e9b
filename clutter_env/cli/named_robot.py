"""Robots that a command line names."""

from __future__ import annotations

import importlib

from assets import RobotSpec, robot


def robot_by_name(name: str) -> RobotSpec:
    """A robot of the project by its name, or the `RobotSpec` that module:NAME refers to.

    Raises:
        ValueError: there is no such robot, module or name, or it is not a `RobotSpec`.
    """
    if ":" not in name:
        return robot(name)
    module, attribute = name.split(":", 1)
    try:
        found = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"there is no robot {name!r}: {error}") from error
    if not isinstance(found, RobotSpec):
        raise ValueError(f"{name} is a {type(found).__name__}, not a RobotSpec")
    return found
