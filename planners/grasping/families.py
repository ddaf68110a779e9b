"""Families of grasps as data: from which slant, how deep and from how many directions (Lee & Kim 2019, section 3.3).

A grasp set is what a solve chooses grasps from, and what its minimum number of clearances is exact for. The paper's
experiments use level grasps alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType


class UnknownGraspSet(ValueError):
    """There is no grasp set of that name; the message lists the valid ones."""


@dataclass(frozen=True)
class GraspFamily:
    """Grasps that differ only in the direction they come from.

    The TCP is δ above the object's lowest point and ε short of its main axis (Fig. 5). ε is the robot's
    `grasp_axis_offset`, more where the palm would touch the object.

    Attributes:
        name: for messages.
        pitch: [rad] of the gripper; 0 is level, π/2 points straight down.
        directions: n of the paper: grasps of a round object, 360°/n apart. Half of them differ where the gripper points
            straight down.
        depth: [m] of the TCP below the object's highest point, as far as palm and fingertips permit; None for the δ of
            the paper, which is the robot's `grasp_height`.
    """

    name: str
    pitch: float
    directions: int = 24
    depth: float | None = None


SIDE = GraspFamily("side", 0.0)
"""The paper's: a level gripper."""
_TILTED = {degrees: GraspFamily(f"tilted {degrees}°", math.radians(degrees), depth=0.02) for degrees in (20, 40, 60)}
TOP = GraspFamily("top", math.pi / 2, depth=0.02)
"""The gripper points straight down."""

GRASP_SETS: Mapping[str, tuple[GraspFamily, ...]] = MappingProxyType(
    {
        "side": (SIDE,),
        "tilted": (_TILTED[60], _TILTED[40], _TILTED[20]),
        "top": (TOP,),
        "all": (SIDE, _TILTED[60], _TILTED[40], TOP, _TILTED[20]),
    }
)
"""By name; the families of a set come in the order in which they are tried."""


def find_grasp_set(name: str) -> tuple[GraspFamily, ...]:
    """The families of a grasp set.

    Raises:
        UnknownGraspSet: no set of that name; the message lists the valid ones.
    """
    if name not in GRASP_SETS:
        raise UnknownGraspSet(f"no grasp set {name!r}; valid grasp sets: {', '.join(GRASP_SETS)}")
    return GRASP_SETS[name]
