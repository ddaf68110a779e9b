"""What is asked of a motion planner for torso and arm: the situation, and the effort."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.scene import HeldObject


@dataclass(frozen=True, eq=False)
class ArmQuery:
    """The situation in which torso and arm move.

    Attributes:
        base: (3,) x [m], y [m], yaw [rad]: where the base stands; read-only.
        opening: of the gripper [m].
        held: the held object.
        ignore: mask of objects that are not obstacles.
        exact: end at a goal as it is given; else continuous joints may end whole turns away from it, which is the same
            configuration (see `unwrap_joints`).
    """

    base: NDArray[np.float64]
    opening: float
    held: HeldObject | None = None
    ignore: int = 0
    exact: bool = False

    def __post_init__(self) -> None:
        base = np.array(self.base, dtype=float)
        base.setflags(write=False)
        object.__setattr__(self, "base", base)


@dataclass(frozen=True)
class RRTConfig:
    """Effort of one search with RRT-Connect.

    Attributes:
        iterations: random targets at most.
        shortcuts: random shortcuts tried afterwards.
        step: [m] between checks while searching; accepted paths are checked again at `collision.world.STEP`.
        margin: [rad] beyond start and goal within which joints with a range of more than a turn are sampled.
        near: share of the random targets that are drawn about the straight line from start to goal.
    """

    iterations: int = 600
    shortcuts: int = 20
    step: float = 0.015
    margin: float = 1.5
    near: float = 0.8


DEFAULT_EFFORT = RRTConfig()
"""For paths of the arm on a standing base."""
