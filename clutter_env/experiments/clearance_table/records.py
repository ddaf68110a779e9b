"""The file of trials of a clearance table: one JSON object per line, written as each trial ends."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeAlias

from clutter_env.experiments.clearance_table.trials import ASSESSMENT, Assessment, Attempt
from clutter_env.reporting.files import JsonLines

__all__ = ["OtherSettings", "Record", "Records"]

Record: TypeAlias = Assessment | Attempt
Key: TypeAlias = tuple[int, int, str]
_TUPLES = ("clearances", "deviations")


class OtherSettings(ValueError):
    """The directory holds trials made under other settings; the message says which differ."""


class Records:
    """The records in a file by (objects, seed, strategy); of two records of one trial the later one is valid.

    Raises:
        OtherSettings: the file was begun with other settings.
    """

    def __init__(self, path: Path, settings: dict[str, Any]) -> None:
        self._file = JsonLines(path)
        self._known: dict[Key, Record] = {}
        if not self._file.values:
            self._file.append(settings)
            return
        header, *rows = self._file.values
        different = [
            f"{name}: {header.get(name)!r} there, {value!r} now"
            for name, value in settings.items()
            if header.get(name) != value
        ]
        if different:
            raise OtherSettings(f"{path} holds trials of other settings ({'; '.join(different)}); choose another --out")
        for row in rows:
            self._keep(_restored(row))

    def add(self, record: Record) -> None:
        """Add a record, and write it to the disk."""
        self._file.append(record)
        self._keep(record)

    def get(self, objects: int, seed: int, strategy: str) -> Record | None:
        """The record of a trial, if it has been made."""
        return self._known.get((objects, seed, strategy))

    def assessments(self, objects: int) -> dict[int, Assessment]:
        """The assessed scenes with so many objects, by seed in ascending order."""
        return {
            seed: record
            for (count, seed, _), record in sorted(self._known.items())
            if count == objects and isinstance(record, Assessment)
        }

    def attempts(self, objects: int, strategy: str, seeds: list[int]) -> dict[int, Attempt]:
        """The attempts of a strategy on these scenes, by seed, as far as they have been made."""
        found = {seed: self.get(objects, seed, strategy) for seed in seeds}
        return {seed: record for seed, record in found.items() if isinstance(record, Attempt)}

    def _keep(self, record: Record) -> None:
        self._known[record.objects, record.seed, record.strategy] = record


def _restored(row: dict[str, Any]) -> Record:
    values: dict[str, Any] = {name: tuple(value) if name in _TUPLES else value for name, value in row.items()}
    return Assessment(**values) if row["strategy"] == ASSESSMENT else Attempt(**values)
