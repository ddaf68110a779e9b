"""The arguments of `clutter-env table`. `clutter-env episode` and scripts make such tables too."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

STRATEGIES = ("lookahead", "ngr", "dogar", "srivastava")
"""The strategies of the planner, which takes long to import."""


@dataclass(frozen=True)
class Arguments:
    """Make the clearance table."""

    objects: tuple[int, ...] = (15, 20, 25, 30, 35, 40, 50, 60)
    """Numbers of objects on the table, the target among them."""
    strategies: tuple[str, ...] = STRATEGIES
    """Strategies. The others are compared with the first one."""
    scenes: int = 100
    """Scenes for each number of objects."""
    obstructed: bool = True
    """Leave out scenes in which a level gripper takes the target at once."""
    seed: int = 100_000
    """First seed of the scenes."""
    robot: str = "fetch"
    """Name of the robot."""
    layout: str = "paper"
    """Layout of the table."""
    grasps: Literal["side", "tilted", "top", "all"] = "side"
    """Grasp set: level gripper (the paper's experiment), tilted, from above, or all of them, as `planners.solve` uses
    unless told otherwise."""
    supports: tuple[str, ...] = ()
    """Supports on which objects may be put: all, table, or names of the layout's supports. If not given, the table
    alone with side grasps, and all supports with the others."""
    physics: bool = False
    """Let the expert execute its plans in physics, where the environment decides about success. An episode has 1500
    control steps for each object, as in a suite in which all others must be cleared."""
    control_mode: Literal["joint", "ee"] = "joint"
    """Control mode."""
    time_limit: float = 20.0
    """[s] of wall time for one solve."""
    workers: int = os.cpu_count() or 1
    """Number of processes."""
    out: Path = Path("outputs/clearance_table")
    """Directory of trials.jsonl, table.json, table.md and table.png."""
    json: Path | None = None
    """Write the figures to this file too."""
