"""Side by side with RM4D (github.com/mrudorfer/rm4d, MIT): their class on our arm, the same poses, exact truth.

RM4D is a map in four dimensions: height, angle of the approach to the vertical, and the base position relative to the
TCP. It does not know the yaw of the base. Here it is filled with random configurations of the arm, as its authors do.
"""

from __future__ import annotations

import importlib
import sys
import time
import types
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from irm.arm.chain import ArmChain
from irm.arm.exact import exact_solver
from irm.arm.numerical import random_seeds
from irm.checks.classification import predict
from irm.checks.decide import decide
from irm.maps.cache import cache_file, cached_map, cached_table, table_file
from irm.maps.orientation_index import rotation, rotations
from irm.maps.sampled_field import tcp_frames
from irm.queries.inverse import InverseReachabilityMap
from irm.queries.status import Status

__all__ = ["MapComparison", "compare_with_rm4d"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

RADIUS = 1.25
"""[m] Of the ball of random poses, and half the edge of their map."""
CENTRE = np.array([0.0, 0.0, 0.8])
TOP = 2.05
"""[m] Height of their map: that of the ball."""
YAWS = 72
"""Base yaws that are tried for "any base yaw", 5 degrees apart."""
TIMED = 2000
"""Poses of the measurement of times, one after the other."""
X_TO_Z = rotation(0.0, -np.pi / 2, 0.0)
"""Their TCP frames have z along the approach."""
YES = Status.YES.value


@dataclass(frozen=True)
class MapComparison:
    """One method.

    Accuracies are shares of the poses; sizes in megabytes, that of the file compressed; times in microseconds of CPU
    per pose: `forward` for many poses, `inverse` for one query, None where the method has no such query.
    """

    method: str
    random_given_yaw: float
    random_any_yaw: float
    side_given_yaw: float
    side_any_yaw: float
    memory: float
    file: float
    forward: float
    inverse: float | None


def compare_with_rm4d(
    robot: RobotSpec, package: Path, orientations: int, counts: tuple[int, int], seed: int
) -> list[MapComparison]:
    """RM4D, our map and our certificate table alone, and our map with exact answers.

    Args:
        robot: with a closed form, so that the truth is exact.
        package: folder of a copy of their repository.
        orientations: of our map.
        counts: random configurations that fill their map, and poses of each kind.
        seed: random seed.
    """
    rng, chain = np.random.default_rng(seed), ArmChain.from_robot(robot)
    theirs = _filled(_rm4d_class(package), chain, counts[0], rng)
    rm, table = cached_map(robot, orientations=orientations), cached_table(robot)
    inverse_map = InverseReachabilityMap(rm)
    kinds = [_random_poses(counts[1], rng), _side_grasps(counts[1], rng)]
    truth = [_truth(chain, T) for T in kinds]
    answers = {
        "RM4D": [(found, found) for found in (_ask_rm4d(theirs, T) for T in kinds)],
        f"map, {orientations} orientations": [_with_any_yaw(lambda poses: predict(rm, poses), T) for T in kinds],
        "certificate table": [_with_any_yaw(lambda poses: predict(table, poses), T) for T in kinds],
        "decide": [_with_any_yaw(lambda poses: decide(rm, poses) == YES, T) for T in kinds],
    }
    files = [cache_file(robot, orientations=orientations), table_file(robot)]
    ours, small = (file.stat().st_size / 1e6 for file in files)
    stored = [len(zlib.compress(theirs.map.tobytes())) / 1e6, ours, small, ours]
    rows_of_map = sum(getattr(rm, name).nbytes for name in ("cells", "manipulability", "torso_index", "flags")) / 1e6
    memory = [theirs.map.nbytes / 1e6, rows_of_map, table.arcs.nbytes / 1e6, rows_of_map]
    random, side = (T[:TIMED] for T in kinds)
    forward = [
        _microseconds(lambda T: _ask_rm4d(theirs, T), [random]) / len(random),
        _microseconds(lambda T: predict(rm, T), [random]) / len(random),
        _microseconds(lambda T: predict(table, T), [random]) / len(random),
        _microseconds(lambda T: decide(rm, T), [random]) / len(random),
    ]
    query = _microseconds(lambda T: inverse_map.query(T[:3, 3]), side)
    inverse = [_microseconds(lambda T: theirs.get_base_positions(_their_frame(T)), side), query, None, query]
    shares = [_accuracies(per_kind, truth) for per_kind in answers.values()]
    columns = zip(answers, shares, memory, stored, forward, inverse, strict=True)
    return [MapComparison(method, *accuracies, *costs) for method, accuracies, *costs in columns]


def _accuracies(
    answers: list[tuple[Bools, Bools]], truth: list[tuple[Bools, Bools]]
) -> tuple[float, float, float, float]:
    """Shares of right answers: random poses given the yaw and with any yaw, and the same of side grasps."""
    (a, b), (c, d) = answers
    (w, x), (y, z) = truth
    return float(np.mean(a == w)), float(np.mean(b == x)), float(np.mean(c == y)), float(np.mean(d == z))


def _rm4d_class(package: Path) -> Any:
    """Their class of maps, without the rest of the package, which needs a simulator."""
    folder = package / "rm4d"
    if not (folder / "reachability_map.py").is_file():
        raise ValueError(f"{package} is no copy of github.com/mrudorfer/rm4d: it has no rm4d/reachability_map.py")
    parent = types.ModuleType("rm4d")
    parent.__path__ = [str(folder)]
    sys.modules["rm4d"] = parent
    return importlib.import_module("rm4d.reachability_map").ReachabilityMap4D


def _filled(kind: Any, chain: ArmChain, samples: int, rng: np.random.Generator) -> Any:
    """Their map of the cells that random configurations reach, at all torso heights."""
    theirs = kind(xy_limits=[-RADIUS, RADIUS], z_limits=[0.0, TOP])
    q = random_seeds(chain, samples, 0.0, rng)
    q[:, 0] = rng.uniform(chain.lower[0], chain.upper[0], samples)
    R, p = tcp_frames(chain.offsets, chain.axes, chain.tip, q)
    for pose in _poses(R, p):
        try:
            theirs.mark_reachable(theirs.get_indices_for_ee_pose(_their_frame(pose)))
        except IndexError:
            continue  # the pose is outside their map
    return theirs


def _their_frame(T: Floats) -> Floats:
    turned = T.copy()
    turned[:3, :3] = T[:3, :3] @ X_TO_Z.T
    return turned


def _ask_rm4d(theirs: Any, T: Floats) -> Bools:
    """(n,) their answers; a pose outside their map is out of reach."""
    answers = np.zeros(len(T), dtype=bool)
    for k, pose in enumerate(T):
        try:
            answers[k] = theirs.is_reachable(theirs.get_indices_for_ee_pose(_their_frame(pose)))
        except IndexError:
            answers[k] = False
    return answers


def _truth(chain: ArmChain, T: Floats) -> tuple[Bools, Bools]:
    """Whether the arm reaches each pose: from the given base, and from that place with any base yaw."""
    solver = exact_solver(chain)
    return _with_any_yaw(lambda poses: solver.solve(poses)[0] == YES, T)


def _with_any_yaw(ask: Any, T: Floats) -> tuple[Bools, Bools]:
    """Answers (n,) for the given base yaw, and for the best of `YAWS` base yaws."""
    given = np.asarray(ask(T), dtype=bool)
    any_yaw = given.copy()
    for yaw in np.arange(1, YAWS) * 2 * np.pi / YAWS:
        open_poses = np.flatnonzero(~any_yaw)
        turned = T[open_poses].copy()
        R = rotation(yaw, 0.0, 0.0)
        turned[:, :3, :3], turned[:, :3, 3] = R @ turned[:, :3, :3], turned[:, :3, 3] @ R.T
        any_yaw[open_poses] = ask(turned)
    return given, any_yaw


def _random_poses(count: int, rng: np.random.Generator) -> Floats:
    """(n, 4, 4) uniform positions above the floor in a ball around the robot, uniform approach directions."""
    approach, offset = rng.normal(size=(2, count, 3))
    approach /= np.linalg.norm(approach, axis=1, keepdims=True)
    offset *= RADIUS * rng.random((count, 1)) ** (1 / 3) / np.linalg.norm(offset, axis=1, keepdims=True)
    p = CENTRE + offset
    R = rotations(
        np.arctan2(approach[:, 1], approach[:, 0]), -np.arcsin(approach[:, 2]), rng.uniform(-np.pi, np.pi, count)
    )
    return _poses(R, p)[p[:, 2] > 0.0]


def _side_grasps(count: int, rng: np.random.Generator) -> Floats:
    """(n, 4, 4) level grippers above tables, 0.4 to 1.2 m away, with any approach yaw."""
    distance, bearing, yaw = rng.uniform(0.4, 1.2, count), *rng.uniform(-np.pi, np.pi, (2, count))
    p = np.column_stack([distance * np.cos(bearing), distance * np.sin(bearing), rng.uniform(0.75, 1.0, count)])
    return _poses(rotations(yaw, 0 * yaw, 0 * yaw), p)


def _poses(R: Floats, p: Floats) -> Floats:
    T = np.tile(np.eye(4), (len(p), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = R, p
    return T


def _microseconds(ask: Callable[[Any], Any], questions: Sequence[Any] | Floats) -> float:
    """CPU time of one call, after a first one that compiles."""
    ask(questions[0])
    start = time.process_time()
    for question in questions:
        ask(question)
    return (time.process_time() - start) / len(questions) * 1e6
