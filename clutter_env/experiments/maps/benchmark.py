"""The measurements of reachability maps, part by part: what each part measures, its table and its numbers.

Every measurement runs in a process of its own with one thread of linear algebra. All times are CPU times.
"""

from __future__ import annotations

import multiprocessing
import os
import platform
from collections.abc import Callable, Iterator
from dataclasses import asdict
from multiprocessing.pool import Pool
from typing import Any, NamedTuple

import numpy as np

from assets.robots import RobotSpec
from clutter_env.experiments.maps.bases.base_quality import KINDS, Targets, measure_targets
from clutter_env.experiments.maps.bases.strips import Strips, measure_strips
from clutter_env.experiments.maps.bases.visibility import Visibility, measure_visibility
from clutter_env.experiments.maps.build_times import BUILDS, BuildCost, measure_build
from clutter_env.experiments.maps.decisions import Decisions, measure_decisions
from clutter_env.experiments.maps.settings import BenchmarkSettings, Part
from clutter_env.experiments.maps.speed import Timing, measure_speed, plot_speed, speed_table
from clutter_env.reporting.tables import markdown_table

__all__ = ["Measurement", "measure_parts"]


class Measurement(NamedTuple):
    """One part: its table as Markdown `text`, and its `results` for JSON."""

    text: str
    results: dict[str, Any]


def measure_parts(robot: RobotSpec, settings: BenchmarkSettings) -> Iterator[Measurement]:
    """The machine, and then every part of the settings, as soon as it is measured."""
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")
    python, machine = platform.python_version(), platform.machine()
    yield Measurement(f"Python {python}, {machine}\n", {"about": {"python": python, "machine": machine}})
    measure: dict[Part, Callable[[RobotSpec, BenchmarkSettings], Measurement]] = {
        "build": _build,
        "speed": _speed,
        "decide": _decide,
        "strips": _strips,
        "targets": _targets,
        "visibility": _visibility,
    }
    for part in settings.parts:
        yield measure[part](robot, settings)


def _in_own_process(function: Callable[..., Any], *values: Any) -> Any:
    """Call a function in a fresh process."""
    pool: Pool
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(function, values)


def _build(robot: RobotSpec, _settings: BenchmarkSettings) -> Measurement:
    rows: list[BuildCost] = [_in_own_process(measure_build, robot, name) for name in BUILDS]
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
    return Measurement(markdown_table(head, body), {"build": [asdict(row) for row in rows]})


def _speed(robot: RobotSpec, settings: BenchmarkSettings) -> Measurement:
    rows: list[Timing] = []
    for size in settings.sizes:
        rows += _in_own_process(measure_speed, robot, size, settings.queries, settings.seed)
    plot_speed(rows, settings.output)
    text = f"{speed_table(rows, settings.queries)}\nbox plot: {settings.output}\n"
    return Measurement(text, {"speed": [_summary(row) for row in rows]})


def _summary(row: Timing) -> dict[str, Any]:
    times = np.array(row.times)
    spread = {"mean_ms": times.mean(), "deviation_ms": times.std(), "median_ms": np.median(times)}
    return {"poses": row.poses, "method": row.method, "same_best": row.same_best, **spread}


def _decide(robot: RobotSpec, settings: BenchmarkSettings) -> Measurement:
    numbers = (62, 266), settings.poses, settings.grasps, settings.seed
    rows: list[Decisions] = _in_own_process(measure_decisions, robot, *numbers)
    of_map = (
        "poses",
        "asked",
        "MB",
        "in reach",
        "accuracy",
        "false +",
        "UNKNOWN (of those in reach)",
        "wrong",
        "µs a pose",
    )
    head = (*of_map, "decide: UNKNOWN (of those in reach)", "wrong", "µs a pose")
    body = []
    for r in rows:
        shares = (f"{100 * share:.2f}%" for share in (r.reachable, r.accuracy, r.false_positives))
        from_map, decided = (
            f"{100 * of_all:.2f}% ({100 * in_reach:.2f}%)"
            for of_all, in_reach in ((r.map_unknown, r.map_unknown_in_reach), (r.unknown, r.unknown_in_reach))
        )
        cells = (from_map, str(r.map_wrong), f"{r.map_time_us:.2f}", decided, str(r.wrong), f"{r.time_us:.2f}")
        body.append((f"{r.poses:,} {r.poses_of}", r.source, f"{r.megabytes:.1f}", *shares, *cells))
    return Measurement(markdown_table(head, body), {"decide": [asdict(row) for row in rows]})


def _strips(robot: RobotSpec, settings: BenchmarkSettings) -> Measurement:
    row: Strips = _in_own_process(measure_strips, robot, settings.strips, settings.seed)
    text = (
        f"strips of floor 5 to 10 cm wide: a base found in {row.found} of the {row.found_by_full_scan} cases in which "
        f"the full scan finds one; the same best μ in {row.same_best} of {row.cases}\n"
    )
    return Measurement(text, {"strips": asdict(row)})


def _targets(robot: RobotSpec, settings: BenchmarkSettings) -> Measurement:
    rows: list[Targets] = [
        _in_own_process(measure_targets, robot, layout, settings.targets, kind, settings.seed)
        for layout in settings.layouts
        for kind in KINDS
    ]
    head = (
        "layout",
        "query",
        "targets",
        "answered",
        "best base is valid",
        "one of the best five",
        "none of forty",
        "wrong YES",
    )
    body = [
        (
            r.layout,
            r.query,
            str(r.targets),
            str(r.answered),
            str(r.verified_first),
            str(r.verified),
            str(r.hopeless),
            str(r.wrong),
        )
        for r in rows
    ]
    return Measurement(markdown_table(head, body), {"targets": [asdict(row) for row in rows]})


def _visibility(robot: RobotSpec, settings: BenchmarkSettings) -> Measurement:
    row: Visibility = _in_own_process(measure_visibility, robot, settings.targets, settings.seed)
    head = ("bases", "targets", "points seen", "targets seen by more than half", "μ")
    body = [
        ("by μ", f"{row.targets}", f"{100 * row.seen:.0f}%", f"{row.mostly}", "1"),
        ("visible first", f"{row.targets}", f"{100 * row.seen_preferred:.0f}%", f"{row.mostly_preferred}")
        + (f"{row.mu_ratio:.3f}",),
    ]
    rays = f"\n{row.disagreements} of {row.rays:,} lines of sight differ from MuJoCo's rays\n"
    return Measurement(markdown_table(head, body) + rays, {"visibility": asdict(row)})
