"""What to train, checked and recorded in the run's directory; without torch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from clutter_env.learning.errors import LearningError
from clutter_env.learning.policies.runs import (
    CLONERS,
    DECISION_LEARNERS,
    GOAL_ALGORITHMS,
    MOVER_LEARNERS,
    PLAN_LEARNERS,
    RUN_FILE,
    SKILL_ALGORITHMS,
    differences,
    load_run,
)
from clutter_env.learning.task import Task
from clutter_env.reporting.files import json_values, write_json
from planners import find_grasp_set

__all__ = ["LEARNERS", "Run"]

LEARNERS = (*GOAL_ALGORITHMS, *SKILL_ALGORITHMS, *CLONERS, *MOVER_LEARNERS, *DECISION_LEARNERS)
_FAMILIES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        **dict.fromkeys(GOAL_ALGORITHMS, ("reach", "pick", "retrieve")),
        **dict.fromkeys(SKILL_ALGORITHMS, ("skill",)),
        **dict.fromkeys(CLONERS, ("retrieve", "reach", "pick")),
        **dict.fromkeys(MOVER_LEARNERS, ("retrieve",)),
        **dict.fromkeys(DECISION_LEARNERS, ("retrieve",)),
    }
)
"""The families of environments that each algorithm learns on."""


@dataclass(frozen=True)
class Run:
    """What to train.

    Attributes:
        task: environment and keyword arguments.
        algorithm: one of `LEARNERS`.
        steps: of the environment; gradient steps of those that clone and of "decisions", and of each round of "dagger".
        directory: of the run.
        seed: random seed.
        demonstrations: dataset, needed by all that clone; "sac" and "tqc" imitate it and correct the imitation; they
            need it on Retrieve. "keyframes" without them learns from plans.
        episodes: of the dataset to use; None for all. Scenes from which "decisions" collects its examples, and that are
            planned for "keyframes" without a dataset. Of "ppo" and
            "maskable_ppo": scenes whose good skills are cloned before reinforcement learning; None for no cloning.
        imitation_steps: gradient steps of the clone that "sac", "tqc", "ppo" and "maskable_ppo" improve.
        rounds: of "dagger" and "decisions_dagger".
        round_episodes: episodes of the learner in each of these rounds.
        expert: that corrects the learner in "dagger"; "" for the one of the demonstrations.
        checkpoint_every: steps between checkpoints. Cloning has one at its end, DAgger one after every round.
        evaluation_episodes: held-out scenes played at every checkpoint.
        evaluation_steps: after which each of them is cut off.
        grasps: name of the grasp set that decisions are made among, and of plans that are learned from.
    """

    task: Task
    algorithm: str
    steps: int
    directory: Path
    seed: int = 0
    demonstrations: Path | None = None
    episodes: int | None = None
    imitation_steps: int = 10_000
    rounds: int = 5
    round_episodes: int = 10
    expert: str = ""
    checkpoint_every: int = 5000
    evaluation_episodes: int = 20
    evaluation_steps: int = 600
    grasps: str = "side"

    def check(self, resume: bool = False) -> None:
        """Make sure that the run can be started, or resumed; nothing is written.

        Raises:
            UnknownTask: no such environment, or not with these keyword arguments.
            UnknownGraspSet: no grasp set of that name.
            LearningError: the algorithm does not learn on this task or lacks demonstrations; a number is too small;
                the directory holds a run, and it is not to be resumed or is another one (the message names what
                differs).
        """
        self.task.make().close()
        find_grasp_set(self.grasps)
        if self.algorithm not in LEARNERS:
            raise LearningError(f"no algorithm {self.algorithm!r}; known ones: {', '.join(LEARNERS)}")
        if self.task.family not in _FAMILIES[self.algorithm]:
            fitting = ", ".join(name for name in LEARNERS if self.task.family in _FAMILIES[name])
            raise LearningError(f"{self.algorithm} does not learn on {self.task.env_id}; for this one: {fitting}")
        needs = (*CLONERS, *(name for name in MOVER_LEARNERS if name not in PLAN_LEARNERS))
        if self.algorithm in needs and self.demonstrations is None:
            raise LearningError(f"{self.algorithm} needs demonstrations; make some with `clutter-env collect`")
        if self.algorithm in GOAL_ALGORITHMS and self.task.family == "retrieve" and self.demonstrations is None:
            raise LearningError(
                f"{self.algorithm} needs demonstrations on Retrieve; make some with `clutter-env collect`"
            )
        if min(self.steps, self.checkpoint_every, self.evaluation_episodes) < 1:
            raise LearningError("steps, checkpoint_every and evaluation_episodes must be at least 1")
        if (self.directory / RUN_FILE).exists():
            self._check_record(resume)

    def _check_record(self, resume: bool) -> None:
        if not resume:
            raise LearningError(
                f"{self.directory} holds a training run; resume it (--resume), or choose another directory"
            )
        there, now = load_run(self.directory), self.describe()
        is_longer = now["steps"] >= there["steps"]
        different = differences({**there, "steps": 0}, {**now, "steps": 0})
        if not is_longer:
            different.append(f"steps: {there['steps']} there, {now['steps']} now, which is less")
        if different:
            raise LearningError(
                f"{self.directory} holds another run, which cannot be resumed as this one ({'; '.join(different)})"
            )

    def describe(self) -> dict[str, Any]:
        """The record of the run as JSON values: all but its directory and the interval of its checkpoints."""
        settings = {
            "demonstrations": self.demonstrations,
            "episodes": self.episodes,
            "imitation_steps": self.imitation_steps,
            "rounds": self.rounds,
            "round_episodes": self.round_episodes,
            "expert": self.expert,
            "evaluation_episodes": self.evaluation_episodes,
            "evaluation_steps": self.evaluation_steps,
            "grasps": self.grasps,
        }
        record = {"algorithm": self.algorithm, "task": self.task, "steps": self.steps, "seed": self.seed}
        return dict(json_values({**record, "settings": settings}))

    def write_record(self) -> None:
        """Write the record into the run's directory, which is made if it does not exist."""
        write_json(self.directory / RUN_FILE, self.describe())
