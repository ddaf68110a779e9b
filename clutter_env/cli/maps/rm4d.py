"""Compare our maps with RM4D (github.com/mrudorfer/rm4d): their class on our arm, the same poses, exact truth.

RM4D is not installed with this package: --package is the folder of a copy of their repository.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from clutter_env.reporting.command import run_command


@dataclass(frozen=True)
class Arguments:
    """Command line."""

    package: Path
    """Folder of a copy of their repository."""
    robot: str = "fetch"
    """Name of a robot with a closed form."""
    orientations: int = 62
    """Number of approach axes of our map."""
    samples: int = 4_000_000
    """Random configurations that fill their map."""
    poses: int = 20_000
    """Random poses, and as many side grasps."""
    seed: int = 0
    """Random seed."""
    json: Path | None = None
    """File for machine-readable results."""


def run(arguments: Arguments) -> None:
    """Measure and print a table."""
    from assets.robots import robot
    from clutter_env.experiments.maps.rm4d_comparison import compare_with_rm4d
    from clutter_env.reporting.files import write_json
    from clutter_env.reporting.tables import markdown_table

    counts = arguments.samples, arguments.poses
    rows = compare_with_rm4d(robot(arguments.robot), arguments.package, arguments.orientations, counts, arguments.seed)
    kinds = ("random, given yaw", "random, any yaw", "side, given yaw", "side, any yaw")
    head = ("", *kinds, "memory [MB]", "file [MB]", "forward [µs]", "inverse [µs]")
    body = []
    for row in rows:
        shares = (row.random_given_yaw, row.random_any_yaw, row.side_given_yaw, row.side_any_yaw)
        inverse = "–" if row.inverse is None else f"{row.inverse:.0f}"
        costs = f"{row.memory:.1f}", f"{row.file:.1f}", f"{row.forward:.1f}", inverse
        body.append((row.method, *(f"{share:.3f}" for share in shares), *costs))
    print(markdown_table(head, body))
    if arguments.json is not None:
        write_json(arguments.json, {"rows": rows})


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("map rm4d", Arguments, run, __doc__, words)
