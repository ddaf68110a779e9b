"""What to train: the settings of every algorithm, and a run, checked and recorded in its directory; without torch.

The settings of an algorithm are a dataclass with the options that it has and no others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Literal

from clutter_env.data.dataset import Dataset
from clutter_env.errors import LearningError
from clutter_env.policies.runs import RUN_FILE, load_run
from clutter_env.provenance import differences as made_differently
from clutter_env.reporting.files import json_values, write_json
from clutter_env.task import Task

Grasps = Literal["side", "tilted", "top", "all"]


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Options that all algorithms have; each of the classes below is one algorithm.

    Raises:
        LearningError: a number that must be at least 1 is not.
    """

    algorithm: ClassVar[str]
    families: ClassVar[tuple[str, ...]] = ("retrieve",)
    """Families of environments on which the algorithm learns."""

    steps: int
    """Steps of the environment, or for imitation learning and decisions gradient steps."""
    evaluation_episodes: int = 20
    """Number of held-out scenes that are played at every evaluation."""

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            least = 0 if entry.name == "clone_scenes" else 1
            if isinstance(value, int) and not isinstance(value, bool) and value < least:
                raise LearningError(f"{entry.name}={value} is not valid; it must be at least {least}")


@dataclass(frozen=True, kw_only=True)
class Reinforcement(Settings):
    """Options of learning from rewards."""

    steps: int = 30_000
    """Steps of the environment."""
    checkpoint_every: int = 5000
    """Steps between checkpoints."""
    evaluation_steps: int = 600
    """Steps after which a held-out episode is cut off."""


@dataclass(frozen=True, kw_only=True)
class SAC(Reinforcement):
    """Soft actor-critic with hindsight, for Reach and Pick."""

    algorithm: ClassVar[str] = "sac"
    families: ClassVar[tuple[str, ...]] = ("reach", "pick")


@dataclass(frozen=True, kw_only=True)
class TQC(SAC):
    """Truncated quantile critics with hindsight, for Reach and Pick."""

    algorithm: ClassVar[str] = "tqc"


@dataclass(frozen=True, kw_only=True)
class PPO(Reinforcement):
    """Proximal policy optimisation, for Skill, whose steps are skills."""

    algorithm: ClassVar[str] = "ppo"
    families: ClassVar[tuple[str, ...]] = ("skill",)

    clone_scenes: int = 0
    """Number of scenes whose good skills are cloned before learning from rewards; 0 for no cloning."""
    clone_steps: int = 10_000
    """Gradient steps of the cloning."""


@dataclass(frozen=True, kw_only=True)
class MaskablePPO(PPO):
    """Proximal policy optimisation with action masks, for Skill."""

    algorithm: ClassVar[str] = "maskable_ppo"


@dataclass(frozen=True, kw_only=True)
class BC(Settings):
    """Behaviour cloning: regression of the actions of demonstrations on the observations."""

    algorithm: ClassVar[str] = "bc"
    families: ClassVar[tuple[str, ...]] = ("retrieve", "reach", "pick")

    demos: Path
    """Dataset of `clutter-env collect`."""
    demo_episodes: int | None = None
    """Number of its episodes to learn from; all by default."""
    steps: int = 10_000
    """Gradient steps."""
    evaluation_steps: int = 600
    """Steps after which a held-out episode is cut off."""


@dataclass(frozen=True, kw_only=True)
class DAgger(BC):
    """Cloning in rounds: the learner acts, the expert takes over, and its part is learned too."""

    algorithm: ClassVar[str] = "dagger"

    steps: int = 10_000
    """Gradient steps of each round."""
    rounds: int = 5
    """Number of rounds after the first cloning."""
    round_episodes: int = 10
    """Episodes of the learner in each round."""
    expert: str = ""
    """Expert that takes over; empty for the one of the demonstrations."""


@dataclass(frozen=True, kw_only=True)
class Keyframes(Settings):
    """Motions of picks and places, cloned as keyframes from demonstrations or from plans without physics."""

    algorithm: ClassVar[str] = "keyframes"

    steps: int = 4000
    """Gradient steps."""
    demos: Path | None = None
    """Dataset of `clutter-env collect`; without it plans are learned from, of which nothing is simulated."""
    demo_episodes: int | None = None
    """Number of its episodes to learn from; all by default."""
    plans: int = 600
    """Number of scenes that are planned if there is no dataset."""
    grasps: Grasps = "side"
    """Grasps of these plans."""


@dataclass(frozen=True, kw_only=True)
class Decisions(Settings):
    """Choice of the next object, its grasp and its place, from the planner's geometry."""

    algorithm: ClassVar[str] = "decisions"

    steps: int = 3000
    """Gradient steps."""
    scenes: int = 700
    """Number of scenes from which examples are collected."""
    grasps: Grasps = "side"
    """Grasps that are chosen among."""


@dataclass(frozen=True, kw_only=True)
class DecisionsDAgger(Decisions):
    """The same, then in rounds also from the states that the learner comes into."""

    algorithm: ClassVar[str] = "decisions_dagger"

    rounds: int = 5
    """Number of rounds after the first fit."""
    round_episodes: int = 10
    """Number of scenes in each of these rounds."""


SETTINGS: Mapping[str, type[Settings]] = MappingProxyType(
    {kind.algorithm: kind for kind in (SAC, TQC, PPO, MaskablePPO, BC, DAgger, Keyframes, Decisions, DecisionsDAgger)}
)
"""By the name of the algorithm."""


@dataclass(frozen=True)
class Run:
    """A run of an algorithm.

    Attributes:
        task: environment and keyword arguments.
        settings: of the algorithm; one of `SETTINGS`.
        directory: of the run.
        seed: random seed.
    """

    task: Task
    settings: Settings
    directory: Path
    seed: int = 0

    def check(self, resume: bool = False) -> None:
        """Make sure that the run can be started, or resumed; nothing is written.

        Raises:
            UnknownTask: no such environment, or not with these keyword arguments.
            DatasetError: the demonstrations are not there, or not complete.
            LearningError: the algorithm does not learn on this task; the directory holds a run, and it is not to be
                resumed, is another one, or was made with another environment (the message names what differs).
        """
        present = self.task.provenance()
        if self.task.family not in self.settings.families:
            fitting = ", ".join(name for name, kind in SETTINGS.items() if self.task.family in kind.families)
            raise LearningError(
                f"{self.settings.algorithm} does not learn on {self.task.env_id}; for this one: {fitting}"
            )
        if demos := getattr(self.settings, "demos", None):
            len(Dataset(demos))  # raises before the run's directory is made, where a corrected command would meet it
        if not (self.directory / RUN_FILE).exists():
            return
        if not resume:
            raise LearningError(
                f"{self.directory} holds a training run; resume it (--resume), or choose another directory"
            )
        there, now = load_run(self.directory), self.describe()
        made_with = there.pop("provenance", None)
        different = differences({**there, "steps": 0}, {**now, "steps": 0})
        if now["steps"] < there["steps"]:
            different.append(f"steps: {there['steps']} there, {now['steps']} now, which is less")
        if different:
            raise LearningError(
                f"{self.directory} holds another run, which cannot be resumed as this one ({'; '.join(different)})"
            )
        if changed := made_differently(made_with, present):
            raise LearningError(f"{self.directory} cannot be resumed. {' '.join(changed)}")

    def describe(self) -> dict[str, Any]:
        """The record of the run as JSON values: all but its directory and the interval of its checkpoints."""
        settings = json_values(self.settings)
        settings.pop("checkpoint_every", None)
        steps = settings.pop("steps")
        record = {"algorithm": self.settings.algorithm, "task": self.task, "steps": steps, "seed": self.seed}
        return {**json_values(record), "settings": settings}

    def write_record(self) -> None:
        """Write the record, and what the run is made with, into its directory, which is made if it does not exist."""
        write_json(self.directory / RUN_FILE, {**self.describe(), "provenance": self.task.provenance()})


def runs_of_seeds(run: Run, count: int) -> list[Run]:
    """The run with `count` seeds from its own on, each in seed-N/ in its directory; only the run itself for one seed.

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


def differences(there: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """What differs between two records of a run, in words, such as "seed: 0 there, 1 now".

    Groups of values (mappings) that the first record lacks are not compared: runs of earlier versions lack some.
    """
    found = []
    for name in dict.fromkeys((*there, *now)):
        old, new = there.get(name), now.get(name)
        if isinstance(new, Mapping):
            found += differences(old, new) if isinstance(old, Mapping) else []
        elif old != new:
            found.append(f"{name}: {old!r} there, {new!r} now")
    return found
