"""Names of training runs in a table: runs that differ in their seed alone are one policy."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from clutter_env.learning.policies.runs import DECISION_LEARNERS, MOVER_LEARNERS, RUN_FILE, load_run
from clutter_env.learning.task import Task
from clutter_env.reporting.files import json_text

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


def run_names(policies: Iterable[str]) -> dict[str, str]:
    """The name in a table of each policy that is made of runs (`run_directories`), by its own name.

    It is the algorithms and what they act by. Policies of the same algorithms that differ in more than their seeds also
    have the names of their directories; other policies are left out.
    """
    groups: dict[str, list[str]] = {}
    runs = {policy: run_directories(policy) for policy in policies}
    for policy, directories in runs.items():
        if directories:
            records = [
                {key: value for key, value in load_run(directory).items() if key != "seed"} for directory in directories
            ]
            groups.setdefault(json_text(records), []).append(policy)
    plain = [_name(runs[group[0]]) for group in groups.values()]
    names: dict[str, str] = {}
    for name, group in zip(plain, groups.values(), strict=True):
        folders = " + ".join(map(_folder, runs[group[0]]))
        chosen = name if plain.count(name) == 1 else f"{name}, {folders}"
        names |= dict.fromkeys(group, chosen)
    return names


def _name(directories: tuple[Path, ...]) -> str:
    algorithms = [str(load_run(directory)["algorithm"]) for directory in directories]
    if len(algorithms) > 1:
        return f"{' + '.join(algorithms)} (all learned)"
    if algorithms[0] in DECISION_LEARNERS:
        return f"{algorithms[0]} (planner's motions)"
    if algorithms[0] in MOVER_LEARNERS:
        return f"{algorithms[0]} (planner's decisions)"
    return f"{algorithms[0]} ({'skills' if run_task(directories[0]).family == 'skill' else 'actions'})"


def _folder(directory: Path) -> str:
    """The name of a run's directory; of one of several seeds that of the directory of all."""
    return directory.parent.name if directory.name.startswith("seed-") else directory.name
