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

DECISION_SEEDS, PLAN_SEEDS = 10_000, 100_000
"""First seeds of the scenes for decisions, and for plans that are cloned."""
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
            least = 0 if entry.name == "rounds" else 1
            if isinstance(value, int) and not isinstance(value, bool) and value < least:
                raise LearningError(f"{entry.name}={value} is not valid; it must be at least {least}")


@dataclass(frozen=True, kw_only=True)
class Reinforcement(Settings):
    """Options of learning from rewards, by Stable-Baselines3 and sb3-contrib as they are."""

    steps: int = 30_000
    """Steps of the environment, those of all copies together."""
    num_envs: int = 1
    """Copies of the environment."""
    gradient_steps: int = 1
    """Gradient steps after each step of all copies; of SAC, TQC and DQN."""
    device: str = "cpu"
    """Device of the networks, as torch names it."""
    checkpoint_every: int = 5000
    """Steps between checkpoints."""
    evaluation_steps: int = 600
    """Steps after which a held-out episode is cut off."""

    def scene_seeds(self, seed: int) -> tuple[range, ...]:
        """Those of the first scenes; the generators of the environments go on from there."""
        return (training_seeds(seed, self.num_envs),)


@dataclass(frozen=True, kw_only=True)
class SAC(Reinforcement):
    """Soft actor-critic, on goal environments with hindsight (HER)."""

    algorithm: ClassVar[str] = "sac"
    families: ClassVar[tuple[str, ...]] = (*GOAL_FAMILIES, "retrieve")


@dataclass(frozen=True, kw_only=True)
class TQC(SAC):
    """Truncated quantile critics, on goal environments with hindsight (HER)."""

    algorithm: ClassVar[str] = "tqc"


@dataclass(frozen=True, kw_only=True)
class PPO(Reinforcement):
    """Proximal policy optimisation."""

    algorithm: ClassVar[str] = "ppo"
    families: ClassVar[tuple[str, ...]] = ("retrieve", "skill")


@dataclass(frozen=True, kw_only=True)
class MaskablePPO(Reinforcement):
    """Proximal policy optimisation with action masks, for Skill."""

    algorithm: ClassVar[str] = "maskable_ppo"
    families: ClassVar[tuple[str, ...]] = ("skill",)


@dataclass(frozen=True, kw_only=True)
class DQN(Reinforcement):
    """Deep Q-learning, for Skill."""

    algorithm: ClassVar[str] = "dqn"
    families: ClassVar[tuple[str, ...]] = ("skill",)


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

    rounds: int = 0
    """Rounds after the first fit, which learn from the states that the learner comes into (DAgger)."""
    round_episodes: int = 10
    """Number of scenes in each of these rounds."""

    def scene_seeds(self, seed: int) -> tuple[range, ...]:
        """Those of the examples, and those of all rounds."""
        first = DECISION_SEEDS + seed % DECISION_RUNS * SEEDS_OF_A_RUN
        of_rounds = training_seeds(first + SEEDS_OF_A_RUN // 2, self.rounds * self.round_episodes)
        return training_seeds(first, self.scenes), of_rounds


SETTINGS: Mapping[str, type[Settings]] = MappingProxyType(
    {kind.algorithm: kind for kind in (SAC, TQC, PPO, MaskablePPO, DQN, BC, Keyframes, Decisions)}
)
"""By the name of the algorithm."""
