"""What to train: the settings of every algorithm; commands read them, so nothing heavy is imported.

The settings of an algorithm are a dataclass with the options that it has and no others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from types import MappingProxyType
from typing import ClassVar, Literal

from clutter_env import GOAL_FAMILIES
from clutter_env.errors import LearningError
from clutter_env.seeds import training_seeds

DECISION_SEEDS, PLAN_SEEDS, DAGGER_SEEDS = 10_000, 100_000, 500_000
"""First seeds of the scenes for decisions, for plans that are cloned, and of the learner's own episodes in DAgger."""
SEEDS_OF_A_RUN, DECISION_RUNS = 20_000, 20
"""Seeds from the first one of a run to that of the next; runs with their own scenes for decisions."""

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

    def scene_seeds(self, seed: int) -> tuple[range, ...]:  # noqa: ARG002
        """The seeds of the scenes that a run with a random seed draws to learn from, in the parts that it needs.

        Raises:
            LearningError: some of them are held out; see `training_seeds`.
        """
        return ()

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

    def scene_seeds(self, seed: int) -> tuple[range, ...]:
        """That of the first scene; the generator of the environment goes on from there."""
        return (training_seeds(seed),)


@dataclass(frozen=True, kw_only=True)
class SAC(Reinforcement):
    """Soft actor-critic with hindsight, for Reach and Pick."""

    algorithm: ClassVar[str] = "sac"
    families: ClassVar[tuple[str, ...]] = GOAL_FAMILIES


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

    def scene_seeds(self, seed: int) -> tuple[range, ...]:
        """That of the first scene, and those of the cloned ones, the same for all runs."""
        return (*super().scene_seeds(seed), training_seeds(0, self.clone_scenes))


@dataclass(frozen=True, kw_only=True)
class MaskablePPO(PPO):
    """Proximal policy optimisation with action masks, for Skill."""

    algorithm: ClassVar[str] = "maskable_ppo"


@dataclass(frozen=True, kw_only=True)
class BC(Settings):
    """Behaviour cloning: regression of the actions of demonstrations on the observations."""

    algorithm: ClassVar[str] = "bc"
    families: ClassVar[tuple[str, ...]] = ("retrieve", *GOAL_FAMILIES)

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

    def scene_seeds(self, seed: int) -> tuple[range, ...]:
        """Those of the learner's own episodes, of all rounds."""
        count = self.rounds * self.round_episodes
        return (training_seeds(DAGGER_SEEDS + seed * count, count),)


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

    def scene_seeds(self, seed: int) -> tuple[range, ...]:
        """Those of the scenes that are planned."""
        return () if self.demos else (training_seeds(PLAN_SEEDS + seed * SEEDS_OF_A_RUN, self.plans),)


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

    def scene_seeds(self, seed: int) -> tuple[range, ...]:
        """Those of the examples."""
        return (training_seeds(DECISION_SEEDS + seed % DECISION_RUNS * SEEDS_OF_A_RUN, self.scenes),)


@dataclass(frozen=True, kw_only=True)
class DecisionsDAgger(Decisions):
    """The same, then in rounds also from the states that the learner comes into."""

    algorithm: ClassVar[str] = "decisions_dagger"

    rounds: int = 5
    """Number of rounds after the first fit."""
    round_episodes: int = 10
    """Number of scenes in each of these rounds."""

    def scene_seeds(self, seed: int) -> tuple[range, ...]:
        """Those of the examples, and those of all rounds."""
        (examples,) = super().scene_seeds(seed)
        return examples, training_seeds(examples.start + SEEDS_OF_A_RUN // 2, self.rounds * self.round_episodes)


SETTINGS: Mapping[str, type[Settings]] = MappingProxyType(
    {kind.algorithm: kind for kind in (SAC, TQC, PPO, MaskablePPO, BC, DAgger, Keyframes, Decisions, DecisionsDAgger)}
)
"""By the name of the algorithm."""
