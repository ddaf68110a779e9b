"""Right and wrong answers of maps and of `decide`, for random TCP poses in the ball of the stretched arm.

    python scripts/map_accuracy.py --robot fetch --orientations 62 266 --poses 100000

The truth is that of exact inverse kinematics, each YES of which comes with a configuration; `tests/irm` compares these
with MuJoCo. Poses that it leaves UNKNOWN do not count.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np
import tyro
from numpy.typing import NDArray

from clutter_env.cli.robot import robot_by_name
from clutter_env.reporting.progress import progress_bar
from clutter_env.reporting.tables import markdown_table
from irm import ArmChain, ReachabilityMap, Status, cached_map, classify, decide
from irm.grid import nearest_orientation
from irm.ik.solvers import ExactSolver

Floats = NDArray[np.float64]
NO, UNKNOWN, YES = (answer.value for answer in (Status.NO, Status.UNKNOWN, Status.YES))


def main(robot: str = "fetch", orientations: tuple[int, ...] = (62, 266), poses: int = 100_000, seed: int = 0) -> None:
    """Measure, and print a row for each map.

    Args:
        robot: name of a robot, or module:NAME of a RobotSpec.
        orientations: approach axes of the maps.
        poses: random TCP poses.
        seed: random seed.
    """
    spec = robot_by_name(robot)
    chain = ArmChain.from_robot(spec)
    T = random_poses(chain, poses, np.random.default_rng(seed))
    truth, _ = ExactSolver(chain).solve(T)
    known, reached = truth != UNKNOWN, truth == YES
    head = ("map", "in reach", "accuracy", "false +", "UNKNOWN", "wrong", "µs", "decide: UNKNOWN", "wrong", "µs")
    rows = []
    for count in orientations:
        rm = cached_map(spec, orientations=count, progress=progress_bar)
        plain = is_cell_reachable(rm, T)
        shares = reached.mean(), (plain == reached)[known].mean(), plain[truth == NO].mean()
        row = [f"{count} orientations", *(f"{100 * share:.2f}%" for share in shares)]
        for ask in (classify, decide):
            answers, microseconds = timed(partial(ask, rm), T)
            wrong = ((answers == YES) & (truth == NO)) | ((answers == NO) & reached)
            row += [f"{100 * np.mean(answers == UNKNOWN):.2f}%", str(int(wrong.sum())), f"{microseconds:.2f}"]
        rows.append(row)
    print(markdown_table(head, rows))


def is_cell_reachable(rm: ReachabilityMap, T_base_tcp: Floats) -> NDArray[np.bool_]:
    """(n,) whether the centre of the cell that contains each TCP pose (n, 4, 4) is in reach; false outside the grid."""
    grid, positions = rm.grid, T_base_tcp[:, :3, 3]
    x, y = (np.floor((positions[:, k] - grid.centre[k]) / grid.voxel).astype(int) + grid.half for k in (0, 1))
    z = np.floor((positions[:, 2] - grid.bottom) / grid.thickness).astype(int)
    cells = np.column_stack([z, nearest_orientation(grid.orientations, T_base_tcp[:, :3, :3]), x, y])
    inside = np.all((cells >= 0) & (cells < grid.shape), axis=1)
    inside[inside] = rm.reachable[tuple(cells[inside].T)]
    return inside


def random_poses(chain: ArmChain, count: int, rng: np.random.Generator) -> Floats:
    """T_base_tcp (n, 4, 4): uniform positions in the ball of the stretched arm, uniform rotations."""
    direction = rng.normal(size=(count, 3))
    direction *= chain.reach * rng.random((count, 1)) ** (1 / 3) / np.linalg.norm(direction, axis=1, keepdims=True)
    Q, _ = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Q * np.linalg.det(Q)[:, None, None]
    T[:, :3, 3] = chain.shoulder + (0.0, 0.0, (chain.lower[0] + chain.upper[0]) / 2) + direction
    return T


def timed(ask: Callable[[Floats], NDArray[np.int8]], T: Floats) -> tuple[NDArray[np.int8], float]:
    """The answers, and the CPU time of one of them [µs], after a first call that compiles."""
    ask(T[:10])
    start = time.process_time()
    answers = ask(T)
    return answers, (time.process_time() - start) / len(T) * 1e6


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
