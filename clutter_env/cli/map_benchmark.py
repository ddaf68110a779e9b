"""Reachability maps measured: the paper's experiment and ours, costs, accuracy, and whether the bases are any good.

Every measurement runs in a process of its own with one thread of linear algebra; times are CPU times.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import platform
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from multiprocessing.pool import Pool
from pathlib import Path
from typing import Any, Literal

import numpy as np

from assets.robots import robot
from clutter_env.cli.command import run_command
from clutter_env.experiments.maps.build_times import BUILDS, BuildCost, measure_build
from clutter_env.experiments.maps.room import Targets, measure_targets
from clutter_env.experiments.maps.speed import Timing, measure_speed, plot_speed, speed_table
from clutter_env.experiments.maps.truth import Accuracy, Strips, measure_accuracy, measure_strips

Part = Literal["speed", "build", "accuracy", "strips", "targets"]


@dataclass(frozen=True)
class Arguments:
    """Command line."""

    parts: tuple[Part, ...] = ("build", "speed", "accuracy", "strips", "targets")
    """What to measure."""
    robot: str = "fetch"
    queries: int = 500
    """Random cup positions for each map and each range of approach yaws."""
    sizes: tuple[int, ...] = (7_899, 26_000, 1_000_000)
    """Poses of the maps: the paper's two, and anything else for our map of more than a million (takes half an hour)."""
    poses: int = 100_000
    """Random hand poses to judge the maps by."""
    strips: int = 500
    """Random strips of free floor."""
    targets: int = 200
    """Random targets on the table, for each layout."""
    layouts: tuple[str, ...] = ("paper", "island")
    seed: int = 0
    output: Path = field(default_factory=lambda: Path("outputs/irm_benchmark.png"))
    """Where the box plot goes."""
    json: Path | None = None
    """Where machine-readable results go."""


def run(arguments: Arguments) -> None:
    """Measure, print, plot, save."""
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")
    run: dict[Part, Callable[[Arguments], dict[str, Any]]] = {
        "build": _build,
        "speed": _speed,
        "accuracy": _accuracy,
        "strips": _strips,
        "targets": _targets,
    }
    results: dict[str, Any] = {"about": {"python": platform.python_version(), "machine": platform.machine()}}
    for part in arguments.parts:
        results |= run[part](arguments)
        if arguments.json is not None:
            arguments.json.parent.mkdir(parents=True, exist_ok=True)
            arguments.json.write_text(json.dumps(results, indent=1))


def _alone(function: Callable[..., Any], *values: Any) -> Any:
    """Call a function in a fresh process."""
    pool: Pool
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(function, values)


def _build(arguments: Arguments) -> dict[str, Any]:
    rows: list[BuildCost] = [_alone(measure_build, robot(arguments.robot), name) for name in BUILDS]
    head = ("map", "poses", "build [s]", "invert [s]", "save [s]", "load [s]", "file [MB]")
    body = [
        (
            r.name,
            f"{r.poses:,}",
            f"{r.build_s:.1f}",
            f"{r.invert_s:.2f}",
            f"{r.save_s:.2f}",
            f"{r.load_s:.2f}",
            f"{r.megabytes:.1f}",
        )
        for r in rows
    ]
    print(_table(head, body))
    return {"build": [asdict(row) for row in rows]}


def _speed(arguments: Arguments) -> dict[str, Any]:
    rows: list[Timing] = []
    for size in arguments.sizes:
        rows += _alone(measure_speed, robot(arguments.robot), size, arguments.queries, arguments.seed)
    print(speed_table(rows, arguments.queries))
    plot_speed(rows, arguments.output)
    print(f"\nbox plot: {arguments.output}\n")
    return {"speed": [_summary(row) for row in rows]}


def _summary(row: Timing) -> dict[str, Any]:
    times = np.array(row.times)
    spread = {"mean_ms": times.mean(), "deviation_ms": times.std(), "median_ms": np.median(times)}
    return {"poses": row.poses, "method": row.method, "same_best": row.same_best, **spread}


def _accuracy(arguments: Arguments) -> dict[str, Any]:
    specification = robot(arguments.robot)
    rows: list[Accuracy] = [
        _alone(measure_accuracy, specification, orientations, arguments.poses, arguments.seed)
        for orientations in (62, 266)
    ]
    head = ("orientations", "accuracy", "true +", "false +", "YES", "NO", "UNKNOWN", "YES wrong", "NO wrong")
    body = [
        (
            r.orientations,
            *(
                f"{100 * share:.1f}%"
                for share in (r.accuracy, r.true_positives, r.false_positives, r.yes, r.no, r.unknown)
            ),
            r.yes_wrong,
            r.no_wrong,
        )
        for r in rows
    ]
    print(f"{arguments.poses:,} random hand poses, {100 * rows[0].reachable:.1f}% in reach\n\n{_table(head, body)}")
    return {"accuracy": [asdict(row) for row in rows]}


def _strips(arguments: Arguments) -> dict[str, Any]:
    row: Strips = _alone(measure_strips, robot(arguments.robot), arguments.strips, arguments.seed)
    print(
        f"strips of floor 5 to 10 cm wide: a base found in {row.found} of the {row.found_by_full_scan} cases in which "
        f"the full scan finds one; the same best μ in {row.same_best} of {row.cases}\n"
    )
    return {"strips": asdict(row)}


def _targets(arguments: Arguments) -> dict[str, Any]:
    rows: list[Targets] = [
        _alone(measure_targets, robot(arguments.robot), layout, arguments.targets, with_path, arguments.seed)
        for layout in arguments.layouts
        for with_path in (False, True)
    ]
    head = ("layout", "query", "targets", "answered", "best base stands the test", "one of the best five does")
    body = [(r.layout, r.query, r.targets, r.answered, r.verified_first, r.verified) for r in rows]
    print(_table(head, body))
    return {"targets": [asdict(row) for row in rows]}


def _table(head: Sequence[str], body: Sequence[Sequence[Any]]) -> str:
    lines = [head, ["---"] * len(head), *body]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines) + "\n"


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("map benchmark", Arguments, run, __doc__, words)
