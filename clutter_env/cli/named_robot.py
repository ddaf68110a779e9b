"""Robots that a command line names."""

from __future__ import annotations

import importlib

from assets import RobotSpec, robot
from clutter_env.errors import UsageError


def robot_by_name(name: str) -> RobotSpec:
    """A robot of the project by its name, or the `RobotSpec` that module:NAME refers to.

    Raises:
        UsageError: there is no such robot, module or name, or it is not a `RobotSpec`.
    """
    module, _, attribute = name.partition(":")
    if not (module and attribute):
        return robot(name)
    try:
        found = getattr(importlib.import_module(module), attribute, None)
    except ModuleNotFoundError as problem:
        if not f"{module}.".startswith(f"{problem.name}."):
            raise  # an import in the user's module
        raise UsageError(f"there is no robot {name!r}: {problem}") from problem
    if found is None:
        raise UsageError(f"there is no robot {name!r}: {module} has no {attribute}")
    if not isinstance(found, RobotSpec):
        raise UsageError(f"{name} is a {type(found).__name__}, not a RobotSpec")
    return found
