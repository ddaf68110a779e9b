"""Saved states: everything that the next step depends on, as bytes that another process can restore.

The bytes carry a checksum against damage, which anyone can compute. Therefore everything that is read from them is
checked before anything changes: names, types, shapes, ranges, and what has to agree (see `physics_state` for the
physics).
"""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import asdict, dataclass, fields
from typing import Any, NoReturn

import numpy as np

from clutter_env.errors import StateError
from clutter_env.scene.table_scene import TableScene
from clutter_env.simulation.state_fields import Fields

_MAGIC = b"clutter-env state 1\n"
_MOST_BYTES = 2**24
"""A state of 60 objects has about 10⁵ bytes of JSON; more than this is refused before it fills the memory."""
_PARTS = ("kind", "scene", "physics", "memory")
MEMORY = ("task", "judge", "held", "is_touching", "target", "velocity", "finger", "wanted_tcp", "rng")
"""Entries of the memory: what task, success monitor ("judge", its name in version 0.1), controller and environment
remember besides the physics."""
SEVERAL_ARMS = ("other_held", "other_fingers")
"""Further entries of a robot that acts with several arms."""
IK_FAILURES = "ik_failures"
"""A further entry with "ee" control; states of version 0.1 lack it."""

_LARGEST_HALF_EXTENT = 1.0
"""[m]"""
_MASS_RANGE = (1e-3, 100.0)
"""[kg]"""
_PLACE_RANGE = 10.0
"""[m] of start positions from the table's centre, [rad] of start angles."""


@dataclass(frozen=True)
class SavedState:
    """A saved state, decoded: what kind of environment it belongs to and everything in it."""

    kind: Mapping[str, Any]
    scene: TableScene
    physics: Mapping[str, Any]
    memory: Mapping[str, Any]


def pack(saved: SavedState) -> bytes:
    """The bytes of a state: a magic line, a digest, and compressed JSON (which keeps every bit of a float)."""
    scene = {
        name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in asdict(saved.scene).items()
    }
    content = {"kind": saved.kind, "scene": scene, "physics": saved.physics, "memory": saved.memory}
    body = zlib.compress(json.dumps(content).encode(), level=1)
    return _MAGIC + hashlib.sha256(body).digest() + body


def unpack(state: object, kind: dict[str, Any]) -> SavedState:
    """The state in these bytes: its kind and its scene are checked, its physics and its memory have their entries.

    Args:
        state: bytes from `pack`.
        kind: what the environment that restores the state must have in common with the one that saved it.

    Raises:
        StateError: not bytes, damaged, of an environment or a MuJoCo version of another kind, or not valid.
    """
    content = Fields(_decode(state), "the top level", _PARTS)
    there = Fields(content["kind"], "kind", list(kind))
    for name, value in kind.items():
        if json.dumps(there[name], sort_keys=True) != json.dumps(value, sort_keys=True):
            raise StateError(f"the state was saved with {name}={there[name]!r}; this one has {value!r}")
    memory = content["memory"]
    further = [name for name in (*SEVERAL_ARMS, IK_FAILURES) if isinstance(memory, dict) and name in memory]
    Fields(memory, "memory", (*MEMORY, *further))
    scene = _read_scene(content["scene"], kind["num_objects"])
    return SavedState(kind, scene, content["physics"], memory)


def check_generator(generator: np.random.Generator, state: Any) -> None:
    """Make sure that a random generator of this kind can take this state; `generator` does not change.

    Raises:
        StateError: it cannot.
    """
    scratch = deepcopy(generator.bit_generator)
    try:
        scratch.state = state
    except (TypeError, ValueError, KeyError, AttributeError, OverflowError) as problem:
        raise StateError(f"memory: rng of the state is no state of {type(scratch).__name__}: {problem}") from None
    if json.dumps(scratch.state, sort_keys=True) != json.dumps(state, sort_keys=True):
        raise StateError(f"memory: rng of the state is no state of {type(scratch).__name__}")


def _decode(state: object) -> Any:
    """The JSON values in the bytes of a state."""
    if not isinstance(state, bytes):
        raise StateError(f"a saved state is bytes from save_state(), not {type(state).__name__}")
    head, digest, body = state[: len(_MAGIC)], state[len(_MAGIC) : len(_MAGIC) + 32], state[len(_MAGIC) + 32 :]
    if head != _MAGIC or hashlib.sha256(body).digest() != digest:
        raise StateError("these bytes are no saved state of this version, or they are damaged")
    try:
        stream = zlib.decompressobj()
        text = stream.decompress(body, _MOST_BYTES)
        if not stream.eof or stream.unused_data:
            raise StateError(f"the state is incomplete, or has more than {_MOST_BYTES} bytes")
        return json.loads(text, parse_constant=_refuse_constant)
    except (zlib.error, ValueError, RecursionError) as problem:
        raise StateError(f"the state cannot be decoded: {problem}") from None


def _refuse_constant(name: str) -> NoReturn:
    raise StateError(f"the state holds {name}, which is no number")


def _read_scene(value: object, most_objects: int) -> TableScene:
    """The scene in a state of an environment with at most so many objects.

    States that were saved before cylinders could lie, or objects stand on boards, lack these entries.
    """
    missing = [name for name in ("is_lying", "levels") if isinstance(value, dict) and name not in value]
    read = Fields(value, "scene", [entry.name for entry in fields(TableScene) if entry.name not in missing])
    count = len(read.items("yaws"))
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
        target=read.integer("target", 0, count - 1) if count else read.integer("target", -1, -1),
        is_lying=np.zeros(count, np.bool_) if "is_lying" in missing else read.flags("is_lying", count),
        levels=np.zeros(count) if "levels" in missing else read.numbers("levels", (count,), 0.0, _PLACE_RANGE),
    )
    if (scene.is_lying & scene.is_box).any():
        raise StateError("scene: is_lying of the state must be false for a box")
    is_oval = ~scene.is_box & (scene.half_extents[:, 0] != scene.half_extents[:, 1])
    if is_oval.any():
        raise StateError("scene: half_extents of the state must have equal entries along x and y for a cylinder")
    return scene
