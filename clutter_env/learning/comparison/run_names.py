"""Names of training runs in a table: runs that differ in their seed alone are one policy."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from clutter_env.learning.policies.runs import DECISION_LEARNERS, MOVER_LEARNERS, RUN_FILE, load_run
from clutter_env.learning.task import Task
from clutter_env.reporting.json_file import json_text

__all__ = ["run_directories", "run_names", "run_task"]


def run_directories(name: str) -> tuple[Path, ...]:
    """The training runs that a policy is made of, by its name: a directory, or two with a "+" between; else none."""
    found = [Path(part) for part in name.split("+")]
    return tuple(found) if len(found) <= 2 and all((path / RUN_FILE).exists() for path in found) else ()


def run_task(directory: Path) -> Task:
    """The task that a run was trained on.

    Raises:
        LearningError: the directory holds no training run.
    """
    task = load_run(directory)["task"]
    return Task(task["env_id"], task["keywords"])


def run_names(directories: Sequence[Path]) -> dict[str, str]:
    """The name of the policy of each run, by its directory: the algorithm and what it acts by.

    Runs of one algorithm that differ in more than their seed also have the name of their directory.
    """
    groups: dict[str, list[Path]] = {}
    for directory in directories:
        record = {name: value for name, value in load_run(directory).items() if name != "seed"}
        groups.setdefault(json_text(record), []).append(directory)
    plain = [_name(group[0]) for group in groups.values()]
    names: dict[str, str] = {}
    for name, group in zip(plain, groups.values(), strict=True):
        chosen = name if plain.count(name) == 1 else f"{name}, {_folder(group[0])}"
        names |= {str(directory): chosen for directory in group}
    return names


def _name(directory: Path) -> str:
    algorithm = load_run(directory)["algorithm"]
    if algorithm in DECISION_LEARNERS:
        return f"{algorithm} (planner's motions)"
    if algorithm in MOVER_LEARNERS:
        return f"{algorithm} (planner's decisions)"
    return f"{algorithm} ({'skills' if run_task(directory).family == 'skill' else 'actions'})"


def _folder(directory: Path) -> str:
    """The name of a run's directory; of one of several seeds that of the directory of all."""
    return directory.parent.name if directory.name.startswith("seed-") else directory.name
