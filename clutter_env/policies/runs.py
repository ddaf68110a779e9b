"""The record of a training run, read without torch."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import gymnasium as gym

from clutter_env.errors import LearningError
from clutter_env.task import Task

RUN_FILE = "run.json"
HISTORY_FILE = "history.json"
"""Success on held-out scenes as a run went on, in its directory."""


def is_run(name: str | Path) -> bool:
    """Whether the name of a policy is the directory of a training run."""
    return (Path(name) / RUN_FILE).exists()


def run_task(directory: Path) -> Task:
    """Task on which a run was trained. Raise `LearningError` if the directory holds no training run."""
    task = load_run(directory)["task"]
    return Task(task["env_id"], task["keywords"])


def load_run(directory: Path) -> dict[str, Any]:
    """The record of a training run: algorithm, task, seed, steps, settings.

    Raises:
        LearningError: the directory holds no training run, or its record is damaged.
    """
    path = directory / RUN_FILE
    if not path.exists():
        raise LearningError(f"{directory} holds no training run ({RUN_FILE} is missing)")
    try:
        record = dict(json.loads(path.read_text()))
        int(Task(record["task"]["env_id"], dict(record["task"]["keywords"])).num_objects + record["steps"])
        str(record["algorithm"]), dict(record.get("provenance") or {})
    except (OSError, ValueError, KeyError, TypeError, OverflowError, gym.error.Error) as problem:
        raise LearningError(f"{path} is no record of a training run, or it is damaged: {problem!r}") from problem
    return record
