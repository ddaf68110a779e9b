"""The file of results of a comparison: one line per policy and scene, written as each episode ends."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from clutter_env.learning.comparison.evaluation import Score
from clutter_env.learning.comparison.jobs import EvaluationJob, Result
from clutter_env.learning.comparison.run_names import run_directories
from clutter_env.learning.errors import LearningError
from clutter_env.learning.policies.runs import differences, load_run
from clutter_env.learning.task import versions
from clutter_env.reporting.files import JsonLines
from clutter_env.suites import Floor, suite

__all__ = ["ResultRecords"]


class ResultRecords:
    """The results in a file; those made so far are found again.

    Raises:
        LearningError: the file's results were made with other versions of the packages; the message names them.
    """

    def __init__(self, path: Path) -> None:
        self._file = JsonLines(path)
        self._known: dict[str, Result] = {}
        if not self._file.values:
            self._file.append({"versions": versions()})
        header, *rows = self._file.values
        if different := differences(header["versions"], versions()):
            raise LearningError(
                f"{path} holds results of other versions ({'; '.join(different)}); choose another --out"
            )
        for row in rows:
            self._known[row["key"]] = _restored(row["result"])

    def get(self, job: EvaluationJob) -> Result | None:
        """The result of a job, None if it has not been made."""
        return self._known.get(_key(job))

    def add(self, job: EvaluationJob, result: Result) -> None:
        """Add a result, and write it to the disk."""
        self._file.append({"key": _key(job), "result": result})
        self._known[_key(job)] = result


def _key(job: EvaluationJob) -> str:
    """Identifies a job; a run that was trained further, or a suite that was changed, is played again."""
    scenes = job.scenes
    where = f"{scenes.suite} {suite(scenes.suite).digest} {scenes.split}" if scenes.suite else scenes.env_id
    steps = "".join(f" after {load_run(run)['steps']}" for run in run_directories(job.policy))
    return f"{where} {scenes.obstructed} {job.index}: {job.policy}{steps}, seed {job.seed}, {job.feasibility}"


def _restored(values: dict[str, Any]) -> Result:
    return Score(**values) if "clean" in values else Floor(**values)
