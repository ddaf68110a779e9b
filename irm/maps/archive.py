"""Archives of arrays with a description: `.npz` files that are written whole or not at all, and read with distrust.

A file may come from anywhere: no number in it is believed before it is checked against the size of the file.
"""

from __future__ import annotations

import io
import json
import os
import tempfile
import zipfile
import zlib
from collections.abc import Collection
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from irm.errors import MapFileError

__all__ = ["read_archive", "write_archive"]

_LONGEST_TEXT = 1_000_000
"""[bytes] Largest description of a map; a real one has less than a thousand."""

_MOST_EXPANSION = 64
"""How many times larger than the file its arrays may be together, beyond `_ALWAYS_ALLOWED`: those of a map are 4 to 20
times larger, and a small file cannot claim all memory."""

_ALWAYS_ALLOWED = 2**26
"""[bytes] Arrays that need no more are read whatever their expansion is."""


def write_archive(path: Path, about: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
    """Write arrays and a description of them; the new file replaces an old one only when it is complete.

    Raises:
        OSError: the disk is full or cannot be written; the error names the file, and nothing is left behind.
    """
    content, text = io.BytesIO(), np.array(json.dumps(about))
    np.savez_compressed(content, allow_pickle=False, about=text, **arrays)
    if not _is_plausible(sum(array.nbytes for array in arrays.values()), content.tell()):
        content = io.BytesIO()
        np.savez(content, allow_pickle=False, about=text, **arrays)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _write(path, content.getbuffer())
    except OSError as problem:
        reason = f"{problem.strerror or problem}, the map cannot be saved"
        raise OSError(problem.errno, reason, str(path)) from problem


def read_archive(path: Path, names: Collection[str]) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read the description and the named arrays of a file.

    Raises:
        FileNotFoundError: no such file.
        MapFileError: the file is damaged or is no such archive.
    """
    try:
        size = path.stat().st_size
        with zipfile.ZipFile(path) as file:
            claimed = sum(entry.file_size for entry in file.infolist())
            if not _is_plausible(claimed, size):
                raise ValueError(f"{size} bytes that claim to be {claimed}")
            text = _array(file, "about")
            about = json.loads(str(text[()]) if text.shape == () and text.nbytes < _LONGEST_TEXT else "")
            arrays = {name: _array(file, name) for name in names}
    except FileNotFoundError:
        raise
    except (
        OSError,
        EOFError,
        KeyError,
        ValueError,
        TypeError,
        RecursionError,
        zlib.error,
        zipfile.BadZipFile,
    ) as error:
        raise MapFileError(f"{path} is damaged or is no map file ({error}); build it again") from error
    if not isinstance(about, dict):
        raise MapFileError(f"{path} is no map file; build it again")
    return about, arrays


def _is_plausible(claimed: int, size: int) -> bool:
    return claimed <= max(_ALWAYS_ALLOWED, _MOST_EXPANSION * size)


def _write(path: Path, content: memoryview) -> None:
    descriptor, draft = tempfile.mkstemp(dir=path.parent, prefix=path.stem, suffix=".tmp")
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(draft, path)
    except BaseException:
        os.unlink(draft)
        raise


def _array(file: zipfile.ZipFile, name: str) -> NDArray[Any]:
    """An array of the file, if its header says exactly as many bytes as there are: nothing is allocated before."""
    entry = file.getinfo(f"{name}.npy")
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) or entry.flag_bits & 1:
        raise ValueError(f"{name} is encrypted or has an unknown compression")
    content = io.BytesIO(file.read(entry))
    if np.lib.format.read_magic(content) != (1, 0):
        raise ValueError(f"{name} has an unknown version")
    shape, _, kind = np.lib.format.read_array_header_1_0(content)
    left = len(content.getbuffer()) - content.tell()
    if kind.hasobject or min(shape, default=0) < 0 or prod(shape) * kind.itemsize != left:
        raise ValueError(f"{name} has {left} bytes, and its header {shape} of {kind}")
    return np.frombuffer(content.getbuffer(), kind, offset=content.tell()).reshape(shape)
