"""The file of trials behind a clearance table: append-only, one JSON object a line, so that a killed run goes on."""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeAlias

from clutter_env.experiments.clearance_table.trials import ASSESSMENT, Assessment, Attempt

__all__ = ["OtherSettings", "Record", "Records"]

Record: TypeAlias = Assessment | Attempt
Key: TypeAlias = tuple[int, int, str]
_TUPLES = ("clearances", "deviations")


class OtherSettings(ValueError):
    """The directory holds trials made under other settings; the message says which differ."""


class Records:
    """What is known so far, by (objects, seed, strategy); of two records of one trial the later counts.

    Raises:
        OtherSettings: the file was begun with other settings.
    """

    def __init__(self, path: Path, settings: dict[str, Any]) -> None:
        self._path = path
        self._known: dict[Key, Record] = {}
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or not _whole_lines(path):
            self._append(settings)
            return
        header, *rows = map(json.loads, _whole_lines(path))
        different = [
            f"{name}: {header.get(name)!r} there, {value!r} now"
            for name, value in settings.items()
            if header.get(name) != value
        ]
        if different:
            raise OtherSettings(
                f"{path} holds trials of other settings ({'; '.join(different)}); choose another --output"
            )
        for row in rows:
            self._keep(_restored(row))

    def add(self, record: Record) -> None:
        """Keep it and write it; it survives whatever happens next."""
        self._append(asdict(record))
        self._keep(record)

    def get(self, objects: int, seed: int, strategy: str) -> Record | None:
        """The record of a trial, if it has been made."""
        return self._known.get((objects, seed, strategy))

    def assessments(self, objects: int) -> dict[int, Assessment]:
        """By seed, ascending: the scenes with so many objects that have been assessed."""
        return {
            seed: record
            for (count, seed, _), record in sorted(self._known.items())
            if count == objects and isinstance(record, Assessment)
        }

    def attempts(self, objects: int, strategy: str, seeds: list[int]) -> dict[int, Attempt]:
        """By seed: what a strategy made of these scenes, as far as it has tried."""
        found = {seed: self.get(objects, seed, strategy) for seed in seeds}
        return {seed: record for seed, record in found.items() if isinstance(record, Attempt)}

    def _keep(self, record: Record) -> None:
        self._known[record.objects, record.seed, record.strategy] = record

    def _append(self, content: dict[str, Any]) -> None:
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(content) + "\n")
            file.flush()
            os.fsync(file.fileno())


def _whole_lines(path: Path) -> list[str]:
    """The file's lines; one that a killed run left unfinished is cut off."""
    text = path.read_text(encoding="utf-8")
    whole = text[: text.rfind("\n") + 1]
    if len(whole) < len(text):
        path.write_text(whole, encoding="utf-8")
    return whole.splitlines()


def _restored(row: dict[str, Any]) -> Record:
    values: dict[str, Any] = {name: tuple(value) if name in _TUPLES else value for name, value in row.items()}
    return Assessment(**values) if row["strategy"] == ASSESSMENT else Attempt(**values)
