"""A training run: its task and settings, checked and recorded in the run's directory. It needs no torch."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from clutter_env.errors import LearningError
from clutter_env.policies.runs import RUN_FILE, load_run
from clutter_env.provenance import differences
from clutter_env.reporting.files import changes, json_values, write_json
from clutter_env.seeds import training_seeds
from clutter_env.task import Task
from clutter_env.training.settings import ALGORITHMS, Settings


@dataclass(frozen=True)
class Run:
    """A run of an algorithm.

    Attributes:
        task: environment and keyword arguments.
        algorithm: a key of `ALGORITHMS`.
        directory: of the run.
        seed: random seed.
        settings: numbers of steps, copies and evaluations.
    """

    task: Task
    algorithm: str
    directory: Path
    seed: int = 0
    settings: Settings = field(default_factory=Settings)

    def check(self, resume: bool = False) -> None:
        """Check that the run can be started or resumed. Nothing is written.

        Raises:
            UnknownTask: no such environment, or not with these keyword arguments.
            LearningError: training scenes are held out, or the algorithm is unknown or does not learn on this task. Or
                the directory holds a run that is not to be resumed, is another run, or was made with another
                environment (the message names the differences).
        """
        present = self.task.provenance()
        if self.task.family not in ALGORITHMS.get(self.algorithm, ()):
            fitting = [name.replace("_", "-") for name, families in ALGORITHMS.items() if self.task.family in families]
            raise LearningError(f"{self.algorithm} does not learn on {self.task.env_id}; there do {', '.join(fitting)}")
        training_seeds(self.seed, self.settings.num_envs)  # of the first scenes only
        if not (self.directory / RUN_FILE).exists():
            return
        if not resume:
            raise LearningError(
                f"{self.directory} holds a training run; resume it (--resume), or choose another directory"
            )
        there, now = load_run(self.directory), self.describe()
        made_with = there.pop("provenance", None)
        different = changes({**there, "steps": 0}, {**now, "steps": 0})
        if now["steps"] < there["steps"]:
            different.append(f"steps: {there['steps']} there, {now['steps']} now, which is less")
        if different:
            raise LearningError(
                f"{self.directory} holds another run, which cannot be resumed as this one ({'; '.join(different)})"
            )
        if changed := differences(made_with, present):
            raise LearningError(f"{self.directory} cannot be resumed. {' '.join(changed)}")

    def describe(self) -> dict[str, Any]:
        """Record of the run as JSON values: all except its directory and the interval of its checkpoints."""
        settings = json_values(self.settings)
        settings.pop("checkpoint_every")
        steps = settings.pop("steps")
        record = {"algorithm": self.algorithm, "task": self.task, "steps": steps, "seed": self.seed}
        return {**json_values(record), "settings": settings}

    def write_record(self) -> None:
        """Write the record and the provenance into the run's directory, which is made if it does not exist."""
        write_json(self.directory / RUN_FILE, {**self.describe(), "provenance": self.task.provenance()})


def runs_of_seeds(run: Run, count: int) -> list[Run]:
    """The run with `count` seeds from its own on, each in seed-N/ in its directory. For one seed: the run itself.

    Raises:
        LearningError: fewer than one seed.
    """
    if count < 1:
        raise LearningError(f"seeds={count} is not valid; it must be at least 1")
    if count == 1:
        return [run]
    return [
        replace(run, seed=seed, directory=run.directory / f"seed-{seed}") for seed in range(run.seed, run.seed + count)
    ]
