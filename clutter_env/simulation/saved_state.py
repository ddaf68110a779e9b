"""Saved states: the full simulator and controller state, as bytes that another process can restore.

The bytes carry a checksum against damage. As anyone can compute it, everything in the bytes is checked before anything
changes: names, types, shapes, ranges and consistency.

MuJoCo's integration state does not include which bodies sleep, so the lists of awake bodies are saved as well. MuJoCo
reads and writes memory at the indices in these lists without any check. Wrong indices would crash the process. Geoms
are not saved, so a state can be restored with or without meshes.
"""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Collection, Mapping, Sequence
from copy import deepcopy
from dataclasses import asdict, dataclass, fields
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from clutter_env.errors import StateError
from clutter_env.scene.table_scene import TableScene
from clutter_env.simulation.world import World

_MAGIC = b"clutter-env state 4\n"
_MOST_BYTES = 2**24
"""Largest size of a state. A state of 60 objects has about 10⁵ bytes of JSON. Larger input is refused before it fills
the memory."""
_MOST_JOINED_BYTES = 2**29
"""The same for the states of an episode together."""
_DIGEST = 32
"""Bytes of the digest after the magic line."""
_PARTS = ("kind", "scene", "physics", "memory")

_LARGEST_HALF_EXTENT = 1.0
"""[m]"""
_MASS_RANGE = (1e-3, 100.0)
"""[kg]"""
_LARGEST_JOINT = 100.0
"""Largest friction and damping of drawers and doors: [N], [N m], and the same per unit of speed."""
_PLACE_RANGE = 10.0
"""[m] of start positions from the table's centre, [rad] of start angles."""


def pack(kind: Mapping[str, Any], scene: TableScene, physics: Mapping[str, Any], memory: Mapping[str, Any]) -> bytes:
    """The bytes of a state: a magic line, a digest, and compressed JSON (which keeps every bit of a float).

    Args:
        kind: properties that the restoring and the saving environment must have in common.
        scene: of the episode.
        physics: from `capture_physics`.
        memory: the environment's own variables besides the physics.
    """
    arrays = {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in asdict(scene).items()}
    if not len(scene.joints):
        del arrays["joints"]
    content = {"kind": kind, "scene": arrays, "physics": physics, "memory": memory}
    body = zlib.compress(json.dumps(content).encode(), level=1)
    return _sealed(body)


def unpack(
    state: object, kind: dict[str, Any], has_target: bool = True, num_joints: int = 0
) -> tuple[TableScene, Any, Any]:
    """Scene, physics and memory from the bytes of `pack`. Kind and scene are checked, physics and memory are not yet.

    A scene with objects has a target exactly if `has_target` is True. `num_joints` is the number of joints of drawers
    and doors.

    Raises:
        StateError: not bytes, damaged, invalid, or of an environment or a MuJoCo version of another kind.
    """
    content = Fields(_decode(state), "the top level", _PARTS)
    there = Fields(content["kind"], "kind", list(kind))
    for name, value in kind.items():
        if json.dumps(there[name], sort_keys=True) != json.dumps(value, sort_keys=True):
            raise StateError(f"the state was saved with {name}={there[name]!r}; this one has {value!r}")
    scene = _read_scene(content["scene"], kind["num_objects"], has_target, num_joints)
    return scene, content["physics"], content["memory"]


def join_states(states: Sequence[bytes]) -> bytes:
    """Join the states of one episode. They take less than half of the space, because most of their content is the same.

    Args:
        states: each from `pack`.
    """
    return zlib.compress(b"\n".join(zlib.decompress(state[len(_MAGIC) + _DIGEST :]) for state in states), level=6)


def split_states(joined: bytes) -> tuple[bytes, ...]:
    """Split joined states, bit for bit as `join_states` took them. Their content is not checked here but by `unpack`.

    Raises:
        ValueError: damaged, or larger than any episode.
    """
    try:
        stream = zlib.decompressobj()
        text = stream.decompress(joined, _MOST_JOINED_BYTES)
        is_whole = stream.eof and not stream.unused_data
    except zlib.error:
        is_whole = False
    if not is_whole:
        raise ValueError("the joined states are damaged")
    return tuple(_sealed(zlib.compress(part, level=1)) for part in text.split(b"\n"))


def _sealed(body: bytes) -> bytes:
    return _MAGIC + hashlib.sha256(body).digest() + body


def check_generator(generator: np.random.Generator, state: Any) -> None:
    """Check that a random generator of this kind accepts this state. `generator` does not change.

    Raises:
        StateError: it does not.
    """
    scratch = deepcopy(generator.bit_generator)
    try:
        scratch.state = state
    except (TypeError, ValueError, KeyError, AttributeError, OverflowError) as problem:
        raise StateError(f"memory: rng of the state is no state of {type(scratch).__name__}: {problem}") from None
    if json.dumps(scratch.state, sort_keys=True) != json.dumps(state, sort_keys=True):
        raise StateError(f"memory: rng of the state is no state of {type(scratch).__name__}")


def _decode(state: object) -> Any:
    if not isinstance(state, bytes):
        raise StateError(f"a saved state is bytes from save_state(), not {type(state).__name__}")
    start, end = len(_MAGIC), len(_MAGIC) + _DIGEST
    head, digest, body = state[:start], state[start:end], state[end:]
    for version in (1, 2):
        if head == _MAGIC.replace(b"4", str(version).encode()):
            raise StateError(f"version 0.{version} saved this state, under another rule of success; save it again")
    if head != _MAGIC or hashlib.sha256(body).digest() != digest:
        raise StateError("these bytes are no saved state of this version, or they are damaged")
    try:
        stream = zlib.decompressobj()
        text = stream.decompress(body, _MOST_BYTES)
        if not stream.eof or stream.unused_data:
            raise StateError(f"the state is incomplete, or has more than {_MOST_BYTES} bytes")
        return json.loads(text)
    except (zlib.error, ValueError, RecursionError) as problem:
        raise StateError(f"the state cannot be decoded: {problem}") from None


def _read_scene(value: object, most_objects: int, has_target: bool, num_joints: int) -> TableScene:
    """Read the scene in a state of an environment with at most this many objects."""
    names = [entry.name for entry in fields(TableScene) if num_joints or entry.name != "joints"]
    read = Fields(value, "scene", names)
    count = len(read["yaws"]) if isinstance(read["yaws"], list) else 0
    if not min(most_objects, 1) <= count <= most_objects:
        raise StateError(
            f"the state has {count} objects; this environment has {min(most_objects, 1)} to {most_objects}"
        )
    scene = TableScene(
        half_extents=read.numbers("half_extents", (count, 3), 1e-3, _LARGEST_HALF_EXTENT),
        is_box=read.flags("is_box", count),
        positions=read.numbers("positions", (count, 2), -_PLACE_RANGE, _PLACE_RANGE),
        yaws=read.numbers("yaws", (count,), -_PLACE_RANGE, _PLACE_RANGE),
        masses=read.numbers("masses", (count,), *_MASS_RANGE),
        base=read.numbers("base", (3,), -_PLACE_RANGE, _PLACE_RANGE),
        target=read.integer("target", 0, count - 1) if count and has_target else read.integer("target", -1, -1),
        is_lying=read.flags("is_lying", count),
        levels=read.numbers("levels", (count,), 0.0, _PLACE_RANGE),
        **({"joints": read.numbers("joints", (num_joints, 2), 0.0, _LARGEST_JOINT)} if num_joints else {}),
    )
    if (scene.is_lying & scene.is_box).any():
        raise StateError("scene: is_lying of the state must be false for a box")
    is_oval = ~scene.is_box & (scene.half_extents[:, 0] != scene.half_extents[:, 1])
    if is_oval.any():
        raise StateError("scene: half_extents of the state must have equal entries along x and y for a cylinder")
    return scene


_LARGEST = 1e10
"""Largest magnitude of a number in a state: MuJoCo resets a simulation with a larger one (mjMAXVAL)."""
_UNIT_TOLERANCE = 1e-6
"""Tolerance of the norm of a saved quaternion. MuJoCo normalises them to 1e-15 in every step."""


class Fields:
    """A dictionary of a decoded state with exactly the given names.

    Args:
        value: the value decoded from JSON.
        place: its place in the state, for messages.
        names: of the entries that it must have.

    Raises:
        StateError: not a dictionary, or with other names. All methods raise it for an entry that is not valid.
    """

    def __init__(self, value: object, place: str, names: Collection[str]) -> None:
        if not isinstance(value, dict) or set(value) != set(names):
            raise StateError(f"{place} of the state must have exactly the entries {', '.join(names)}")
        self._value: dict[str, Any] = value
        self._place = place

    def __getitem__(self, name: str) -> Any:
        """The entry as it was decoded."""
        return self._value[name]

    def integer(self, name: str, lowest: int, highest: int) -> int:
        """An integer from `lowest` to `highest`, both included."""
        value: int = self._entries(name, (), "an integer", {int}, lowest, highest)[0]
        return value

    def numbers(
        self, name: str, shape: tuple[int, ...], lowest: float = -_LARGEST, highest: float = _LARGEST
    ) -> NDArray[np.float64]:
        """An array (shape) of finite numbers from `lowest` to `highest`, both included."""
        entries = self._entries(name, shape, f"finite numbers of shape {shape}", {int, float}, lowest, highest)
        return np.array(entries, np.float64).reshape(shape)

    def integers(self, name: str, size: int, lowest: int, highest: int) -> NDArray[np.int64]:
        """An array (size,) of integers from `lowest` to `highest`, both included."""
        return np.array(self._entries(name, (size,), f"{size} integers", {int}, lowest, highest), np.int64)

    def flags(self, name: str, *shape: int) -> NDArray[np.bool_]:
        """An array (shape) of true and false."""
        entries = self._entries(name, shape, f"true or false, of shape {shape}", {bool}, False, True)
        return np.array(entries, np.bool_).reshape(shape)

    def _entries(
        self, name: str, shape: tuple[int, ...], wanted: str, kinds: set[type], lowest: float, highest: float
    ) -> list[Any]:
        """The entries of nested lists of this shape, in order, if all are of these types and within the range."""
        entries: list[Any] = [self._value[name]]
        for size in shape:
            if not all(isinstance(entry, list) and len(entry) == size for entry in entries):
                entries = [None]  # None is of no valid type
                break
            entries = [inner for entry in entries for inner in entry]
        # The comparison is false for NaN too.
        if not set(map(type, entries)) <= kinds or not all(lowest <= entry <= highest for entry in entries):
            shown = repr(self._value[name])[:80]
            limits = "" if kinds == {bool} else f" from {lowest:g} to {highest:g}"
            raise StateError(f"{self._place}: {name} of the state must be {wanted}{limits}, not {shown}")
        return entries


def check_quaternions(place: str, quaternions: NDArray[np.float64]) -> None:
    """Raise StateError unless quaternions (..., 4) have the length 1. `place` names their place in the state."""
    if (np.abs(np.linalg.norm(quaternions, axis=-1) - 1) > _UNIT_TOLERANCE).any():
        raise StateError(f"{place}: a quaternion of the state has not the length 1")


Integers = NDArray[np.int64]

_INTEGRATION = mujoco.mjtState.mjSTATE_INTEGRATION
_COMPONENTS = tuple(
    part
    for name, part in mujoco.mjtState.__members__.items()
    if name != "mjNSTATE" and int(part) & int(_INTEGRATION) and int(part).bit_count() == 1
)
"""The components of the integration state, in the order in which MuJoCo stores them."""
_AWAKE_LISTS = ("tree_asleep", "tree_awake", "body_awake", "body_awake_ind", "parent_awake_ind", "dof_awake_ind")
_AWAKE_COUNTS = ("ntree_awake", "nbody_awake", "nparent_awake", "nv_awake")
_SLEEPING_OVERLAP = 1e-5
"""[m] Largest overlap of bodies that fell asleep apart from each other. The user's own scenes have up to 1e-6."""
_LARGEST_POSITION = 1e3
"""[m] or [rad], far outside any scene."""
_LARGEST_SPEED = 20.0
"""[m/s] of an object, the base or the torso. A fall from the table ends at 4 m/s. Random actions at full speed gave
objects at most 3.4 m/s. At 20 m/s a body moves by twice the thinnest object's width in a physics step."""
_LARGEST_TURNS = _LARGEST_SPEED / 0.01, _LARGEST_SPEED / 0.1
"""[rad/s] of an object, whose rim has that speed at the smallest radius, 1 cm, and of a joint, at a lever of 10 cm."""


@dataclass(frozen=True)
class PhysicsState:
    """A checked physics state of one model: MuJoCo's integration state, and lists and counts of awake bodies."""

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
    """Check the physics state that `capture_physics` returned for this world. Nothing changes.

    Raises:
        StateError: an entry is missing, of another type or size, out of range, or inconsistent with the others.
    """
    model = world.model
    read = Fields(value, "physics", ("integration", "lists", "counts"))
    integration = read.numbers("integration", (mujoco.mj_stateSize(model, _INTEGRATION),))
    ends = np.cumsum([mujoco.mj_stateSize(model, part) for part in _COMPONENTS])
    parts = dict(zip(_COMPONENTS, np.split(integration, ends[:-1]), strict=True))
    _check_range("time", parts[mujoco.mjtState.mjSTATE_TIME], 0.0, _LARGEST)
    _check_range("positions", parts[mujoco.mjtState.mjSTATE_QPOS], -_LARGEST_POSITION, _LARGEST_POSITION)
    velocities = parts[mujoco.mjtState.mjSTATE_QVEL]
    largest = _largest_velocities(model)
    _check_range("velocities as shares of the largest that occur", velocities / largest, -1.0, 1.0)
    for part in (mujoco.mjtState.mjSTATE_QFRC_APPLIED, mujoco.mjtState.mjSTATE_XFRC_APPLIED):
        _check_range("applied forces", parts[part], 0.0, 0.0)  # the environment applies none
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
        StateError: bodies that fell asleep apart from each other overlap. The world has not changed.
    """
    model, data, scene_before = world.model, world.data, getattr(world, "scene", None)
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


def _largest_velocities(model: mujoco.MjModel) -> NDArray[np.float64]:
    """The largest velocity (nv,) that each degree of freedom can have."""
    kinds = model.jnt_type[model.dof_jntid]
    is_slide, is_hinge = (kinds == int(kind) for kind in (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE))
    is_turn = np.arange(model.nv) - model.jnt_dofadr[model.dof_jntid] >= 3  # of a free joint
    turning = np.where(is_hinge, _LARGEST_TURNS[1], _LARGEST_TURNS[0])
    return np.where(is_slide | ~(is_hinge | is_turn), _LARGEST_SPEED, turning)


def _check_range(what: str, values: NDArray[np.float64], lowest: float, highest: float) -> None:
    if ((values < lowest) | (values > highest)).any():
        raise StateError(f"physics: {what} of the state must be from {lowest:g} to {highest:g}")


def _read_awake(model: mujoco.MjModel, read: Fields) -> tuple[dict[str, Integers], dict[str, int]]:
    """Read lists and counts of awake bodies. All follow from `tree_asleep`, except entries beyond the counts."""
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
    awake = (is_awake, body_awake, body_awake[model.body_parentid[1:]], is_awake[model.dof_treeid])
    sizes = zip(_AWAKE_COUNTS, map(np.count_nonzero, awake), strict=True)
    return found, {name: counts.integer(name, int(size), int(size)) for name, size in sizes}
