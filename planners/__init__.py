"""Task and motion planning: actions, their order and their paths.

Example:
    scene = Scene.from_mujoco(env.unwrapped.model, env.unwrapped.data, env.unwrapped.robot)
    solution = solve(scene, "object_03")

A strategy and a task planner of your own are passed as objects: a `Strategy`, anything with the `TaskPlanner` protocol.

Names are loaded on first use, so that `planners.goals` needs no compiled code.
"""

from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from planners.face import *  # noqa: F403  it holds nothing else


def __getattr__(name: str) -> Any:
    """Load a name of `planners.face`. Modules of this package are left to the import system."""
    if name == "__all__":
        return __dir__()
    if name.startswith("_") or find_spec(f"{__name__}.{name}"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(import_module("planners.face"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    """Names of the package."""
    return [name for name in dir(import_module("planners.face")) if not name.startswith("_")]
