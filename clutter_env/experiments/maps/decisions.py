"""Maps alone, the certificate table and `decide` for random TCP poses and grasps above a table, against an oracle.

The oracle knows neither cells nor bounds: a pose is in reach if a scan of half a degree of pan and one centimetre of
torso lift finds a configuration, or if the configuration of the exact solver takes the TCP there in MuJoCo.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from irm.arm.closed_form import ik_pan
from irm.arm.exact import exact_solver
from irm.arm.kinematics import ArmChain
from irm.checks.classification import classify, predict
from irm.checks.decide import decide
from irm.compilation import njit
from irm.maps.cache import cache_file, cached_map, cached_table, table_file
from irm.maps.certificate.table import CertificateTable
from irm.maps.orientation_index import rotation
from irm.maps.reachability import ReachabilityMap
from irm.queries.status import Status

__all__ = ["Decisions", "measure_decisions"]

Floats = NDArray[np.float64]

BALL = 1.25
"""[m] Radius of the ball of TCP positions, around the shoulder at half the torso's lift."""
PANS, TORSOS = 361, 36
"""Grid of the scan: half a degree of pan, one centimetre of torso lift."""
SAME_POSE = 1e-6
"""[m] and entries of a rotation by which the TCP may miss a pose in MuJoCo."""


@dataclass(frozen=True)
class Decisions:
    """Answers to one set of poses.

    `source`: the map or table that is asked; `poses`, `map_wrong` and `wrong` are counts; `megabytes` is the size of
    its file; `map_time_us` and `time_us` are the CPU times of `classify` and of `decide` for one pose [µs]; all others
    are shares in 0 … 1.
    """

    poses_of: str
    source: str
    megabytes: float
    poses: int
    reachable: float
    accuracy: float
    false_positives: float
    map_unknown: float
    map_unknown_in_reach: float
    unknown: float
    unknown_in_reach: float
    map_time_us: float
    time_us: float
    map_wrong: int
    wrong: int


def measure_decisions(
    robot: RobotSpec, orientations: Sequence[int], poses: int, grasps: int, seed: int
) -> list[Decisions]:
    """Rows for random poses of a ball, and for level grasps above a table, for several maps and the table."""
    rng = np.random.default_rng(seed)
    chain = ArmChain.from_robot(robot)
    rows = []
    for name, T in (("ball", _ball(chain, poses, rng)), ("table", _table_grasps(grasps, rng))):
        truth = _solve_by_scan(chain, T) | _is_reached_in_mujoco(robot, chain, T)
        for number in orientations:
            rm = cached_map(robot, orientations=number)
            size = cache_file(robot, orientations=number).stat().st_size / 1e6
            about = name, f"map, {number} orientations", size
            rows.append(_measure(rm, about, T, truth))
        table = cached_table(robot)
        size = table_file(robot).stat().st_size / 1e6
        rows.append(_measure(table, (name, "certificate table", size), T, truth))
    return rows


def _measure(
    rm: ReachabilityMap | CertificateTable, about: tuple[str, str, float], T: Floats, truth: NDArray[np.bool_]
) -> Decisions:
    decide(rm, T[:10])
    start = time.process_time()
    from_map = classify(rm, T)
    classified = time.process_time()
    answers = decide(rm, T)
    elapsed, plain = time.process_time() - classified, predict(rm, T)
    return Decisions(
        poses_of=about[0],
        source=about[1],
        megabytes=about[2],
        poses=len(T),
        reachable=float(truth.mean()),
        accuracy=float((plain == truth).mean()),
        false_positives=float(plain[~truth].mean()),
        map_unknown=float((from_map == Status.UNKNOWN.value).mean()),
        map_unknown_in_reach=float((from_map == Status.UNKNOWN.value)[truth].mean()),
        unknown=float((answers == Status.UNKNOWN.value).mean()),
        unknown_in_reach=float((answers == Status.UNKNOWN.value)[truth].mean()),
        map_time_us=(classified - start) / len(T) * 1e6,
        time_us=elapsed / len(T) * 1e6,
        map_wrong=_count_wrong(from_map, truth),
        wrong=_count_wrong(answers, truth),
    )


def _count_wrong(answers: NDArray[np.int8], truth: NDArray[np.bool_]) -> int:
    wrong = ((answers == Status.YES.value) & ~truth) | ((answers == Status.NO.value) & truth)
    return int(wrong.sum())


def _ball(chain: ArmChain, count: int, rng: np.random.Generator) -> Floats:
    """T_base_tcp (n, 4, 4): uniform in the ball, also below the floor, with uniform approach directions and rolls."""
    shoulder = chain.offsets[:3, :3].sum(axis=0) + (0.0, 0.0, (chain.lower[0] + chain.upper[0]) / 2)
    direction, approach = rng.normal(size=(2, count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    approach /= np.linalg.norm(approach, axis=1, keepdims=True)
    yaw, pitch = np.arctan2(approach[:, 1], approach[:, 0]), -np.arcsin(approach[:, 2])
    place = shoulder + direction * BALL * rng.uniform(size=(count, 1)) ** (1 / 3)
    return _poses(place, yaw, pitch, rng.uniform(-np.pi, np.pi, count))


def _table_grasps(count: int, rng: np.random.Generator) -> Floats:
    """T_base_tcp (n, 4, 4) of level grasps: in front of the robot, the approach within 90 degrees of the bearing."""
    away, bearing = rng.uniform(0.4, 1.2, count), rng.uniform(-np.pi / 2, np.pi / 2, count)
    height = rng.uniform(0.77, 1.0, count)
    yaw = bearing + rng.uniform(-np.pi / 2, np.pi / 2, count)
    place = np.column_stack([away * np.cos(bearing), away * np.sin(bearing), height])
    return _poses(place, yaw, np.zeros(count), np.zeros(count))


def _poses(place: Floats, yaw: Floats, pitch: Floats, roll: Floats) -> Floats:
    T = np.tile(np.eye(4), (len(place), 1, 1))
    T[:, :3, 3] = place
    T[:, :3, :3] = [rotation(*angles) for angles in zip(yaw, pitch, roll, strict=True)]
    return T


def _is_reached_in_mujoco(robot: RobotSpec, chain: ArmChain, T: Floats) -> NDArray[np.bool_]:
    """(n,) whether the exact solver's configuration is within the limits and takes the model's TCP site to the pose."""
    _, configurations = exact_solver(chain).solve(T)
    model = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    data = mujoco.MjData(model)
    columns = [model.joint(link.joint).qposadr[0] for link in robot.chain]
    site = model.site(robot.tcp_site).id
    limits = np.array([(link.lower, link.upper) for link in robot.chain])
    reached = np.zeros(len(T), dtype=bool)
    for k in np.flatnonzero(np.isfinite(configurations).all(axis=1)):
        q = configurations[k]
        data.qpos[columns] = q
        mujoco.mj_kinematics(model, data)
        miss = max(
            np.abs(data.site_xpos[site] - T[k, :3, 3]).max(),
            np.abs(data.site_xmat[site].reshape(3, 3) - T[k, :3, :3]).max(),
        )
        reached[k] = (
            miss < SAME_POSE and np.all(q >= limits[:, 0] - SAME_POSE) and np.all(q <= limits[:, 1] + SAME_POSE)
        )
    return reached


def _solve_by_scan(chain: ArmChain, T: Floats) -> NDArray[np.bool_]:
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
