"""The phases of a motion to a contact and away from it, in the order in which they follow one another."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

__all__ = [
    "AWAY",
    "BOARD_PHASES",
    "DRIVEN",
    "ELSEWHERE",
    "FINGERS",
    "LINES",
    "NUM_PHASES",
    "PHASES",
    "SKILLS",
    "TOWARDS",
    "phase_index",
]

SKILLS = ("pick", "place")
_PICK = ("drive", "ready", "transit", "approach", "close", "lift", "retreat")
_PLACE = ("drive", "transit", "lower", "open", "rise", "retreat")
PHASES: Mapping[str, tuple[str, ...]] = MappingProxyType({"pick": _PICK, "place": _PLACE})
"""By skill, as the planner's trajectories name them."""
DRIVEN = ("enter", "reach", "back", "leave")
"""Straight drives of the base under a board and out again, the arm rigid: to where the gripper is about to reach around
the object, along the gripper to the contact, and back."""
_PICK_UNDER = ("drive", "ready", "transit", "enter", "reach", "close", "lift", "back", "leave", "retreat")
_PLACE_UNDER = ("drive", "transit", "enter", "reach", "lower", "open", "back", "leave", "retreat")
BOARD_PHASES: Mapping[str, tuple[str, ...]] = MappingProxyType({"pick": _PICK_UNDER, "place": _PLACE_UNDER})
"""By skill, under a board; see `boards.cutting`."""
ELSEWHERE = ("transit", *DRIVEN)
"""Phases under a board whose arm configuration is one of a straight line at the contact."""
LINES = ("approach", "lift", "lower", "rise")
"""Straight lines of the gripper to a contact and away from it."""
TOWARDS, AWAY = ("approach", "lower"), ("lift", "rise")
"""Those that lead to it, and away from it."""
FINGERS = ("ready", "close", "open")
"""Only the fingers move."""

_ALL = tuple((skill, phase) for skill in SKILLS for phase in PHASES[skill])
NUM_PHASES = len(_ALL)


def phase_index(skill: str, phase: str) -> int | None:
    """Number of a phase of a skill among all; None for a phase that is not learned."""
    return _ALL.index((skill, phase)) if (skill, phase) in _ALL else None
