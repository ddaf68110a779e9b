"""Files that are either complete or absent, JSON of our types, and JSON lines that survive a killed run."""

from __future__ import annotations

import json
import lzma
import math
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

COMPRESSED = ".xz"
"""Suffix of compressed files."""
PICTURES = (".png", ".pdf", ".svg", ".jpg", ".jpeg", ".webp")
"""Suffixes of the picture formats that can be written."""


def json_values(value: Any) -> Any:
    """A value in terms of dict, list, str, int, float, bool and None.

    Dataclasses and named tuples become objects, arrays become lists, paths become text. NaN and infinity become null,
    because JSON has no such numbers.

    Raises:
        TypeError: JSON cannot represent a value of that type.
    """
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: json_values(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return json_values(value._asdict())
    if isinstance(value, Mapping):
        return {str(name): json_values(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [json_values(entry) for entry in value]
    if isinstance(value, np.ndarray | np.generic):
        return json_values(value.tolist())
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if value is None or isinstance(value, str | int):
        return value
    raise TypeError(f"JSON has nothing for {value!r} of type {type(value).__name__}")


def json_text(value: Any, indent: int | None = None) -> str:
    """JSON text of a value, see `json_values`."""
    return json.dumps(json_values(value), indent=indent, allow_nan=False)


def write_json(path: Path, value: Any) -> None:
    """Write a JSON file, see `json_values` and `write_atomically`. Missing directories are made.

    A file whose name ends in ".xz" is compressed.

    Raises:
        OSError: the disk is full or cannot be written.
        TypeError: JSON cannot represent a value.
    """
    content = json_text(value, indent=1).encode()
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, lzma.compress(content) if path.suffix == COMPRESSED else content)


def read_json(path: Path) -> Any:
    """Read a JSON file, compressed if its name ends in ".xz".

    Raises:
        OSError: it cannot be read.
        ValueError: it is damaged or no JSON.
    """
    try:
        content = lzma.decompress(path.read_bytes()) if path.suffix == COMPRESSED else path.read_bytes()
    except lzma.LZMAError as problem:
        raise ValueError(f"it cannot be decompressed: {problem}") from problem
    return json.loads(content)


def changes(there: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Differences between two records in words, such as "seed: 0 there, 1 now".

    Groups of values (mappings) that the first record lacks are ignored, because earlier versions wrote fewer groups.
    """
    found = []
    for name in dict.fromkeys((*there, *now)):
        old, new = there.get(name), now.get(name)
        if isinstance(new, Mapping):
            found += changes(old, new) if isinstance(old, Mapping) else []
        elif old != new:
            found.append(f"{name}: {old!r} there, {new!r} now")
    return found


def check_picture(path: Path | None) -> None:
    """Raise ValueError unless the file has the suffix of a picture. For use before the results to be drawn are
    measured."""
    if path is not None and path.suffix.lower() not in PICTURES:
        raise ValueError(f"{path} is no picture; valid endings: {', '.join(PICTURES)}")


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file that gets its name after all of it is on the disk. Until then an old file of that name stays.

    Paths that are no regular files, such as `/dev/stdout`, a pipe or a link, are written to, not replaced.

    Raises:
        OSError: the disk is full or cannot be written. The error names the file.
    """
    if path.is_symlink() or (path.exists() and not path.is_file()):
        path.write_bytes(content)
        return
    with written_atomically(path) as part, part.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


@contextmanager
def written_atomically(path: Path) -> Iterator[Path]:
    """Yield a temporary path next to `path`, and rename it to `path` when the block succeeds. On errors it is removed.

    Raises:
        OSError: the disk is full or cannot be written. The error names the file `path`.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield part
        os.replace(part, path)
    except OSError as problem:
        raise OSError(problem.errno, f"{problem.strerror or problem}, cannot write", str(path)) from problem
    finally:
        if part.is_dir():
            shutil.rmtree(part)
        part.unlink(missing_ok=True)


class JsonLines:
    """A file of JSON values, one per line. An incomplete last line of a killed run is removed.

    Attributes:
        values: values in the file when it was opened, and those added since.

    Raises:
        OSError: the file cannot be read or written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        whole = text[: text.rfind("\n") + 1]
        if len(whole) < len(text):
            path.write_text(whole, encoding="utf-8")
        self.values: list[Any] = [json.loads(line) for line in whole.splitlines()]

    def append(self, value: Any) -> None:
        """Append a value to the file, and write it to the disk, see `json_values`."""
        text = json_text(value)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(text + "\n")
            file.flush()
            os.fsync(file.fileno())
        self.values.append(json.loads(text))
