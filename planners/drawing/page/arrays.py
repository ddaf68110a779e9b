"""Arrays in a page: one compressed block of bytes, and JSON values that say where each array lies in it."""

from __future__ import annotations

import base64
import json
import zlib
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["ArrayBlock", "changes"]

_ALIGNMENT = 4
"""[bytes] to whose multiples the browser wants arrays aligned."""


class ArrayBlock:
    """Collects arrays; the page's `decode` in `data.js` reads them."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def add(self, values: ArrayLike, dtype: str = "float32") -> dict[str, Any]:
        """Where the values will lie in the block: "float32", "int16", "int32" or "uint8", little-endian."""
        array = np.ascontiguousarray(values, dtype=np.dtype(dtype).newbyteorder("<"))
        self._bytes += bytes(-len(self._bytes) % _ALIGNMENT)
        place = {"at": len(self._bytes), "size": int(array.size), "type": dtype}
        self._bytes += array.tobytes()
        return place

    def text(self, content: Any) -> str:
        """JSON text of the content and all arrays added; no "<" that could end the page's script element."""
        packed = base64.b64encode(zlib.compress(bytes(self._bytes), 9)).decode()
        return json.dumps({"content": content, "arrays": packed}, separators=(",", ":")).replace("<", "\\u003c")


def changes(values: NDArray[np.int16]) -> NDArray[np.int16]:
    """Each column (n, k) as its first value and the differences that follow, (k, n): of what rests, mostly zeros.

    Differences wrap around like the sums that undo them.
    """
    rows = values.T
    return np.ascontiguousarray(np.diff(rows, axis=1, prepend=np.zeros((len(rows), 1), np.int16)))
