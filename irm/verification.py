"""Exact verification of the bases of a placement: inverse kinematics, and the caller's own collision check.

A map consists of cells. It contains neither configurations nor obstacles. `verify` takes the bases of a placement in
order and returns the first one that is valid: the arm reaches every TCP pose exactly, in a configuration that the
caller accepts, and consecutive configurations are close to each other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.answers import BasePlacement
from irm.chain import PRISMATIC, ArmChain
from irm.compilation import njit
from irm.errors import ChainError, QueryError
from irm.ik.closed_form import inverse
from irm.ik.numerical import random_seeds, solve
from irm.kinematics import forward
from irm.query_keys import as_positions
from irm.rotations import rotation, world_to_base

if TYPE_CHECKING:
    import mujoco

Floats = NDArray[np.float64]
_COMPARED = 200
"""Random configurations of `compare_with_model`."""

_TORSOS = 8
"""Torso heights that are tried, evenly over the range."""
_ROLLS = 36
"""Upper-arm rolls that are tried per turn, for arms with a closed form."""
_SEEDS = 12
"""Random starting configurations per torso height, for all other arms."""
LARGEST_STEP, LARGEST_LIFT = 0.35, 0.06
"""Largest motion of an arm joint [rad] and of the torso [m] between consecutive TCP poses."""
_SAME = 1e-6
"""[m], and the same number for entries of rotation matrices: two correct chains differ by rounding only."""

IsFree = Callable[[Floats, Floats], bool]
"""Whether a base pose (3,) with a configuration (1 + n,) is free of collisions."""


@dataclass(frozen=True)
class Verified:
    """A base from which every TCP pose is reached.

    Attributes:
        rank: its index in the placement, 0 for the best.
        base: (3,) x, y [m], yaw [rad].
        configurations: (m, 1 + n) one configuration per TCP pose, each close to the one before.
    """

    rank: int
    base: Floats
    configurations: Floats


@dataclass(frozen=True)
class NotVerified:
    """None of the bases is valid.

    Attributes:
        reached: (k,) number of TCP poses, from the first on, that were reached from each base.
    """

    reached: tuple[int, ...]


def tcp_poses(positions: ArrayLike, yaw: float, pitch: float = 0.0, roll: float = 0.0) -> Floats:
    """T_world_tcp of one orientation at several positions.

    Args:
        positions: (m, 3), or (3,) for m = 1 [m].
        yaw, pitch, roll: ZYX angles of the orientation [rad].

    Returns:
        (m, 4, 4).

    Raises:
        QueryError: the positions are not an array of finite numbers.
    """
    points = as_positions(positions)
    T = np.tile(np.eye(4), (len(points), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = rotation(yaw, pitch, roll), points
    return T


def configurations(chain: ArmChain, T_base_tcp: ArrayLike) -> Floats:
    """(k, 1 + n) configurations that reach a pose (4, 4), over the arm's free parameters."""
    low, high = float(chain.lower[0]), float(chain.upper[0])
    torsos = np.linspace(low, high, _TORSOS) if high > low else np.array([low])
    if chain.has_closed_form:
        return inverse(chain, T_base_tcp, torsos, np.linspace(-np.pi, np.pi, _ROLLS, endpoint=False))
    rng = np.random.default_rng(0)
    return solve(chain, T_base_tcp, np.concatenate([random_seeds(chain, _SEEDS, torso, rng) for torso in torsos]))


def verify(
    chain: ArmChain,
    placement: BasePlacement,
    poses_of: Callable[[int], ArrayLike],
    is_free: IsFree | None = None,
    *,
    limit: int = 5,
) -> Verified | NotVerified:
    """The first of the best bases from which the arm reaches every TCP pose free of collisions.

    Args:
        chain: of the robot.
        placement: what to verify.
        poses_of: from the rank of a base to its T_world_tcp (m, 4, 4); bases may differ in their approach yaw.
        is_free: whether a configuration is free of collisions; None accepts every configuration.
        limit: number of bases to test at most.

    Raises:
        QueryError: `poses_of` returns anything but an array (m, 4, 4) with m ≥ 1.

    Example:
        placement = inverse_map.query_path(offsets, target=cup, free_space=floor, k=5)
        path = lambda rank: tcp_poses(waypoints(placement.approach_yaw[rank]), placement.approach_yaw[rank])
        match verify(chain, placement, path, is_free):
            case Verified(base=base, configurations=q): ...
    """
    reached = []
    for rank in range(min(limit, len(placement))):
        T_world_tcp = np.asarray(poses_of(rank), dtype=float)
        if T_world_tcp.ndim != 3 or T_world_tcp.shape[1:] != (4, 4) or len(T_world_tcp) == 0:
            raise QueryError(f"TCP poses of one base are an array (m, 4, 4) with m ≥ 1, not {T_world_tcp.shape}")
        base = placement.poses[rank]
        path = _configuration_path(chain, base, world_to_base(base) @ T_world_tcp, is_free)
        if len(path) == len(T_world_tcp):
            return Verified(rank, base, path)
        reached.append(len(path))
    return NotVerified(tuple(reached))


def _configuration_path(chain: ArmChain, base: Floats, T_base_tcp: Floats, is_free: IsFree | None) -> Floats:
    """One configuration per TCP pose, each within a step of the one before, up to the last pose that has one."""
    limits = np.full(chain.size, LARGEST_STEP)
    limits[0] = LARGEST_LIFT
    # Angles of joints that turn without limit count modulo a turn.
    turning = (chain.axes < PRISMATIC) & (chain.upper - chain.lower >= 2 * np.pi)
    layers: list[Floats] = []
    parents: list[NDArray[np.int64]] = []
    for T in T_base_tcp:
        found = configurations(chain, T)
        parent = np.zeros(len(found), dtype=np.int64)
        if layers and len(found):
            parent = _nearest_parents(found, layers[-1], limits, turning)
            found, parent = found[parent >= 0], parent[parent >= 0]
        if is_free is not None:
            free = np.array([is_free(base, q) for q in found], dtype=bool)
            found, parent = found[free], parent[free]
        if not len(found):
            break
        layers.append(found)
        parents.append(parent)
    path: list[Floats] = []
    index = 0
    for found, parent in zip(reversed(layers), reversed(parents), strict=True):
        path.append(found[index])
        index = int(parent[index])
    return np.array(path[::-1]).reshape(-1, chain.size)


@njit(cache=True)
def _nearest_parents(found: Floats, before: Floats, limits: Floats, turning: NDArray[np.bool_]) -> NDArray[np.int64]:
    """For each configuration (k, n) the nearest of those before (m, n), measured in steps; -1 if none is within one
    step."""
    parents = np.full(found.shape[0], -1)
    for i in range(found.shape[0]):
        nearest = 1.0
        for j in range(before.shape[0]):
            widest = 0.0
            for joint in range(limits.shape[0]):
                apart = abs(found[i, joint] - before[j, joint])
                if turning[joint]:
                    apart = min(apart, abs(2.0 * np.pi - apart))
                widest = max(widest, apart / limits[joint])
                if widest > nearest:
                    break
            if widest <= nearest:
                nearest = widest
                parents[i] = j
    return parents


class SelfCollision:
    """Whether a configuration is free of self-collision: an `is_free` for `verify`. It needs the simulator.

    Only the pairs in `chain.self_collisions` count; everything else in the model is ignored. Joints that are not the
    arm's stay at their initial positions.

    Example:
        is_free = SelfCollision(model, chain)
        verify(chain, placement, poses_of, is_free)
    """

    def __init__(self, model: mujoco.MjModel, chain: ArmChain) -> None:
        import mujoco  # the package does not need the simulator

        self._mujoco, self._model, self._data = mujoco, model, mujoco.MjData(model)
        self._moving = [k for k, name in enumerate(chain.joints) if name]
        self._columns = [model.joint(chain.joints[k]).qposadr[0] for k in self._moving]
        self._pairs = {frozenset(pair) for pair in chain.self_collisions}

    def __call__(self, _base: Floats, q: Floats) -> bool:
        """Whether no pair of bodies penetrates in the configuration `q` (1 + n,); the base pose does not matter."""
        model, data = self._model, self._data
        data.qpos[self._columns] = q[self._moving]
        self._mujoco.mj_kinematics(model, data)
        self._mujoco.mj_comPos(model, data)
        self._mujoco.mj_collision(model, data)
        bodies = model.geom_bodyid[data.contact.geom[data.contact.dist < 0.0]]
        return not any(
            frozenset(str(model.body(body).name) or f"body {body}" for body in pair) in self._pairs for pair in bodies
        )


def compare_with_model(chain: ArmChain, model: mujoco.MjModel, base: str, tip: str, approach: str = "x") -> None:
    """Compare the TCP poses of a chain with those of MuJoCo in random configurations; arguments as of `from_mjcf`.

    Raises:
        ChainError: they differ by more than rounding.
    """
    from irm.model_reading import tcp_pose_of_model  # needs the simulator

    rng = np.random.default_rng(0)
    low, high = np.maximum(chain.lower, -np.pi), np.minimum(chain.upper, np.pi)
    worst = 0.0
    for q in rng.uniform(low, high, (_COMPARED, chain.size)):
        T = tcp_pose_of_model(model, dict(zip(chain.joints, q.tolist(), strict=True)), base, tip, approach)
        worst = max(worst, float(np.abs(T - forward(chain, q)).max()))
    if worst > _SAME:
        raise ChainError(
            f"the chain of {chain.robot} does not agree with its model: TCP poses differ by {worst:.3g} (m, or entries "
            "of rotation matrices)"
        )
