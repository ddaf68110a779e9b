"""What a training run writes about itself; read without torch."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from clutter_env.learning.errors import LearningError

__all__ = ["RUN_FILE", "load_run"]

RUN_FILE = "run.json"


def load_run(directory: Path) -> dict[str, Any]:
    """What was trained there: algorithm, task, seed, steps.

    Raises:
        LearningError: the directory holds no training run.
    """
    path = directory / RUN_FILE
    if not path.exists():
        raise LearningError(f"{directory} holds no training run ({RUN_FILE} is missing)")
    return dict(json.loads(path.read_text()))
