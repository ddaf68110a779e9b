"""Decisions in files: one `.npz` for each chunk of scenes, and one description of all columns.

dataset.json               what was collected: task, grasps, versions, and the columns with their meaning
chunks/scenes_0900000.npz  the decisions of consecutive seeds, the first of them in the name
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clutter_env.envs.observation import OBSERVATION_LAYOUT
from clutter_env.learning.demonstrations.columns import Columns
from clutter_env.learning.errors import DatasetError

__all__ = ["DECISION_COLUMNS", "KINDS", "Decisions", "chunk_path", "read_chunk", "read_decisions"]

KINDS = ("pick", "place")
"""What the numbers of the column `kind` stand for."""
_OBJECTS = OBSERVATION_LAYOUT["objects"].columns
_BASE = ("x", "y", "yaw"), ("m", "m", "rad")

DECISION_COLUMNS: Mapping[str, tuple[type, Columns]] = MappingProxyType(
    {
        "seed": (np.int64, Columns("of the scene")),
        "number": (np.int64, Columns("of the decision in its plan, from 0")),
        "objects": (
            np.float32,
            Columns(
                "(objects, fields) rows as the observation has them, relative to the base",
                tuple(column.name for column in _OBJECTS),
                tuple(column.unit for column in _OBJECTS),
            ),
        ),
        "base": (np.float64, Columns("base pose in the world before the decision", *_BASE)),
        "target": (np.int64, Columns("index of the target")),
        "held": (np.int64, Columns("index of the held object, -1 for none")),
        "kind": (np.int64, Columns("0 pick, 1 place")),
        "subject": (np.int64, Columns("index of the object that is picked or placed")),
        "family": (np.int64, Columns("of a pick: index into `pitches`; -1 of a place")),
        "direction": (np.int64, Columns("class of the gripper's yaw in the world, 15 degrees each: 0 to 23")),
        "cell": (np.int64, Columns("of a place: index of the nearest of `cells`; -1 of a pick")),
        "contact_base": (np.float64, Columns("base pose at the contact, in the world", *_BASE)),
        "contact_tcp": (np.float64, Columns("(4, 4) TCP pose at the contact, in the world [m]")),
        "is_straight": (np.bool_, Columns("whether the contact is canonical; else the planner fell back")),
        "on_cell": (np.bool_, Columns("whether the object is put exactly on the cell")),
        "clearances_left": (np.int64, Columns("objects that the plan still puts down, the held one included")),
        "is_free": (
            np.bool_,
            Columns(
                "(objects, families, directions) of a pick: whether nothing is hit at the canonical contact nor on a "
                "straight line to it and from it"
            ),
        ),
        "is_optimal": (
            np.bool_,
            Columns(
                "(objects, families, directions) of a pick: free, and leaves as few clearances as the plan; the plan's "
                "own choice always"
            ),
        ),
        "cell_is_free": (
            np.bool_,
            Columns(
                "(cells,) of a place: whether the held object can be put there canonically and keeps clear of what the "
                "plan still does"
            ),
        ),
        "cell_direction": (np.int64, Columns("(cells,) class of the least turned yaw of such a place, -1 for none")),
    }
)
"""Type, meaning, names and units of every column; one row is one decision."""
_CONSTANTS = ("cells", "pitches")


@dataclass(frozen=True, eq=False)
class Decisions:
    """Decisions as columns, one row each; `decisions["objects"]` is one of `DECISION_COLUMNS`.

    Attributes:
        columns: by name.
        cells: (c, 3) [m] of the cells in the world.
        pitches: (f,) [rad] of the families of grasps.
    """

    columns: Mapping[str, NDArray[Any]]
    cells: NDArray[np.float64]
    pitches: NDArray[np.float64]

    @classmethod
    def of(
        cls, rows: Sequence[Mapping[str, Any]], cells: NDArray[np.float64], pitches: NDArray[np.float64]
    ) -> Decisions:
        """Decisions of rows, each with all the columns."""
        columns: dict[str, NDArray[Any]] = {}
        for name, (kind, _) in DECISION_COLUMNS.items():
            columns[name] = np.array([row[name] for row in rows], dtype=kind)
        return cls(columns, cells, pitches)

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.columns[name]

    def __len__(self) -> int:
        return len(self.columns["seed"])

    def to_bytes(self) -> bytes:
        """The content of a chunk's file."""
        buffer = io.BytesIO()
        np.savez_compressed(buffer, cells=self.cells, pitches=self.pitches, **dict(self.columns))  # type: ignore[arg-type]  # its stub takes the names for keywords
        return buffer.getvalue()


def read_decisions(directory: Path) -> Decisions:
    """All decisions in a directory that `clutter-env decisions` wrote, in the order of their seeds.

    Raises:
        DatasetError: the directory holds no decisions, or a damaged file.
    """
    parts = [read_chunk(path) for path in sorted((directory / "chunks").glob("scenes_*.npz"))]
    parts = [part for part in parts if len(part)]
    if not parts:
        raise DatasetError(f"{directory} holds no decisions; run `clutter-env decisions --out {directory}`")
    columns = {name: np.concatenate([part[name] for part in parts]) for name in DECISION_COLUMNS}
    return Decisions(columns, parts[0].cells, parts[0].pitches)


def chunk_path(directory: Path, first_seed: int) -> Path:
    """The file of the chunk of scenes from a seed on."""
    return directory / "chunks" / f"scenes_{first_seed:07d}.npz"


def read_chunk(path: Path) -> Decisions:
    """The decisions in one file.

    Raises:
        DatasetError: it is damaged, or holds no decisions.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            columns = {name: file[name] for name in DECISION_COLUMNS}
            cells, pitches = (file[name] for name in _CONSTANTS)
    except (OSError, KeyError, ValueError, EOFError) as problem:
        raise DatasetError(f"{path} holds no decisions of this package, or it is damaged: {problem}") from problem
    return Decisions(columns, cells, pitches)
