"""The physics part of a saved state: captured, checked against a model, put back.

MuJoCo's integration state does not include which bodies sleep, so the lists of awake bodies are saved as well. MuJoCo
reads and writes memory at the indices in these lists without any check: wrong ones crash the process. Geoms are not
saved: a state saved without meshes can be restored with them, and without them after saving with them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from clutter_env.errors import StateError
from clutter_env.scene.table_scene import TableScene
from clutter_env.simulation.saved_state import LARGEST, Fields, check_quaternions
from clutter_env.simulation.world import World

_INTEGRATION = mujoco.mjtState.mjSTATE_INTEGRATION
_PARTS = tuple(
    part
    for name, part in mujoco.mjtState.__members__.items()
    if name != "mjNSTATE" and int(part) & int(_INTEGRATION) and int(part).bit_count() == 1
)
"""The components of the integration state, in the order in which MuJoCo stores them."""
_AWAKE_LISTS = ("tree_asleep", "tree_awake", "body_awake", "body_awake_ind", "parent_awake_ind", "dof_awake_ind")
_AWAKE_COUNTS = ("ntree_awake", "nbody_awake", "nparent_awake", "nv_awake")
_SLEEPING_OVERLAP = 1e-5
"""[m] by which bodies that fell asleep apart from each other may overlap; scenes of the user's own have up to 1e-6."""
_LARGEST_POSITION = 1e3
"""[m] or [rad], far outside any scene."""
_LARGEST_VELOCITY = 1e6
"""[m/s] or [rad/s]: its square is still a number that MuJoCo accepts."""

Integers = NDArray[np.int64]


@dataclass(frozen=True)
class PhysicsState:
    """A checked physics state of one model: MuJoCo's integration state, lists and counts of what is awake."""

    integration: NDArray[np.float64]
    lists: dict[str, Integers]
    counts: dict[str, int]


def capture_physics(world: World) -> dict[str, Any]:
    """The physics state, sleeping bodies included, as JSON values."""
    model, data = world.model, world.data
    integration = np.empty(mujoco.mj_stateSize(model, _INTEGRATION))
    mujoco.mj_getState(model, data, integration, _INTEGRATION)
    return {
        "integration": integration.tolist(),
        "lists": {name: getattr(data, name).tolist() for name in _AWAKE_LISTS},
        "counts": {name: int(getattr(data, name)) for name in _AWAKE_COUNTS},
    }


def read_physics(world: World, value: object) -> PhysicsState:
    """The physics state that `capture_physics` returned, checked for this world; nothing changes.

    Raises:
        StateError: an entry is missing, of another type or size, out of range, or does not agree with the others.
    """
    model = world.model
    read = Fields(value, "physics", ("integration", "lists", "counts"))
    integration = read.numbers("integration", (mujoco.mj_stateSize(model, _INTEGRATION),))
    parts = _split(model, integration)
    _check_range("time", parts[mujoco.mjtState.mjSTATE_TIME], 0.0, LARGEST)
    _check_range("positions", parts[mujoco.mjtState.mjSTATE_QPOS], -_LARGEST_POSITION, _LARGEST_POSITION)
    velocities = parts[mujoco.mjtState.mjSTATE_QVEL]
    _check_range("velocities", velocities, -_LARGEST_VELOCITY, _LARGEST_VELOCITY)
    if not np.isin(parts[mujoco.mjtState.mjSTATE_EQ_ACTIVE], (0, 1)).all():
        raise StateError("physics: the flags of active constraints in the state must be 0 or 1")
    free = np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE))
    rotations = model.jnt_qposadr[free][:, None] + np.arange(3, 7)
    check_quaternions("physics", parts[mujoco.mjtState.mjSTATE_QPOS][rotations])
    lists, counts = _read_awake(model, read)
    if velocities[lists["tree_asleep"][model.dof_treeid] >= 0].any():
        raise StateError("physics: a body of the state sleeps and moves")
    return PhysicsState(integration, lists, counts)


def restore_physics(world: World, scene: TableScene, state: PhysicsState) -> None:
    """Put a checked state back.

    Setting a state wakes every body. Therefore the quantities that sleeping bodies keep from their last step awake are
    computed, and then the bodies are put to sleep again.

    Raises:
        StateError: bodies that fell asleep apart from each other overlap; the world has not changed.
    """
    model, data, scene_before = world.model, world.data, world.scene
    mujoco.mj_copyData(world.spare_data, model, data)
    world.apply_scene(scene)
    mujoco.mj_resetData(model, data)
    mujoco.mj_setState(model, data, state.integration, _INTEGRATION)
    mujoco.mj_forward(model, data)
    if _sleepers_overlap(model, data, state.lists["tree_asleep"]):
        if scene_before is not None:
            world.apply_scene(scene_before)
        mujoco.mj_copyData(data, model, world.spare_data)
        raise StateError("physics: bodies of the state sleep and overlap")
    mujoco.mj_setState(model, data, state.integration, _INTEGRATION)
    for name in _AWAKE_LISTS:
        getattr(data, name)[:] = state.lists[name]
    for name in _AWAKE_COUNTS:
        setattr(data, name, state.counts[name])


def _sleepers_overlap(model: mujoco.MjModel, data: mujoco.MjData, asleep: Integers) -> bool:
    """Whether two trees of different sleeping cycles overlap: MuJoCo would wake only one of them, and then fail.

    Bodies that touch when they come to rest fall asleep together, in one cycle, and wake together.
    """
    is_asleep = asleep >= 0
    following = np.where(is_asleep, asleep, np.arange(len(asleep)))
    cycle = np.arange(len(asleep))
    for _ in range(len(asleep)):
        smallest = np.minimum(cycle, cycle[following])
        if np.array_equal(smallest, cycle):
            break
        cycle = smallest
    trees = model.body_treeid[model.geom_bodyid[data.contact.geom]].reshape(-1, 2)
    is_between_sleepers = ((trees >= 0) & is_asleep[trees]).all(axis=1) & (cycle[trees[:, 0]] != cycle[trees[:, 1]])
    return bool((is_between_sleepers & (data.contact.dist < -_SLEEPING_OVERLAP)).any())


def _split(model: mujoco.MjModel, integration: NDArray[np.float64]) -> dict[mujoco.mjtState, NDArray[np.float64]]:
    """The components of an integration state."""
    ends = np.cumsum([mujoco.mj_stateSize(model, part) for part in _PARTS])
    return dict(zip(_PARTS, np.split(integration, ends[:-1]), strict=True))


def _check_range(what: str, values: NDArray[np.float64], lowest: float, highest: float) -> None:
    if ((values < lowest) | (values > highest)).any():
        raise StateError(f"physics: {what} of the state must be from {lowest:g} to {highest:g}")


def _read_awake(model: mujoco.MjModel, read: Fields) -> tuple[dict[str, Integers], dict[str, int]]:
    """Lists and counts of what is awake: all follow from `tree_asleep`, but for entries beyond the counts."""
    lists = Fields(read["lists"], "physics lists", _AWAKE_LISTS)
    counts = Fields(read["counts"], "physics counts", _AWAKE_COUNTS)
    trees, bodies, dofs = model.ntree, model.nbody, model.nv
    asleep = lists.integers("tree_asleep", trees, -1 - int(mujoco.mjMINAWAKE), trees - 1)
    is_awake = asleep < 0
    sleeping = np.flatnonzero(~is_awake)
    if not np.array_equal(np.sort(asleep[sleeping]), sleeping):
        raise StateError("physics lists: tree_asleep of the state must link the sleeping trees in cycles")
    never = (int(mujoco.mjtSleepPolicy.mjSLEEP_AUTO_NEVER), int(mujoco.mjtSleepPolicy.mjSLEEP_NEVER))
    if np.isin(model.tree_sleep_policy[sleeping], never).any():
        raise StateError("physics lists: a tree of the state sleeps that never may")
    body_awake = np.where(model.body_treeid < 0, -1, is_awake[model.body_treeid])
    found = {"tree_asleep": asleep}
    for name, size, wanted in (
        ("tree_awake", trees, is_awake.astype(np.int64)),
        ("body_awake", bodies, body_awake),
        ("body_awake_ind", bodies, np.flatnonzero(body_awake)),
        ("parent_awake_ind", bodies, 1 + np.flatnonzero(body_awake[model.body_parentid[1:]])),
        ("dof_awake_ind", dofs, np.flatnonzero(is_awake[model.dof_treeid])),
    ):
        found[name] = lists.integers(name, size, -1, max(size - 1, 1))
        if not np.array_equal(found[name][: len(wanted)], wanted):
            raise StateError(f"physics lists: {name} of the state does not agree with tree_asleep")
    sizes = {
        "ntree_awake": int(is_awake.sum()),
        "nbody_awake": int(np.count_nonzero(body_awake)),
        "nparent_awake": int(np.count_nonzero(body_awake[model.body_parentid[1:]])),
        "nv_awake": int(np.count_nonzero(is_awake[model.dof_treeid])),
    }
    return found, {name: counts.integer(name, wanted, wanted) for name, wanted in sizes.items()}
