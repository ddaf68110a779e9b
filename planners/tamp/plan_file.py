"""Plans in files: one `.npz` archive with a JSON header and arrays. Nothing is pickled: a file cannot run code."""

from __future__ import annotations

import json
import types
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")

FORMAT = "clutter-env plan"
VERSION = 3
"""Increased whenever the meaning of what is stored changes."""
_RENAMED = {2: {"second_moves": "non_monotone"}}
"""Older versions that are read, with the fields that have other names today."""


class PlanFileError(ValueError):
    """A file that holds no plan of this version, or a plan that cannot be written; the message says why."""


def write_plan(path: str | Path, plan: Any) -> None:
    """Write a plan.

    Args:
        path: the file, conventionally "….npz"; it is replaced if it exists.
        plan: a dataclass whose fields hold dataclasses, named tuples, enums, arrays, tuples, strings and numbers.

    Raises:
        PlanFileError: a field holds something else.
        OSError: the file cannot be written.
    """
    classes = _classes_of(type(plan))
    encoder = _Encoder(classes)
    root = encoder.encode(plan)
    kind = type(plan).__name__
    header = {"format": FORMAT, "version": VERSION, "kind": kind, "objects": encoder.objects, "plan": root}
    arrays = {f"array_{index}": array for index, array in enumerate(encoder.arrays)}
    with Path(path).open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, header=np.array(json.dumps(header)), **arrays)


def read_plan(path: str | Path, kind: type[T]) -> T:
    """Read a plan; its arrays are bit for bit those that were written.

    Args:
        path: the file.
        kind: the class of the plan.

    Raises:
        FileNotFoundError: no such file.
        PlanFileError: the file is damaged, holds no plan, a plan of another version, or one of another class.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            header = json.loads(str(file["header"]))
            if header["format"] != FORMAT:
                raise PlanFileError(f"{path} holds no plan but {header['format']!r}")
            if header["version"] not in (VERSION, *_RENAMED):
                raise PlanFileError(f"{path} has version {header['version']!r}; this package reads version {VERSION}")
            if header["kind"] != kind.__name__:
                raise PlanFileError(f"{path} holds no {kind.__name__} but {header['kind']!r}")
            plan: T = _decode(header, _classes_of(kind), lambda index: file[f"array_{index:d}"])
            _check(plan, kind)
    except (FileNotFoundError, PlanFileError):
        raise
    except Exception as problem:
        # A damaged archive makes zipfile, numpy, json and the classes of a plan raise nearly anything, from
        # NotImplementedError (a compression method that does not exist) to MemoryError (an enormous shape).
        raise PlanFileError(f"{path} is damaged or holds no plan: {problem!r:.200}") from problem
    return plan


def is_same(one: Any, other: Any) -> bool:
    """Whether two values of the kinds that a plan holds are equal, arrays element by element."""
    if one is other:
        return True
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return one.dtype == other.dtype and np.array_equal(one, other)
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(is_same, one, other))
    if is_dataclass(one):
        is_kin = type(one) is type(other)
        return is_kin and all(is_same(getattr(one, entry.name), getattr(other, entry.name)) for entry in fields(one))
    return bool(one == other)


class _Encoder:
    """Turns a plan into JSON values; an object or array that occurs many times is stored once."""

    def __init__(self, classes: Mapping[str, type]) -> None:
        self.objects: list[dict[str, Any]] = []
        self.arrays: list[NDArray[Any]] = []
        self._classes = classes
        self._known: dict[int, dict[str, int]] = {}

    def encode(self, value: Any) -> Any:
        """The JSON value that stands for `value`; objects and arrays are replaced by their numbers."""
        if isinstance(value, Enum):
            return self._object(value, lambda: {"value": value.value})
        if value is None or isinstance(value, bool | str):
            return value
        if isinstance(value, int | np.integer):
            return int(value)
        if isinstance(value, float | np.floating):
            return float(value)
        if isinstance(value, np.ndarray) and not value.dtype.hasobject:
            return self._array(value)
        if is_dataclass(value):
            return self._object(value, lambda: {e.name: self.encode(getattr(value, e.name)) for e in fields(value)})
        if isinstance(value, tuple) and hasattr(value, "_fields"):
            return self._object(value, lambda: {name: self.encode(getattr(value, name)) for name in value._fields})
        if isinstance(value, tuple):
            return [self.encode(entry) for entry in value]
        raise PlanFileError(f"a plan that holds a {type(value).__name__} cannot be written")

    def _array(self, array: NDArray[Any]) -> dict[str, int]:
        if id(array) not in self._known:
            self._known[id(array)] = {"array": len(self.arrays)}
            self.arrays.append(array)
        return self._known[id(array)]

    def _object(self, value: Any, content: Callable[[], dict[str, Any]]) -> dict[str, int]:
        name = type(value).__name__
        if self._classes.get(name) is not type(value):
            raise PlanFileError(f"a plan that holds a {type(value).__qualname__} cannot be written")
        if id(value) not in self._known:
            stored = {"class": name, "fields": content()}
            self._known[id(value)] = {"object": len(self.objects)}
            self.objects.append(stored)
        return self._known[id(value)]


def _decode(header: Mapping[str, Any], classes: Mapping[str, type], read_array: Callable[[int], NDArray[Any]]) -> Any:
    """The plan of a header; each object is built after those it refers to."""
    objects: list[Any] = []
    arrays: dict[int, NDArray[Any]] = {}
    renamed = _RENAMED.get(header["version"], {})

    def decode(value: Any) -> Any:
        if isinstance(value, Sequence) and not isinstance(value, str):
            return tuple(decode(entry) for entry in value)
        if not isinstance(value, Mapping):
            return value
        if "object" in value:
            return objects[value["object"]]
        index = value["array"]
        if index not in arrays:
            arrays[index] = read_array(index)
        return arrays[index]

    for stored in header["objects"]:
        if stored["class"] not in classes:
            raise ValueError(f"unknown class {stored['class']!r}; known: {', '.join(sorted(classes))}")
        kind = classes[stored["class"]]
        content = {renamed.get(name, name): decode(value) for name, value in stored["fields"].items()}
        for name, hint in _field_types(kind).items():
            _check(content.get(name), hint)
        objects.append(kind(**content))
    return decode(header["plan"])


def _check(value: Any, hint: Any) -> None:
    """Raise TypeError unless a value is of the kind that an annotation such as `tuple[Body, ...] | None` names."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        is_valid = any(_is_of(value, choice) for choice in arguments)
    elif origin is typing.Literal:
        is_valid = value in arguments
    elif origin is tuple and isinstance(value, tuple):
        kinds = arguments[:1] * len(value) if arguments[1:] == (...,) else arguments
        is_valid = len(kinds) == len(value) and all(map(_is_of, value, kinds))
    elif hint in (int, float):
        is_valid = isinstance(value, int | hint) and not isinstance(value, bool)
    else:
        is_valid = hint is Any or isinstance(value, origin or hint)
    if not is_valid:
        raise TypeError(f"{value!r:.50} is no {hint}")


def _is_of(value: Any, hint: Any) -> bool:
    try:
        _check(value, hint)
    except TypeError:
        return False
    return True


@cache
def _field_types(kind: type) -> dict[str, Any]:
    """The annotations of the fields that are stored of a class: of an enum its value."""
    if issubclass(kind, Enum):
        return {"value": Any}
    hints = typing.get_type_hints(kind)
    names = [entry.name for entry in fields(kind)] if is_dataclass(kind) else kind._fields  # type: ignore[attr-defined]  # tuple
    return {name: hints[name] for name in names}


def _classes_of(kind: type) -> dict[str, type]:
    """A class, and the dataclasses, named tuples and enums that its fields can hold, by name."""
    found: dict[str, type] = {}
    waiting = [kind]
    while waiting:
        for part in _parts(waiting.pop()):
            is_record = is_dataclass(part) or hasattr(part, "_fields") or issubclass(part, Enum)
            if is_record and part.__name__ not in found:
                found[part.__name__] = part
                if not issubclass(part, Enum):
                    waiting += typing.get_type_hints(part).values()
    return found


def _parts(annotation: Any) -> Iterator[type]:
    """The classes that an annotation such as `tuple[Body, ...] | None` names."""
    if isinstance(annotation, type) and not typing.get_args(annotation):
        yield annotation
    for argument in typing.get_args(annotation):
        yield from _parts(argument)
