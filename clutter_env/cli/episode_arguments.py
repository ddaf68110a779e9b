"""The arguments of `clutter-env episode`."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal


@dataclass(frozen=True)
class Arguments:
    """Run the expert."""

    objects: int = 15
    """Number of objects on the table, the target among them."""
    seed: int = 0
    """Random seed of the scene."""
    strategy: str = "lookahead"
    """lookahead, ngr (Lee & Kim 2019), dogar or srivastava."""
    task: Literal["", "sort", "set", "swap", "stack", "fetch", "search"] = ""
    """A task of Rearrange, with 4, 8, 12 or 20 objects; search: for a target that no camera sees, 5, 10, 12 or 16;
    empty: retrieve a target."""
    layout: str = ""
    """Table and surroundings. Empty: "paper", or the task's."""
    robot: str = "fetch"
    """Name of the robot, or its MJCF file with its page beside it, arm.xml and arm.json."""
    grasps: Literal["", "side", "tilted", "top", "all"] = ""
    """Grasp set: level gripper (the paper's experiment), tilted, from above, or all of them, as is the default of
    `planners.solve`. Empty: side, for a task all."""
    control_mode: Literal["joint", "ee"] = "joint"
    """Joint targets, or TCP poses."""
    obstructed: bool = True
    """Take the first seed, from --seed on, whose target no level grasp reaches before something is cleared."""
    episodes: int = 1
    """With more than one, episodes are counted, not shown."""
    workers: int = os.cpu_count() or 1
    """Number of processes for many episodes."""
    viewer: bool = False
    """Open MuJoCo's viewer, in real time."""
    live: bool = False
    """Show the running episode in a browser of this machine, in real time. Its address is printed."""
    html: Path | None = None
    """The episode as one page for a browser. episode.html in --out if not given."""
    film: bool = True
    """Film the episode if the machine can render."""
    out: Path = Path("outputs/episode")
    """Directory of the pictures, the plan, the film and the figures."""
    json: Path | None = None
    """Write the figures to this file too."""

    def __post_init__(self) -> None:
        from assets import robot
        from clutter_env import OBJECT_COUNTS, REARRANGE_COUNTS, SEARCH_COUNTS
        from clutter_env.envs.rearrange_tasks import TASKS
        from clutter_env.scene.layout import find_layout
        from planners import find_strategy

        usual = {"": "paper", "search": "shelf"}
        object.__setattr__(self, "layout", self.layout or usual.get(self.task) or TASKS[self.task].layout)
        object.__setattr__(self, "grasps", self.grasps or ("all" if self.task else "side"))
        find_strategy(self.strategy)
        robot(self.robot)
        find_layout(self.layout)
        if self.episodes < 1:
            raise ValueError(f"--episodes {self.episodes} is not valid; it must be at least 1")
        if self.task and self.episodes > 1:
            raise ValueError("--episodes is without --task; of tasks: clutter-env evaluate --suite sort-8-v3")
        if self.task == "search" and (self.viewer or self.live):
            raise ValueError("--viewer and --live are not with --task search; its film and its page are written")
        counts = {"": OBJECT_COUNTS, "search": SEARCH_COUNTS}.get(self.task, REARRANGE_COUNTS)
        if self.objects not in counts:
            valid = ", ".join(map(str, counts))
            raise ValueError(f"--objects {self.objects} is not valid; valid numbers: {valid}")

    @property
    def display(self) -> str:
        """Display of the running episode: "viewer", "live", "film" or "none"."""
        return "viewer" if self.viewer else "live" if self.live else "film" if self.film else "none"

    @property
    def environment(self) -> str:
        """Id of the environment."""
        family = {"": "Retrieve", "search": "Search"}.get(self.task, "Rearrange")
        return f"clutter_env/{family}-o{self.objects}-v0"
