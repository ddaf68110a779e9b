"""The Parquet files of a LeRobot dataset: steps, episodes, tasks."""

from __future__ import annotations

import importlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clutter_env.learning.errors import LearningError

__all__ = ["Tables"]

_FILE = "chunk-000/file-000.parquet"
_INDEX = "__index_level_0__"
"""What pandas calls a column that is the index of a table and has no name."""


class Tables:
    """Collects the rows of a dataset and writes the tables below a directory.

    Raises:
        LearningError: pyarrow is not installed.
    """

    def __init__(self, directory: Path) -> None:
        try:
            self._arrow: Any = importlib.import_module("pyarrow")
            self._parquet: Any = importlib.import_module("pyarrow.parquet")
        except ImportError as problem:
            raise LearningError("LeRobot datasets need pyarrow; pip install 'clutter-env[data]'") from problem
        self._directory = directory
        self._steps: Any = None
        self._episodes: list[dict[str, Any]] = []

    def add(self, columns: Mapping[str, NDArray[Any]], line: dict[str, Any], statistics: Mapping[str, Any]) -> None:
        """Append the steps of an episode, as one row group, and its line in the table of episodes."""
        table = self._arrow.table({name: self._column(values) for name, values in columns.items()})
        if self._steps is None:
            path = self._directory / "data" / _FILE
            path.parent.mkdir(parents=True)
            self._steps = self._parquet.ParquetWriter(path, table.schema)
        self._steps.write_table(table)
        flat = {f"stats/{name}/{kind}": value for name, entry in statistics.items() for kind, value in entry.items()}
        self._episodes.append(line | flat)

    def write(self, features: Mapping[str, Any], tasks: Sequence[str]) -> None:
        """Write what is left, when all episodes are in; `features` are those of info.json."""
        assert features, "a complete dataset has at least one episode"
        self._steps.close()
        self._write("meta/episodes/" + _FILE, self._arrow.Table.from_pylist(self._episodes))
        table = self._arrow.table({"task_index": np.arange(len(tasks)), _INDEX: list(tasks)})
        self._write("meta/tasks.parquet", table.replace_schema_metadata({"pandas": json.dumps(_pandas())}))

    def _column(self, values: NDArray[Any]) -> Any:
        """Numbers (n,), or lists of one length (n, k)."""
        if values.ndim == 1:
            return self._arrow.array(values)
        flat = self._arrow.array(np.ascontiguousarray(values).reshape(-1))
        return self._arrow.FixedSizeListArray.from_arrays(flat, values.shape[1])

    def _write(self, name: str, table: Any) -> None:
        path = self._directory / name
        path.parent.mkdir(parents=True, exist_ok=True)
        self._parquet.write_table(table, path)


def _pandas() -> dict[str, Any]:
    """The note by which pandas takes the texts of the tasks as the table's index."""
    task = {"name": None, "field_name": _INDEX, "pandas_type": "unicode", "numpy_type": "object", "metadata": None}
    number = {
        "name": "task_index",
        "field_name": "task_index",
        "pandas_type": "int64",
        "numpy_type": "int64",
        "metadata": None,
    }
    names = {"name": None, "field_name": None, "pandas_type": "unicode", "numpy_type": "object", "metadata": None}
    return {
        "index_columns": [_INDEX],
        "column_indexes": [{**names, "metadata": {"encoding": "UTF-8"}}],
        "columns": [number, task],
        "pandas_version": "2.2.0",
    }
