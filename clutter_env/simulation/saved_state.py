"""Saved states: everything that the next step depends on, as bytes that another process can restore.

The bytes carry a checksum against damage, which anyone can compute. Therefore everything that is read from them is
checked before anything changes: names, types, shapes, ranges, and what has to agree (see `physics_state` for the
physics).
"""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Collection, Mapping
from copy import deepcopy
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clutter_env.errors import StateError
from clutter_env.scene.table_scene import TableScene

_MAGIC = b"clutter-env state 1\n"
_MOST_BYTES = 2**24
"""A state of 60 objects has about 10⁵ bytes of JSON; more than this is refused before it fills the memory."""
_PARTS = ("kind", "scene", "physics", "memory")

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
    """The state in these bytes: its kind and its scene are checked, its physics and its memory are not yet.

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
    scene = _read_scene(content["scene"], kind["num_objects"])
    return SavedState(kind, scene, content["physics"], content["memory"])


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
        return json.loads(text)
    except (zlib.error, ValueError, RecursionError) as problem:
        raise StateError(f"the state cannot be decoded: {problem}") from None


def _read_scene(value: object, most_objects: int) -> TableScene:
    """The scene in a state of an environment with at most so many objects.

    States that were saved before cylinders could lie, or objects stand on shelves, lack these entries.
    """
    missing = [name for name in ("is_lying", "levels") if isinstance(value, dict) and name not in value]
    read = Fields(value, "scene", [entry.name for entry in fields(TableScene) if entry.name not in missing])
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


LARGEST = 1e10
"""Largest magnitude of a number in a state: MuJoCo resets a simulation with a larger one (mjMAXVAL)."""
_UNIT_TOLERANCE = 1e-6
"""Tolerance of the norm of a saved quaternion; MuJoCo normalises them to 1e-15 in every step."""


class Fields:
    """A dictionary of a decoded state with exactly the given names.

    Args:
        value: what was decoded from JSON.
        place: where it is in the state, for messages.
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

    def number(self, name: str, lowest: float = -LARGEST, highest: float = LARGEST) -> float:
        """A finite number from `lowest` to `highest`, both included."""
        return float(self._entries(name, (), "a number", {int, float}, lowest, highest)[0])

    def flag(self, name: str) -> bool:
        """True or false."""
        return bool(self._entries(name, (), "true or false", {bool}, False, True)[0])

    def numbers(
        self, name: str, shape: tuple[int, ...], lowest: float = -LARGEST, highest: float = LARGEST
    ) -> NDArray[np.float64]:
        """An array (shape) of finite numbers from `lowest` to `highest`, both included."""
        entries = self._entries(name, shape, f"finite numbers of shape {shape}", {int, float}, lowest, highest)
        return np.array(entries, np.float64).reshape(shape)

    def integers(self, name: str, size: int, lowest: int, highest: int) -> NDArray[np.int64]:
        """An array (size,) of integers from `lowest` to `highest`, both included."""
        return np.array(self._entries(name, (size,), f"{size} integers", {int}, lowest, highest), np.int64)

    def flags(self, name: str, size: int) -> NDArray[np.bool_]:
        """An array (size,) of true and false."""
        return np.array(self._entries(name, (size,), f"{size} times true or false", {bool}, False, True), np.bool_)

    def _entries(
        self, name: str, shape: tuple[int, ...], wanted: str, kinds: set[type], lowest: float, highest: float
    ) -> list[Any]:
        """The entries of nested lists of this shape, in order, if all are of these types and within the range."""
        entries: list[Any] = [self._value[name]]
        for size in shape:
            if not all(isinstance(entry, list) and len(entry) == size for entry in entries):
                entries = [None]  # of no valid type
                break
            entries = [inner for entry in entries for inner in entry]
        # The comparison is false for NaN too.
        if not set(map(type, entries)) <= kinds or not all(lowest <= entry <= highest for entry in entries):
            shown = repr(self._value[name])[:80]
            limits = "" if kinds == {bool} else f" from {lowest:g} to {highest:g}"
            raise StateError(f"{self._place}: {name} of the state must be {wanted}{limits}, not {shown}")
        return entries


def check_quaternions(place: str, quaternions: NDArray[np.float64]) -> None:
    """Raise StateError unless quaternions (..., 4) have the length 1; `place` says where they are in the state."""
    if (np.abs(np.linalg.norm(quaternions, axis=-1) - 1) > _UNIT_TOLERANCE).any():
        raise StateError(f"{place}: a quaternion of the state has not the length 1")
