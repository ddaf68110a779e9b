"""The phases of a motion to a contact and away from it, in the order in which they follow one another."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

__all__ = ["AWAY", "FINGERS", "LINES", "NUM_PHASES", "PHASES", "SKILLS", "TOWARDS", "phase_index"]

SKILLS = ("pick", "place")
_PICK = ("drive", "ready", "transit", "approach", "close", "lift", "retreat")
_PLACE = ("drive", "transit", "lower", "open", "rise", "retreat")
PHASES: Mapping[str, tuple[str, ...]] = MappingProxyType({"pick": _PICK, "place": _PLACE})
"""By skill, as the planner's trajectories name them."""
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
