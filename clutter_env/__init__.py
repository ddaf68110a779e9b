"""Registers the environments with Gymnasium, and knows the suites of scenes."""

from collections.abc import Callable, Iterable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from gymnasium.envs.registration import WrapperSpec, register

# One distribution has four top-level packages. Without this check, an import from another package of the same name
# would fail late, or with "cannot import name".
for _name in ("assets", "irm", "planners"):
    _spec = find_spec(_name)
    if _spec and _spec.origin and Path(_spec.origin).parent.parent != Path(__file__).parent.parent:
        raise ImportError(f"{_spec.origin} hides the package {_name!r} of clutter-env: rename it, or leave its folder")

from clutter_env.scene.layout import Box, Layout  # noqa: E402  after the check
from clutter_env.suites import suite, suite_names  # noqa: E402

__all__ = [
    "ARM_RETRIEVE_COUNTS",
    "GOAL_FAMILIES",
    "OBJECT_COUNTS",
    "REARRANGE_COUNTS",
    "SEARCH_COUNTS",
    "SKILL_OBJECT_COUNTS",
    "Box",
    "Layout",
    "rearrange_time_limit",
    "search_time_limit",
    "skill_budget",
    "suite",
    "suite_names",
    "time_limit",
]

OBJECT_COUNTS = (1, 5, 10, 15, 20, 25, 30, 35, 40, 50, 60)
REARRANGE_COUNTS = (4, 8, 12, 20)
SEARCH_COUNTS = (5, 10, 12, 16)
SKILL_OBJECT_COUNTS = (5, 10, 15, 20, 25)

GOAL_FAMILIES = ("reach", "pick", "armreach", "armpick")
"""Families of the goal environments, in which an episode ends only at its time limit."""


def time_limit(num_objects: int) -> int:
    """Control steps in an episode of Retrieve: 20 s, and 11 s for each object.

    This is about 2.5 times the 95% quantile of the expert's episodes. docs/retrieve.md has the measurement and its
    command.
    """
    return 400 + 220 * num_objects


def rearrange_time_limit(num_objects: int) -> int:
    """Control steps in an episode of Rearrange: 20 s, and 50 s for each object."""
    return 400 + 1000 * num_objects


def search_time_limit(num_objects: int) -> int:
    """Control steps in an episode of Search: 60 s, and 40 s for each object."""
    return 1200 + 800 * num_objects


OPEN_TIME_LIMIT = 2000
"""Control steps in an episode of Open: 100 s, for a slow pull, and for objects that must first be put aside."""


def skill_budget(num_objects: int) -> int:
    """Skills allowed in an episode of Skill: enough for some mistakes, too few to try every skill."""
    return 4 + num_objects // 5


ARM_RETRIEVE_COUNTS = (1, 3, 5)
ARM_RETRIEVE_TIME_LIMIT = 100
"""Control steps in an episode of ArmRetrieve. Its script needs at most 75, including one object put aside."""


_ENTRY_POINTS = "clutter_env.envs.instruction"
"""The module that exports all environment classes."""


def _register_counts(name: str, counts: Iterable[int], most_steps: Callable[[int], int], entry_point: str = "") -> None:
    for count in counts:
        register(
            id=f"clutter_env/{name}-o{count}-v0",
            entry_point=f"{_ENTRY_POINTS}:{entry_point or name.lower()}",
            kwargs={"num_objects": count},
            max_episode_steps=most_steps(count),
        )


_register_counts("Retrieve", OBJECT_COUNTS, time_limit)
for _name, _made_by, _steps in (
    ("Reach", "reach", 100),
    ("Pick", "pick", 100),
    ("ArmReach", "arm_reach", 50),
    ("ArmPick", "arm_pick", 50),
):
    register(
        id=f"clutter_env/{_name}-v0",
        entry_point=f"{_ENTRY_POINTS}:{_made_by}",
        max_episode_steps=_steps,
        additional_wrappers=(WrapperSpec("GoalInterface", "clutter_env.envs.goal:GoalInterface", {}),),
    )

register(id="clutter_env/Open-v0", entry_point=f"{_ENTRY_POINTS}:open_", max_episode_steps=OPEN_TIME_LIMIT)
_register_counts("Rearrange", REARRANGE_COUNTS, rearrange_time_limit)
_register_counts("Search", SEARCH_COUNTS, search_time_limit)
_register_counts("ArmRetrieve", ARM_RETRIEVE_COUNTS, lambda _: ARM_RETRIEVE_TIME_LIMIT, "arm_retrieve")
_register_counts("Skill", SKILL_OBJECT_COUNTS, skill_budget)


def __getattr__(name: str) -> Any:
    """`__version__`, read on first use, so that importing the package stays fast."""
    if name == "__version__":
        from clutter_env.version import version

        return version()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
