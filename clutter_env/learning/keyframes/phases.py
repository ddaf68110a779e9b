"""The phases of a motion to a contact and away from it, in the order in which they follow one another."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

__all__ = [
    "AWAY",
    "BOARD_PHASES",
    "DRIVEN",
    "FINGERS",
    "LINES",
    "NUM_BOARD_PHASES",
    "NUM_PHASES",
    "PHASES",
    "RIGID",
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
RIGID: Mapping[str, str] = MappingProxyType({"transit": "reach", "enter": "reach", "leave": "back"})
"""Under a board, phases with the arm configuration of another one."""
_PICK_UNDER = ("drive", "ready", "transit", "enter", "reach", "close", "lift", "back", "leave", "retreat")
_PLACE_UNDER = ("drive", "transit", "enter", "reach", "lower", "open", "back", "leave", "retreat")
BOARD_PHASES: Mapping[str, tuple[str, ...]] = MappingProxyType({"pick": _PICK_UNDER, "place": _PLACE_UNDER})
"""By skill, under a board; see `under_board`."""
LINES = ("approach", "lift", "lower", "rise")
"""Straight lines of the gripper to a contact and away from it."""
TOWARDS, AWAY = ("approach", "lower"), ("lift", "rise")
"""Those that lead to it, and away from it."""
FINGERS = ("ready", "close", "open")
"""Only the fingers move."""

_OPEN = tuple((skill, phase) for skill in SKILLS for phase in PHASES[skill])
_ALL = (*_OPEN, *((skill, phase) for skill in SKILLS for phase in DRIVEN))
NUM_PHASES, NUM_BOARD_PHASES = len(_OPEN), len(_ALL) - len(_OPEN)
"""How many phases there are in the open, and how many more under a board; their numbers follow those in the open."""


def phase_index(skill: str, phase: str) -> int | None:
    """Number of a phase of a skill among all; None for a phase that is not learned."""
    return _ALL.index((skill, phase)) if (skill, phase) in _ALL else None
