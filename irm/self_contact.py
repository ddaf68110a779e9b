"""Pairs of a robot's shapes that are tested for self-collision: the common rule of its maps, planner and physics.

A pair is tested if its links are not neighbours, unless it touches in nearly all of 1,000 random configurations. Shapes
that touch in nearly every configuration belong together, such as boxes around the meshes of short links. MoveIt's Setup
Assistant uses the same rule.

This module needs only NumPy and MuJoCo, because the environments use the rule without compiled kernels.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import mujoco

BASE = -1
"""Link number of bodies fixed to the base. 0 is the torso with the head, 1 … n are the links of the arm."""
CLEARANCE = 0.002
"""[m] Least distance of the shapes of a pair in a free configuration, and the planner's padding."""
_SAMPLES, _NEARLY_ALWAYS = 1000, 0.95
"""Number of random configurations, and the share in which a pair must touch to be left out."""


def is_solid(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Mark the collision geoms (ngeom,): those with any collision bit, or named in a pair."""
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    solid[model.pair_geom1], solid[model.pair_geom2] = True, True
    return np.asarray(solid)


def link_of_body(model: mujoco.MjModel, joints: Sequence[str]) -> list[int]:
    """The link of each body of a model: that of the nearest of the chain's `joints` that moves it.

    The head belongs to the torso, the fingers to the last link. The base and bodies outside the robot have BASE.
    """
    moved = {int(model.joint(joint).bodyid[0]): number for number, joint in enumerate(joints)}
    links: list[int] = []
    for body in range(model.nbody):  # a parent has a lower number than its children
        links.append(moved.get(body, links[int(model.body_parentid[body])] if body else BASE))
    return links


def counted_pairs(
    model: mujoco.MjModel,
    qpos: NDArray[np.float64],
    geoms: Sequence[int],
    links: Sequence[int],
    joints: Sequence[int],
) -> NDArray[np.int64]:
    """Find the pairs (s, 2) of indices into `geoms` to test, in increasing order.

    Collision masks and `<exclude>` are ignored, because many models let a robot pass through itself.

    Args:
        model: of the robot.
        qpos: (nq,) positions of the joints outside the chain.
        geoms: ids of the shapes.
        links: number of the link of each body: BASE, 0 … n.
        joints: ids of the chain's joints.
    """
    link = [links[int(model.geom_bodyid[geom])] for geom in geoms]
    distant = [(i, j) for i, j in itertools.combinations(range(len(geoms)), 2) if abs(link[i] - link[j]) > 1]
    touching = _count_touching(model, qpos, geoms, joints)
    kept = [pair for pair in distant if touching[pair] < _NEARLY_ALWAYS * _SAMPLES]
    return np.array(kept, dtype=np.int64).reshape(-1, 2)


def is_excluded(model: mujoco.MjModel, pairs: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Mark the pairs (s, 2) of geom ids whose bodies the model excludes from contact with each other."""
    bodies = np.sort(model.geom_bodyid[pairs].reshape(-1, 2), axis=1).astype(np.int64)
    ends = np.sort(np.stack([model.exclude_signature >> 16, model.exclude_signature & 0xFFFF], axis=-1), axis=1)
    return np.isin(bodies @ (1 << 16, 1), ends.astype(np.int64) @ (1 << 16, 1))


def _count_touching(
    model: mujoco.MjModel, qpos: NDArray[np.float64], geoms: Sequence[int], joints: Sequence[int]
) -> NDArray[np.int64]:
    """Number (p, p) of random configurations in which two of the geoms are nearer than `CLEARANCE`."""
    import mujoco  # a function needs the simulator, the package does not

    model, columns = _all_colliding(model, geoms), model.jnt_qposadr[list(joints)]
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    limited = model.jnt_limited[list(joints)].astype(bool)
    low, high = np.where(limited[:, None], model.jnt_range[list(joints)], (-np.pi, np.pi)).T
    index = np.full(model.ngeom, -1)
    index[list(geoms)] = range(len(geoms))
    touching, rng = np.zeros((len(geoms), len(geoms)), np.int64), np.random.default_rng(0)
    for q in rng.uniform(low, high, (_SAMPLES, len(low))):
        data.qpos[columns] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        near = index[data.contact.geom[data.contact.dist < CLEARANCE]]
        touching[near[:, 0], near[:, 1]] += 1  # several contacts of a pair are counted once
    return touching + touching.T


def _all_colliding(model: mujoco.MjModel, geoms: Sequence[int]) -> mujoco.MjModel:
    """Copy the model so that exactly these geoms can touch each other."""
    import mujoco  # see `_count_touching`

    free = copy.copy(model)
    for of in ("geom", "body"):
        for bits in ("contype", "conaffinity"):
            getattr(free, f"{of}_{bits}")[:] = 0
    free.geom_contype[list(geoms)] = free.geom_conaffinity[list(geoms)] = 1
    bodies = model.geom_bodyid[list(geoms)]
    free.body_contype[bodies] = free.body_conaffinity[bodies] = 1
    free.geom_margin[list(geoms)] = CLEARANCE
    free.geom_gap[:] = 0.0
    free.exclude_signature[:] = 0  # of the world with itself
    free.opt.disableflags = int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
    free.opt.enableflags = 0
    return free
