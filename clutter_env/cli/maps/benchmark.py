"""Measure reachability maps: the paper's experiment, the cost of maps, their accuracy, and the quality of the bases.

Every measurement runs in a process of its own with one thread of linear algebra; all times are CPU times.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clutter_env.experiments.maps.settings import BenchmarkSettings
from clutter_env.reporting.command import run_command


@dataclass(frozen=True)
class Arguments(BenchmarkSettings):
    """Command line."""

    robot: str = "fetch"
    """Name of a robot, or module:NAME of a RobotSpec."""
    json: Path | None = None
    """File for machine-readable results."""


def run(arguments: Arguments) -> None:
    """Measure and print part by part; the file of results grows with every part."""
    from clutter_env.experiments.maps.benchmark import measure_parts
    from clutter_env.experiments.maps.model_check import robot_by_name
    from clutter_env.reporting.files import write_json

    results: dict[str, Any] = {}
    for measurement in measure_parts(robot_by_name(arguments.robot), arguments):
        print(measurement.text)
        results |= measurement.results
        if arguments.json is not None:
            write_json(arguments.json, results)


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("map benchmark", Arguments, run, __doc__, words)
