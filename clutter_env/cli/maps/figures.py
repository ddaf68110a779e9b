"""Draw the figures of a robot's maps, as Figs. 1 and 2 of the paper: the reachability map, both inverse maps, slices,
and the base poses for a cup on a table.

Blue is high manipulability and red is low, as in the paper.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from clutter_env.reporting.command import run_command


@dataclass(frozen=True)
class Arguments:
    """Command line."""

    robot: str = "fetch"
    """Name of a robot, or module:NAME of a RobotSpec."""
    out: Path = Path("outputs/maps")
    """Folder of the pictures."""
    cup: tuple[float, float] = (0.1, 0.3)
    """Position of the cup on the table, from its middle: away from the robot, and to the left [m]."""
    dpi: int = 90
    """Resolution of the pictures."""


def run(arguments: Arguments) -> None:
    """Draw and save the figures."""
    from clutter_env.experiments.maps.figures import draw_figures
    from clutter_env.experiments.maps.model_check import robot_by_name

    for file in draw_figures(robot_by_name(arguments.robot), arguments.out, arguments.cup, arguments.dpi):
        print(f"picture: {file}")


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("map figures", Arguments, run, __doc__, words)
