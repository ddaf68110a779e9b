"""Tabulate with the planner which side grasps a robot reaches on each layout without objects.

    python scripts/side_approaches.py
    python scripts/side_approaches.py --robot pr2 --arm left --layouts paper

Scenes with `obstructed=True` are drawn by means of this table; make it again when a robot, a layout or the planner's
choice of grasps and base poses changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from assets.robots import robot as find_robot
from clutter_env.experiments.suites.approaches import approach_table
from clutter_env.reporting.command import run_command
from clutter_env.reporting.files import write_json
from clutter_env.reporting.progress import progress_bar
from clutter_env.scene.layout import LAYOUTS


@dataclass(frozen=True)
class Arguments:
    """Command line."""

    robot: str = "fetch"
    """Name of the robot."""
    arm: str = ""
    """Name of the arm that grasps, of a robot with several; the active one if not given."""
    layouts: tuple[str, ...] = tuple(LAYOUTS)
    """Names of the layouts."""
    out: Path = Path("outputs/approaches")
    """Directory of the file."""


def run(arguments: Arguments) -> None:
    """Tabulate and write."""
    robot = find_robot(arguments.robot)
    robot = robot.using(arguments.arm) if arguments.arm else robot
    with progress_bar(desc="rows of cells") as bar:
        table = approach_table(robot, arguments.layouts, bar.update)
    file = arguments.out / f"{robot.full_name}.json"
    write_json(file, table)
    print(f"written: {file}")


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("side_approaches", Arguments, run, __doc__, words)
