"""Accuracy of a map for random TCP poses, against exact inverse kinematics, and its bases on narrow strips of floor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from assets.robots import RobotSpec
from irm.arm.closed_form import ik_pan
from irm.arm.kinematics import ArmChain
from irm.checks.classification import classify, predict
from irm.compilation import njit
from irm.floor.free_space import FreeSpace
from irm.maps.cache import cached_map
from irm.maps.orientation_index import rotation
from irm.maps.reachability import ReachabilityMap
from irm.queries.full_scan import full_scan
from irm.queries.inverse import InverseReachabilityMap
from irm.queries.status import Status

__all__ = ["Accuracy", "Strips", "measure_accuracy", "measure_strips", "solve_by_scan"]

Floats = NDArray[np.float64]

PANS, TORSOS = 361, 36
"""Grid of the exact solver: half a degree of pan, one centimetre of torso lift."""
CHUNK = 5000
"""Poses between two updates of the progress bar."""


@dataclass(frozen=True)
class Accuracy:
    """A map as a predictor of exact inverse kinematics.

    `orientations` of the map; `poses`, `yes_wrong` and `no_wrong` are counts; all others are shares in 0 … 1.
    """

    orientations: int
    poses: int
    reachable: float
    accuracy: float
    true_positives: float
    false_positives: float
    yes: float
    no: float
    unknown: float
    yes_wrong: int
    no_wrong: int


@dataclass(frozen=True)
class Strips:
    """Counts of queries on floors of which only a strip is free."""

    cases: int
    found_by_full_scan: int
    found: int
    same_best: int


def measure_accuracy(robot: RobotSpec, orientations: int, count: int, seed: int) -> Accuracy:
    """Answers of the plain map and of `classify` for random TCP poses in the map's box."""
    rm = cached_map(robot, orientations=orientations)
    chain = ArmChain.from_robot(robot)
    T = _random_poses(rm, count, np.random.default_rng(seed))
    truth = np.concatenate([solve_by_scan(chain, part) for part in tqdm(_chunks(T), f"exact, {orientations}")])
    plain, answer = predict(rm, T), classify(rm, T)
    return Accuracy(
        orientations=orientations,
        poses=count,
        reachable=float(truth.mean()),
        accuracy=float((plain == truth).mean()),
        true_positives=float(plain[truth].mean()),
        false_positives=float(plain[~truth].mean()),
        yes=float((answer == Status.YES.value).mean()),
        no=float((answer == Status.NO.value).mean()),
        unknown=float((answer == Status.UNKNOWN.value).mean()),
        yes_wrong=int(((answer == Status.YES.value) & ~truth).sum()),
        no_wrong=int(((answer == Status.NO.value) & truth).sum()),
    )


def _chunks(T: Floats) -> list[Floats]:
    return np.array_split(T, max(1, len(T) // CHUNK))


def _random_poses(rm: ReachabilityMap, count: int, rng: np.random.Generator) -> Floats:
    """T_base_tcp (n, 4, 4): uniform positions, uniform approach directions."""
    grid, edge = rm.grid, rm.grid.half * rm.grid.voxel
    x, y = grid.centre
    approach = rng.normal(size=(count, 3))
    approach /= np.linalg.norm(approach, axis=1, keepdims=True)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, 3] = rng.uniform((x - edge, y - edge, grid.bottom), (x + edge, y + edge, grid.top), size=(count, 3))
    yaw, pitch = np.arctan2(approach[:, 1], approach[:, 0]), -np.arcsin(approach[:, 2])
    T[:, :3, :3] = [rotation(*angles) for angles in zip(yaw, pitch, np.zeros(count), strict=True)]
    return T


def solve_by_scan(chain: ArmChain, T: Floats) -> NDArray[np.bool_]:
    """(n,) whether a fine grid of pan angles and torso heights holds a configuration for each pose (n, 4, 4)."""
    pans = np.linspace(chain.lower[1], chain.upper[1], PANS)
    turns = np.column_stack([np.cos(pans), np.sin(pans)])
    torsos = np.linspace(chain.lower[0], chain.upper[0], TORSOS)
    return np.asarray(_any_solution(chain.links, chain.lower, chain.upper, T, torsos, turns))


@njit(cache=True)
def _any_solution(
    links: Floats, lower: Floats, upper: Floats, T: Floats, torsos: Floats, turns: Floats
) -> NDArray[np.bool_]:
    """Whether any torso height and pan angle of a fine grid solves each pose; the roll of the TCP is free."""
    answers = np.zeros(T.shape[0], np.bool_)
    rows, wrist, approach = np.empty((2, 5)), np.empty(3), np.empty(3)
    for n in range(T.shape[0]):
        for torso in torsos:
            for i in range(3):
                approach[i] = T[n, i, 0]
                wrist[i] = T[n, i, 3] - links[6] * approach[i]
            wrist[0] -= links[0]
            wrist[2] -= links[1] + torso
            for k in range(turns.shape[0]):
                if ik_pan(links, approach, wrist, turns[k, 0], turns[k, 1], lower, upper, rows) > 0:
                    answers[n] = True
                    break
            if answers[n]:
                break
    return answers


def measure_strips(robot: RobotSpec, cases: int, seed: int) -> Strips:
    """Queries with a free strip of floor 5 to 10 cm wide, at random angles and distances."""
    inverse_map = InverseReachabilityMap(cached_map(robot))
    rng = np.random.default_rng(seed)
    scanned = found = same = 0
    for _ in tqdm(range(cases), "strips"):
        floor = _strip(rng.uniform(0.05, 0.1), rng.uniform(-np.pi, np.pi), rng.uniform(0.3, 1.1), robot.base_radius)
        position = (0.0, 0.0, rng.uniform(0.5, 1.3))
        middle, width = rng.uniform(-np.pi, np.pi), rng.uniform(0.2, np.pi)
        keywords: dict[str, Any] = {"yaw_range": (middle - width, middle + width), "free_space": floor}
        slow, fast = full_scan(inverse_map, position, **keywords), inverse_map.query(position, **keywords)
        scanned += len(slow)
        found += len(slow) and len(fast)
        same += bool(np.array_equal(slow.manipulability, fast.manipulability))
    return Strips(cases, scanned, found, same)


def _strip(width: float, turn: float, away: float, radius: float) -> FreeSpace:
    """Floor between two walls, in which the base's centre has a strip of the given width [m]."""
    c, s = np.cos(turn), np.sin(turn)
    walls = [(c * middle, s * middle, 4.0, 12.0, turn) for middle in (away - 2.0 - radius, away + width + 2.0 + radius)]
    return FreeSpace.from_boxes(walls, radius, (-2.5, -2.5, 2.5, 2.5))
