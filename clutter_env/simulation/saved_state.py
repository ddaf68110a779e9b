"""Saved states: everything that the next step depends on, as bytes that another process can restore.

MuJoCo's integration state does not include which bodies sleep, so the lists of awake bodies are saved as well. Geoms
are not saved: a state saved without meshes can be restored with them, and the other way round.
"""

from __future__ import annotations

import hashlib
import json
import zlib
from dataclasses import asdict, dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from clutter_env.errors import StateError
from clutter_env.scene.table_scene import TableScene
from clutter_env.simulation.world import World

__all__ = ["SavedState", "capture_physics", "pack", "restore_physics", "unpack"]

_MAGIC = b"clutter-env state 1\n"
_INTEGRATION = mujoco.mjtState.mjSTATE_INTEGRATION
_AWAKE_LISTS = ("tree_asleep", "tree_awake", "body_awake", "body_awake_ind", "parent_awake_ind", "dof_awake_ind")
_AWAKE_COUNTS = ("ntree_awake", "nbody_awake", "nparent_awake", "nv_awake")


@dataclass(frozen=True)
class SavedState:
    """A saved state, decoded: what kind of environment it belongs to and everything in it."""

    kind: dict[str, Any]
    scene: TableScene
    physics: dict[str, Any]
    memory: dict[str, Any]


def pack(saved: SavedState) -> bytes:
    """The bytes of a state: a magic line, a digest, and compressed JSON (which keeps every bit of a float)."""
    scene = {
        name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in asdict(saved.scene).items()
    }
    content = {"kind": saved.kind, "scene": scene, "physics": saved.physics, "memory": saved.memory}
    body = zlib.compress(json.dumps(content).encode(), level=1)
    return _MAGIC + hashlib.sha256(body).digest() + body


def unpack(state: object, kind: dict[str, Any]) -> SavedState:
    """The state in these bytes.

    Raises:
        StateError: not bytes, damaged, or of an environment or a MuJoCo version of another kind.
    """
    if not isinstance(state, bytes):
        raise StateError(f"a saved state is bytes from save_state(), not {type(state).__name__}")
    head, digest, body = state[: len(_MAGIC)], state[len(_MAGIC) : len(_MAGIC) + 32], state[len(_MAGIC) + 32 :]
    if head != _MAGIC or hashlib.sha256(body).digest() != digest:
        raise StateError("these bytes are no saved state of this version, or they are damaged")
    content = json.loads(zlib.decompress(body))
    for name, value in kind.items():
        if content["kind"].get(name) != value:
            raise StateError(f"the state was saved with {name}={content['kind'].get(name)!r}; this one has {value!r}")
    scene: dict[str, Any] = {
        name: np.array(value) if isinstance(value, list) else value for name, value in content["scene"].items()
    }
    count = len(scene["yaws"])
    scene["half_extents"], scene["positions"] = (
        scene["half_extents"].reshape(count, 3),
        scene["positions"].reshape(count, 2),
    )
    return SavedState(content["kind"], TableScene(**scene), content["physics"], content["memory"])


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


def restore_physics(world: World, saved: SavedState) -> None:
    """Put a captured state back.

    Setting a state wakes every body. Therefore the quantities that sleeping bodies keep from their last step awake are
    computed, and then the bodies are put to sleep again.

    Raises:
        StateError: the state is of a model of another size.
    """
    integration: NDArray[np.float64] = np.array(saved.physics["integration"])
    if len(integration) != mujoco.mj_stateSize(world.model, _INTEGRATION):
        raise StateError("the state was saved with another robot or another number of objects")
    world.apply_scene(saved.scene)
    model, data = world.model, world.data
    mujoco.mj_resetData(model, data)
    mujoco.mj_setState(model, data, integration, _INTEGRATION)
    mujoco.mj_forward(model, data)
    mujoco.mj_setState(model, data, integration, _INTEGRATION)
    for name in _AWAKE_LISTS:
        getattr(data, name)[:] = saved.physics["lists"][name]
    for name in _AWAKE_COUNTS:
        setattr(data, name, saved.physics["counts"][name])
