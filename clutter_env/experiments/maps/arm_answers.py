"""How good are the answers about any arm? The map and `decide` against MuJoCo, which shares no code with either.

Three tests by MuJoCo:

- Poses of random configurations are in reach: a NO is wrong. In half of these configurations most joints are within 1%
  of a limit.
- Random poses in the ball of the stretched arm: every YES must come with a configuration that MuJoCo takes to the pose.
- Random poses for which the answer is NO: inverse kinematics with MuJoCo's Jacobian, from random configurations, must
  not find a solution.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from clutter_env.experiments.maps.model_check import TipModel
from clutter_env.reporting.progress import progress_bar
from irm.arm.chain import ArmChain
from irm.arm.exact import exact_solver
from irm.checks.classification import classify, predict
from irm.checks.decide import decide
from irm.maps.grid import MapParameters
from irm.maps.reachability import ReachabilityMap
from irm.queries.status import Status

__all__ = ["ArmAnswers", "measure_arm"]

Floats = NDArray[np.float64]
Answers = NDArray[np.int8]

REACHED = 1e-4
"""[m], and the same number for entries of rotation matrices: a configuration this close reaches a pose."""
RESTARTS, STEPS = 20, 60
"""Random configurations and steps of the inverse kinematics that tries to refute a NO."""
DAMPING, LARGEST_STEP = 0.05, 0.3
"""Of its damped least squares: per unit of the remaining error; [rad]."""
REFUTED = 1e-6
"""[m], [rad]: closer than REACHED, since a pose may be out of reach by that little."""
NO, UNKNOWN, YES = Status.NO.value, Status.UNKNOWN.value, Status.YES.value


@dataclass(frozen=True)
class ArmAnswers:
    """Answers about one arm; shares are in 0 … 1, of the random poses.

    Attributes:
        robot: its name.
        map_poses, build_s: poses of its map, and CPU time of building it [s].
        poses: random poses, above the floor.
        reachable: share that is in reach.
        accuracy, true_positives, false_positives: of the plain map, where the truth is known.
        map_unknown, map_unknown_of_reachable: UNKNOWN of `classify`: of all poses, and of those in reach.
        unknown: share of UNKNOWN of `decide`.
        microseconds: CPU time of `decide` per pose.
        map_wrong: wrong answers of `classify`, in the first two tests.
        wrong: wrong answers of `decide`, all three tests together.
        reached, refutations: number of poses of the first and of the third test.
    """

    robot: str
    map_poses: int
    build_s: float
    poses: int
    reachable: float
    accuracy: float
    true_positives: float
    false_positives: float
    map_unknown: float
    map_unknown_of_reachable: float
    unknown: float
    microseconds: float
    map_wrong: int
    wrong: int
    reached: int
    refutations: int


def measure_arm(arm: TipModel, parameters: MapParameters, counts: tuple[int, int], seed: int) -> ArmAnswers:
    """Build the map of an arm and count its right and wrong answers.

    Args:
        arm: model and chain.
        parameters: of the map.
        counts: random poses, and poses of the test by inverse kinematics.
        seed: random seed.
    """
    rng, chain = np.random.default_rng(seed), arm.chain
    start = time.process_time()
    rm = ReachabilityMap.build(chain, progress=progress_bar, **vars(parameters))
    build_s = time.process_time() - start
    T = _random_poses(chain, counts[0], rng)
    decide(rm, T[:1])  # compiles
    start = time.process_time()
    answer = decide(rm, T)
    seconds = time.process_time() - start
    truth = _proved(arm, T)
    mapped, plain, known = classify(rm, T), predict(rm, T), truth != UNKNOWN
    T_reached = _reached_poses(arm, counts[0], rng)
    tried = np.flatnonzero(answer == NO)[: counts[1]]
    refuted = sum(_finds_solution(arm, T[k], rng) for k in progress_bar(tried, "trying to refute NO"))
    return ArmAnswers(
        robot=chain.robot,
        map_poses=len(rm),
        build_s=build_s,
        poses=len(T),
        reachable=float(np.mean(truth == YES)),
        accuracy=float(np.mean(plain[known] == (truth[known] == YES))),
        true_positives=float(plain[truth == YES].mean()),
        false_positives=float(plain[truth == NO].mean()),
        map_unknown=float(np.mean(mapped == UNKNOWN)),
        map_unknown_of_reachable=float(np.mean(mapped[truth == YES] == UNKNOWN)),
        unknown=float(np.mean(answer == UNKNOWN)),
        microseconds=seconds / len(T) * 1e6,
        map_wrong=_count_wrong(mapped, truth) + int(np.sum(classify(rm, T_reached) == NO)),
        wrong=_count_wrong(answer, truth) + int(np.sum(decide(rm, T_reached) == NO)) + refuted,
        reached=len(T_reached),
        refutations=len(tried),
    )


def _count_wrong(answers: Answers, truth: Answers) -> int:
    """Every YES without a configuration, and every NO with one."""
    return int(np.sum(((answers == YES) & (truth != YES)) | ((answers == NO) & (truth == YES))))


def _random_poses(chain: ArmChain, count: int, rng: np.random.Generator) -> Floats:
    """T_base_tcp (n, 4, 4): uniform positions above the floor in the ball of the stretched arm, uniform rotations."""
    reach = np.linalg.norm(chain.offsets[2:, :3], axis=1).sum() + np.linalg.norm(chain.tip[:3])
    direction = rng.normal(size=(count, 3))
    direction *= reach * rng.random((count, 1)) ** (1 / 3) / np.linalg.norm(direction, axis=1, keepdims=True)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = _uniform_rotations(count, rng), direction + chain.offsets[0, :3] + chain.offsets[1, :3]
    return T[T[:, 2, 3] > 0.0]


def _uniform_rotations(count: int, rng: np.random.Generator) -> Floats:
    """(n, 3, 3) uniformly distributed rotations."""
    Q, _ = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    return np.asarray(Q * np.linalg.det(Q)[:, None, None])


def _proved(arm: TipModel, T: Floats) -> Answers:
    """Answers of the exact solver; a YES that MuJoCo does not confirm is UNKNOWN."""
    answers, q = exact_solver(arm.chain).solve(T)
    for k in np.flatnonzero(answers == YES):
        if np.abs(arm.tcp_pose(q[k]) - T[k]).max() > REACHED or not _within_limits(arm.chain, q[k]):
            answers[k] = UNKNOWN
    return answers


def _within_limits(chain: ArmChain, q: Floats) -> bool:
    return bool(np.all((q >= chain.lower) & (q <= chain.upper)))


def _reached_poses(arm: TipModel, count: int, rng: np.random.Generator) -> Floats:
    """T_base_tcp (n, 4, 4) of random configurations, above the floor, by MuJoCo."""
    chain = arm.chain
    side = rng.uniform(-1, 1, (count, chain.size))
    at_limit = (rng.random(side.shape) < 0.6) & (np.arange(count) % 2 == 0)[:, None]
    side = np.where(at_limit, np.sign(side) * (1 - 0.01 * rng.random(side.shape)), side)
    middle, half = (chain.lower + chain.upper) / 2, np.minimum((chain.upper - chain.lower) / 2, np.pi)
    T = np.array([arm.tcp_pose(q) for q in middle + side * half])
    return np.asarray(T[T[:, 2, 3] > 0.0])


def _finds_solution(arm: TipModel, T: Floats, rng: np.random.Generator) -> bool:
    """Whether damped least squares with MuJoCo's Jacobian reaches a pose from any of some random configurations."""
    chain = arm.chain
    middle, half = (chain.lower + chain.upper) / 2, np.minimum((chain.upper - chain.lower) / 2, np.pi)
    for _ in range(RESTARTS):
        q = middle + half * rng.uniform(-1, 1, chain.size)
        for _ in range(STEPS):
            error = _error(arm.tcp_pose(q), T)
            if np.abs(error).max() < REFUTED:
                return True
            damping = (DAMPING * np.abs(error).max()) ** 2 + 1e-10
            J = arm.jacobian()
            step = J.T @ np.linalg.solve(J @ J.T + damping * np.eye(6), error)
            q = np.clip(q + step * min(1.0, LARGEST_STEP / np.abs(step).max()), chain.lower, chain.upper)
    return False


def _error(T: Floats, T_goal: Floats) -> Floats:
    """(6,) motion to the goal: position [m], rotation vector [rad]."""
    quaternion, turn = np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(quaternion, (T_goal[:3, :3] @ T[:3, :3].T).ravel())
    mujoco.mju_quat2Vel(turn, quaternion, 1.0)
    return np.concatenate([T_goal[:3, 3] - T[:3, 3], turn])
