"""How often `query` leaves a random gripper pose undecided, by default and with `exact=True`, and how long both take.

    OMP_NUM_THREADS=1 python scripts/map_decisions.py --robots fetch pr2 panda_mobile --queries 120
    python scripts/map_decisions.py --robots --arms puma560 "widowx ai" --wheels wheels   # arms of adversarial_truth.py

Poses: random heights, pitches and rolls, in a window of yaws of ± 0.13 rad, so that none is on a ring of the map. Times
are CPU times of one thread; "certain" are the queries that the map answers by itself.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import tyro
from adversarial_truth import ARMS  # type: ignore[import-not-found]  # beside this file
from map_truth import Judge  # type: ignore[import-not-found]  # beside this file

from assets import RobotSpec
from clutter_env.cli.robot import robot_by_name
from clutter_env.reporting.progress import progress_bar
from clutter_env.reporting.tables import NOTHING, markdown_table
from irm import ArmChain, InverseReachabilityMap, cached_map
from irm.answers import Status

WINDOW = 0.13
"""[rad] on both sides of the approach yaw."""
_COMPILING = 20
"""Queries that are asked first and not counted: they compile and load kernels."""


def measure(name: str, robot: RobotSpec | ArmChain, queries: int, seed: int, voxel: float) -> list[str]:
    """A row of the table."""
    rm = cached_map(robot, progress=progress_bar, voxel=voxel)
    inverse_map, grid, rng = InverseReachabilityMap(rm), rm.grid, np.random.default_rng(seed)
    unknown, times, certain = {False: 0, None: 0, True: 0}, {None: list[float](), True: list[float]()}, []
    for count in range(queries + _COMPILING):
        pitch, roll, yaw = rng.uniform(-np.pi / 2, np.pi / 2), *rng.uniform(-np.pi, np.pi, 2)
        point = 0.0, 0.0, rng.uniform(grid.bottom, grid.top - 1e-6)
        how = {"pitch": pitch, "roll": roll, "yaw_range": (yaw - WINDOW, yaw + WINDOW)}
        for exact in unknown:
            start = time.process_time_ns()
            found = inverse_map.query(point, exact=exact, **how)
            spent = (time.process_time_ns() - start) * 1e-3
            if count < _COMPILING:
                continue
            unknown[exact] += found.status is Status.UNKNOWN
            if exact is not False:
                times[exact].append(spent)
            if exact is None and found.configurations is None and len(found):
                certain.append(spent)
    row = [name, *(str(unknown[exact]) for exact in unknown), f"{len(certain)}"]
    row.append(f"{np.mean(certain):.0f}" if certain else NOTHING)
    return [*row, *(f"{np.median(times[exact]):.0f} / {np.mean(times[exact]):.0f}" for exact in (None, True))]


def main(
    robots: tuple[str, ...] = ("fetch", "pr2", "panda_mobile"),
    arms: tuple[str, ...] = (),
    wheels: Path = Path("wheels"),
    queries: int = 120,
    seed: int = 0,
    voxel: float = 0.05,
) -> None:
    """Measure, and print the table.

    Args:
        robots: names of robots.
        arms: names of arms of `adversarial_truth.py`.
        wheels: folder in which their packages were unpacked.
        queries: random poses of each.
        seed: of the poses.
        voxel: edge of the map's cells [m].
    """
    head = ["robot", "UNKNOWN by the map alone", "by default", "with `exact=True`", "certain by the map"]
    head += ["mean of these [µs]", "median / mean of all, default [µs]", "`exact=True` [µs]"]
    found = {name: robot_by_name(name) for name in robots}
    found |= {name: Judge(wheels, ARMS[name]).chain for name in arms}
    print(markdown_table(head, [measure(name, robot, queries, seed, voxel) for name, robot in found.items()]))


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
