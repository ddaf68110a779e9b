"""Plans in files: one `.npz` archive with a JSON header and arrays. Nothing is pickled, so a file cannot run code."""

from __future__ import annotations

import json
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

FORMAT = "clutter-env plan"
VERSION = 9
"""Version of the format. It increases whenever the meaning of a stored value changes."""
_OLDER = (2, 3, 4, 5, 6, 7, 8)
"""Older versions that can be read. Fields that they lack take their defaults."""
_GONE = {"Strategy": ("second_moves", "non_monotone", "sets", "slack", "variations")}
"""Fields of older versions that no longer exist, by class."""


class PlanFileError(ValueError):
    """A file without a readable plan, or a plan that cannot be written. The message says why."""


class Stored:
    """Dataclass that can be saved to a file. It may hold dataclasses, named tuples, enums, arrays, tuples, numbers."""

    def save(self, path: str | Path) -> None:
        """Write the object and its scenes to one `.npz` file without pickled objects. An existing file is replaced.

        Raises:
            PlanFileError: a field holds a type that the file format does not know.
            OSError: the file cannot be written.
        """
        content, arrays = _encode(self)
        header = {"format": FORMAT, "version": VERSION, "kind": type(self).__name__, **content}
        numbered = {f"array_{index}": array for index, array in enumerate(arrays)}
        with Path(path).open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, header=np.array(json.dumps(header)), **numbered)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a file of `save`. The result equals the saved object, arrays bit for bit.

        Raises:
            PlanFileError: the file is missing, damaged, of an unknown version, or holds no result of this class.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                header = json.loads(str(file["header"]))
                if header["format"] != FORMAT:
                    raise PlanFileError(f"{path} holds no plan but {header['format']!r}")
                if header["version"] not in (VERSION, *_OLDER):
                    raise PlanFileError(
                        f"{path} has version {header['version']!r}; this package reads version {VERSION}"
                    )
                if header["kind"] != cls.__name__:
                    raise PlanFileError(f"{path} holds no {cls.__name__} but {header['kind']!r}")
                plan = _decode(header, _classes_of(cls), lambda index: file[f"array_{index:d}"])
        except PlanFileError:
            raise
        except FileNotFoundError:
            raise PlanFileError(f"there is no file {path}") from None
        except Exception as problem:
            # A damaged archive makes zipfile, numpy, json and the classes of a plan raise nearly anything, from
            # NotImplementedError (a compression method that does not exist) to MemoryError (an enormous shape).
            raise PlanFileError(f"{path} is damaged or holds no plan: {problem!r:.200}") from problem
        if not isinstance(plan, cls):
            raise PlanFileError(f"{path} is damaged: it holds {plan!r:.50}")
        return plan


def is_same(one: Any, other: Any) -> bool:
    """Whether two values of a plan are equal, arrays element by element."""
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


def _encode(plan: Stored) -> tuple[dict[str, Any], list[NDArray[Any]]]:
    """Encode a plan as JSON values and arrays. Repeated objects and arrays are stored once, by number."""
    classes = _classes_of(type(plan))
    objects: list[dict[str, Any]] = []
    arrays: list[NDArray[Any]] = []
    known: dict[int, dict[str, int]] = {}

    def encode(value: Any) -> Any:
        kind = type(value)
        if id(value) in known:
            return known[id(value)]
        if isinstance(value, np.ndarray) and not value.dtype.hasobject:
            arrays.append(value)
            return known.setdefault(id(value), {"array": len(arrays) - 1})
        if classes.get(kind.__name__) is kind:
            content = {name: encode(getattr(value, name)) for name in _field_types(classes[kind.__name__])}
            objects.append({"class": kind.__name__, "fields": content})
            return known.setdefault(id(value), {"object": len(objects) - 1})
        if value is None or isinstance(value, bool | str | int | float):
            return value
        if isinstance(value, np.integer | np.floating):
            return value.item()
        if isinstance(value, tuple):
            return [encode(entry) for entry in value]
        raise PlanFileError(f"a plan that holds a {kind.__qualname__} cannot be written")

    root = encode(plan)
    return {"objects": objects, "plan": root}, arrays


def _decode(header: Mapping[str, Any], classes: Mapping[str, type], read_array: Callable[[int], NDArray[Any]]) -> Any:
    """Decode the plan of a header. Each object is built after the objects it refers to."""
    objects: list[Any] = []
    arrays: dict[int, NDArray[Any]] = {}

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
        gone = () if header["version"] == VERSION else _GONE.get(stored["class"], ())
        content = {name: decode(value) for name, value in stored["fields"].items() if name not in gone}
        for name, hint in _field_types(kind).items():
            # A dataclass keeps defaults as attributes of the class.
            is_missing = name not in content and header["version"] != VERSION and is_dataclass(kind)
            if not (is_missing and hasattr(kind, name)) and not _fits(content.get(name), hint):
                raise TypeError(f"{name} of a {kind.__name__} is no {hint}")
        objects.append(kind(**content))
    return decode(header["plan"])


def _fits(value: Any, hint: Any) -> bool:
    """Whether a value matches an annotation such as `tuple[Body, ...] | None`."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return any(_fits(value, choice) for choice in arguments)
    if origin is typing.Literal:
        return value in arguments
    if origin is tuple and isinstance(value, tuple):
        kinds = arguments[:1] * len(value) if arguments[1:] == (...,) else arguments
        return len(kinds) == len(value) and all(map(_fits, value, kinds))
    if hint in (int, float):
        return isinstance(value, int | hint) and not isinstance(value, bool)
    return hint is Any or isinstance(value, origin or hint)


@cache
def _field_types(kind: type) -> dict[str, Any]:
    """Annotations of the stored fields of a class. An enum stores its value."""
    if issubclass(kind, Enum):
        return {"value": Any}
    hints = typing.get_type_hints(kind)
    names = [entry.name for entry in fields(kind)] if is_dataclass(kind) else kind._fields  # type: ignore[attr-defined]  # tuple
    return {name: hints[name] for name in names}


def _classes_of(kind: type) -> dict[str, type]:
    """A class and all dataclasses, named tuples and enums that its fields can hold, by name."""
    found: dict[str, type] = {}
    waiting: list[Any] = [kind]
    while waiting:
        hint = waiting.pop()
        waiting += typing.get_args(hint)
        is_record = (
            is_dataclass(hint) or hasattr(hint, "_fields") or (isinstance(hint, type) and issubclass(hint, Enum))
        )
        if isinstance(hint, type) and is_record and hint.__name__ not in found:
            found[hint.__name__] = hint
            waiting += _field_types(hint).values()
    return found
