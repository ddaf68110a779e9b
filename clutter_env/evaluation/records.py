"""The file of scores of an evaluation: one line per policy and scene, written as each episode ends."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from clutter_env.errors import LearningError
from clutter_env.evaluation.scenes import SceneSet
from clutter_env.evaluation.score import Score
from clutter_env.policies.runs import load_run, run_directories
from clutter_env.provenance import differences, provenance
from clutter_env.reporting.files import JsonLines
from clutter_env.suites import Floor, suite


class ResultRecords:
    """The scores in a file; those made so far are found again.

    Raises:
        LearningError: the file is damaged, holds something else, or its scores were made with another version; the
            message says what differs.
    """

    def __init__(self, path: Path) -> None:
        self._known: dict[str, Score | Floor] = {}
        try:
            self._file = JsonLines(path)
            header, *rows = self._file.values or [{"provenance": provenance()}]
            made_with = header.get("provenance")
            for row in rows:
                values = row["result"]
                self._known[row["key"]] = Score(**values) if "clean" in values else Floor(**values)
        except (ValueError, KeyError, TypeError, AttributeError) as problem:
            raise LearningError(f"{path} holds no scores of this package, or it is damaged: {problem!r}") from problem
        if changed := differences(made_with, provenance()):
            raise LearningError(f"{path} cannot be continued. {' '.join(changed)} Choose another --out.")
        if not self._file.values:
            self._file.append(header)

    def get(self, key: str) -> Score | Floor | None:
        """The score or minimum number of clearances of a key, None if it has not been made."""
        return self._known.get(key)

    def add(self, key: str, result: Score | Floor) -> None:
        """Add a result, and write it to the disk.

        Raises:
            OSError: the disk is full or cannot be written; what was written before stays.
        """
        self._file.append({"key": key, "result": result})
        self._known[key] = result

    @staticmethod
    def key(
        scenes: SceneSet, index: int, policy: str, seed: int, feasibility: str, made_with: Mapping[str, Any]
    ) -> str:
        """Identify a result; a run that was trained further, or a changed suite or environment, is played again."""
        where = f"{scenes.suite} {suite(scenes.suite).digest} {scenes.split}" if scenes.suite else scenes.env_id
        if not scenes.suite:
            where += f" {scenes.layout} {scenes.obstructed} from {scenes.first_seed}"
        steps = "".join(f" after {load_run(run)['steps']}" for run in run_directories(policy))
        environment = hashlib.sha256(json.dumps(made_with["environment"], sort_keys=True).encode()).hexdigest()[:16]
        return f"{where} {index}: {policy}{steps}, seed {seed}, {feasibility}, environment {environment}"
