"""Files of JSON values, one per line, each on the disk as soon as it is added: what a killed run leaves can be used."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from clutter_env.reporting.json_file import json_text

__all__ = ["JsonLines"]


class JsonLines:
    """A file of JSON values, one per line; a last line that a killed run left incomplete is removed.

    Attributes:
        values: what the file held when it was opened, and what has been added since.

    Raises:
        OSError: the file cannot be read or written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        self.values: list[Any] = [json.loads(line) for line in _whole_lines(path)]

    def append(self, value: Any) -> None:
        """Add a value at the end of the file, and write it to the disk; see `json_file.json_values`."""
        text = json_text(value)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(text + "\n")
            file.flush()
            os.fsync(file.fileno())
        self.values.append(json.loads(text))


def _whole_lines(path: Path) -> list[str]:
    """The complete lines of the file; an incomplete last one is removed from it."""
    if not path.exists():
        return []
    text = path.read_text(encoding="utf-8")
    whole = text[: text.rfind("\n") + 1]
    if len(whole) < len(text):
        path.write_text(whole, encoding="utf-8")
    return whole.splitlines()
