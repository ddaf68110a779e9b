"""Lower bounds of the suites' test scenes today, beside those of the suites' files, and what the planner clears.

    python scripts/suite_bounds.py --out results/bounds.jsonl
    python scripts/suite_bounds.py --out results/bounds.jsonl --show

A suite's bound was found when the suite was made. A bound is exact for the grasps and base poses that are looked at,
and today more base poses are. There is a line for each scene and grasp set. A run goes on where one was stopped.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

import clutter_env
from clutter_env.reporting.progress import progress_bar
from clutter_env.suites import GRASPS, SPLITS, SuiteScene
from planners import Scene, Solution, clearance_floor, solve, warmup

SUITES = (
    "side-15-v3",
    "side-25-v3",
    "side-40-v3",
    "all-25-v3",
    "shelf-10-v4",
    "shelf-16-v4",
    "dense-25-v3",
    "deep-15-v2",
    "deep-25-v2",
    "deep-shelf-12-v2",
    "household-15-v2",
    "household-shelf-10-v2",
)
COLUMNS = ("suite", "grasps", "scenes", "bound of the file", "bound today", "lower in", "higher in", "moved", "optimal")
"""Of the table. "bound" and "moved" are sums over the scenes that have a bound and a plan."""


@dataclass(frozen=True)
class Arguments:
    """Which scenes, and where the lines are."""

    out: Path
    """File of the lines."""
    suites: tuple[str, ...] = SUITES
    """Suites of Retrieve."""
    grasps: tuple[str, ...] = GRASPS
    """Grasp sets."""
    scenes: int = 100
    """The first test scenes of each suite."""
    show: bool = False
    """Only print the table."""


def main(arguments: Arguments) -> None:
    """Work out the lines that are missing, and print the table."""
    rows = [json.loads(line) for line in arguments.out.read_text().splitlines()] if arguments.out.exists() else []
    if not arguments.show:
        warmup()
        done = {(row["suite"], row["seed"], row["grasps"]) for row in rows}
        wanted = [
            (scene, grasps)
            for name in arguments.suites
            for scene in clutter_env.suite(name).split(SPLITS[0])[: arguments.scenes]
            for grasps in arguments.grasps
            if (name, scene.seed, grasps) not in done
        ]
        with arguments.out.open("a") as file:
            for scene, grasps in progress_bar(wanted):
                rows.append(bound_of(scene, grasps))
                print(json.dumps(rows[-1]), file=file, flush=True)
    print("\n".join(table(rows)))


def bound_of(scene: SuiteScene, grasps: str) -> dict[str, Any]:
    """One line: the two bounds of a scene (None without a plan), and the clearances of a plan, or its refusal."""
    with closing(scene.make()) as env:
        _, info = scene.reset(env)
        inner: Any = env.unwrapped
        read, target = Scene.from_mujoco(inner.model, inner.data, inner.robot), info["target"]
    floor, plan = clearance_floor(read, target, grasps=grasps), solve(read, target, grasps=grasps)
    return {
        "suite": scene.suite,
        "seed": scene.seed,
        "grasps": grasps,
        "file": scene.floor(grasps).count,
        "today": floor.count,
        "proved": floor.proved,
        "moved": len(plan.clearances) if isinstance(plan, Solution) else None,
        "refused": "" if isinstance(plan, Solution) else str(plan.cause),
    }


def table(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """The lines of a Markdown table, one for each suite and grasp set."""
    yield f"| {' | '.join(COLUMNS)} |"
    yield "|---" * len(COLUMNS) + "|"
    for suite, grasps in dict.fromkeys((row["suite"], row["grasps"]) for row in rows):
        mine = [row for row in rows if (row["suite"], row["grasps"]) == (suite, grasps)]
        known = [row for row in mine if None not in (row["file"], row["today"], row["moved"])]
        sums = [sum(row[column] for row in known) for column in ("file", "today", "moved")]
        lower = sum(row["today"] < row["file"] for row in known)
        higher = sum(row["today"] > row["file"] for row in known)
        optimal = sum(row["moved"] == row["today"] and row["proved"] for row in known)
        cells = (f"`{suite}`", grasps, len(known), *sums[:2], lower, higher, sums[2], optimal)
        yield f"| {' | '.join(map(str, cells))} |"


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
