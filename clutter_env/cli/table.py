"""Table 1 of Lee & Kim 2019 and more: strategies on scenes whose target is obstructed, planned or in physics.

    clutter-env table --objects 15 40 --strategies lookahead ngr --scenes 100
    clutter-env table --layouts shelf two_boards cabinet --objects 10 16 25 --strategies lookahead --no-obstructed

The scenes are resets of the environment from --seed on. Every trial is written to a file as soon as it ends: run the
same command again after an interruption. JSON, a Markdown table and plots are written to the output directory.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from clutter_env.cli.main import command_line

if TYPE_CHECKING:
    from clutter_env.experiments.clearance_table.table import TableSettings

STRATEGIES = ("lookahead", "ngr", "dogar", "srivastava")
"""The strategies of the planner, which takes long to import."""


@dataclass(frozen=True)
class Arguments:
    """Make the clearance table."""

    objects: tuple[int, ...] = (15, 20, 25, 30, 35, 40, 50, 60)
    """Numbers of objects on the table, the target among them."""
    strategies: tuple[str, ...] = STRATEGIES
    """Strategies; the others are compared with the first one."""
    ablations: bool = False
    """Add rows of "lookahead" without one of its parts: look-ahead, tilted and top grasps, counters, second moves."""
    scenes: int = 100
    """Scenes for each number of objects."""
    obstructed: bool = True
    """Leave out scenes in which a level gripper takes the target at once."""
    seed: int = 100_000
    """First seed of the scenes."""
    robot: str = "fetch"
    """Name of the robot."""
    arms: Literal["one", "both"] = "one"
    """Arms that act; "both" adds rows of "lookahead" with two arms, without and with an obstacle held aside, and one
    with one arm and the same choice of grasps: for a robot with two."""
    layout: str = "paper"
    """Layout of the table."""
    layouts: tuple[str, ...] = ()
    """Compare layouts instead: one table of the first strategy over these layouts and all numbers of objects."""
    grasps: Literal["side", "tilted", "top", "all"] = "side"
    """Grasp set: level gripper (the paper's experiment), tilted, from above, or all of them."""
    supports: tuple[str, ...] = ()
    """Where objects may be put: all, table, or names of the layout's supports. If not given, the table alone with side
    grasps, and all supports with the others."""
    physics: bool = False
    """Let the expert execute its plans in physics, where the environment decides about success."""
    control_mode: Literal["joint", "ee"] = "joint"
    """Control mode."""
    time_limit: float = 20.0
    """[s] of wall time for one solve."""
    cap: int = 20
    """Clearances that an unsolved scene counts as in the censored mean."""
    workers: int = os.cpu_count() or 1
    """Number of processes."""
    retry_crashes: bool = False
    """Make the trials again that crashed in an earlier run."""
    report_only: bool = False
    """Make tables and plots of the trials in --out, and no new trials."""
    out: Path = Path("outputs/clearance_table")
    """Directory of trials.jsonl, table.json, table.md and images/table.png."""
    json: Path | None = None
    """Write the figures to this file too."""
    markdown: Path | None = None
    """Write the page to this file too, and its picture to images/ beside it."""


def run(arguments: Arguments) -> None:
    """Find the scenes, try the strategies, report."""
    from clutter_env.experiments.clearance_table.pages import markdown, write_page
    from clutter_env.experiments.clearance_table.records import Records
    from clutter_env.experiments.clearance_table.table import TableSettings, run_trials, summarise_table
    from clutter_env.experiments.clearance_table.variants import ABLATIONS, ARMS
    from clutter_env.reporting.files import write_json

    settings = TableSettings(
        objects=arguments.objects,
        strategies=(
            *arguments.strategies,
            *(ABLATIONS if arguments.ablations else ()),
            *(ARMS if arguments.arms == "both" else ()),
        ),
        scenes=arguments.scenes,
        seed=arguments.seed,
        robot=arguments.robot,
        layout=(*arguments.layouts, arguments.layout)[0],
        physics=arguments.physics,
        control_mode=arguments.control_mode,
        time_limit=arguments.time_limit,
        cap=arguments.cap,
        grasps=arguments.grasps,
        only_obstructed=arguments.obstructed,
        supports=arguments.supports,
    )
    if arguments.layouts:
        compare_layouts(arguments, settings)
        return
    records = Records(arguments.out / "trials.jsonl", settings.of_trials)
    if not arguments.report_only:
        print(f"first each of {arguments.workers} processes loads or compiles the planner's kernels and maps")
        run_trials(settings, records, arguments.workers, arguments.retry_crashes)
    summary = summarise_table(settings, records)
    if not summary.rows:
        print(f"no trials of these strategies and numbers of objects in {arguments.out}")
        return
    print(f"\n{markdown(settings, summary)}")
    for path in filter(None, (arguments.out / "table.json", arguments.json)):
        write_json(path, {"settings": settings.of_trials, **vars(summary)})
    leave_out = ("workers", "retry_crashes", "report_only", "out", "json")
    command = command_line("table", arguments, leave_out)
    for page in filter(None, (arguments.out / "table.md", arguments.markdown)):
        write_page(settings, command, summary, page)
    print(f"tables, figures and plots: {arguments.out}")
    if crashed := sum(row.crashed for row in summary.rows) + sum(scene.crashed for scene in summary.scenes):
        print(f"{crashed} trials CRASHED; their tracebacks are in {arguments.out / 'trials.jsonl'}")


def compare_layouts(arguments: Arguments, settings: TableSettings) -> None:
    """Run the first strategy over several layouts, and print one table."""
    from clutter_env.experiments.clearance_table.layouts import run_layouts, summary
    from clutter_env.reporting.files import write_json

    rows = run_layouts(
        settings,
        arguments.layouts,
        arguments.out,
        arguments.workers,
        arguments.retry_crashes,
        arguments.report_only,
    )
    print(f"\n{summary(rows)}")
    for path in filter(None, (arguments.out / "layouts.json", arguments.json)):
        write_json(path, {"settings": settings.of_trials, "rows": rows})
