"""Table 1 of Lee & Kim 2019 and more: strategies on scenes whose target is obstructed, planned or in physics.

    clutter-env table --objects 15 40 --strategies lookahead ngr --scenes 100
    clutter-env table --layout shelf --objects 10 --strategies lookahead --grasps all --no-obstructed

The scenes are resets of the environment from --seed on. Every trial is written to a file as soon as it ends: run the
same command again after an interruption. JSON and Markdown tables and a picture are written to the output directory.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from clutter_env.cli.main import command_line

if TYPE_CHECKING:
    from clutter_env.cli.clearance_trials import Variant

WHEN_INTERRUPTED = "run the same command again to go on"

STRATEGIES = ("lookahead", "ngr", "dogar", "srivastava")
"""The strategies of the planner, which takes long to import."""


@dataclass(frozen=True)
class Arguments:
    """Make the clearance table."""

    objects: tuple[int, ...] = (15, 20, 25, 30, 35, 40, 50, 60)
    """Numbers of objects on the table, the target among them."""
    strategies: tuple[str, ...] = STRATEGIES
    """Strategies; the others are compared with the first one."""
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
    """Where objects may be put: all, table, or names of the layout's supports. If not given, the table alone with side
    grasps, and all supports with the others."""
    physics: bool = False
    """Let the expert execute its plans in physics, where the environment decides about success; an episode has 1500
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


def run(arguments: Arguments, more: Mapping[str, Variant] | None = None, name: str = "clutter-env table") -> None:
    """Find the scenes, try the strategies and `more` rows, report; `name` is the command shown on the page."""
    from clutter_env.cli.clearance_picture import draw
    from clutter_env.cli.clearance_tables import markdown, summarise
    from clutter_env.cli.clearance_trials import Trials
    from clutter_env.reporting.files import write_json

    trials = Trials(arguments, more)
    trials.run()
    summary = summarise(trials)
    tables = markdown(summary, arguments.physics)
    print(f"\n{tables}")
    for path in filter(None, (arguments.out / "table.json", arguments.json)):
        write_json(path, {"settings": trials.settings, **summary})
    command = command_line(name, arguments, ("workers", "out", "json"))
    (arguments.out / "table.md").write_text(f"```sh\n{command}\n```\n\n{tables}")
    draw(summary).savefig(arguments.out / "table.png", dpi=130)
    print(f"tables and figures: {arguments.out}")
    if crashed := sum(entry["crashed"] for entry in (*summary["rows"], *summary["scenes"])):
        print(f"{crashed} trials CRASHED; their tracebacks are in {arguments.out / 'trials.jsonl'}")
