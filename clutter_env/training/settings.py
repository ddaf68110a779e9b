"""Tasks of each learning algorithm, and settings of a run. The command reads this module, so it imports nothing
slow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType

from clutter_env import GOAL_FAMILIES
from clutter_env.errors import LearningError

ALGORITHMS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "sac": (*GOAL_FAMILIES, "armretrieve", "retrieve"),
        "tqc": (*GOAL_FAMILIES, "armretrieve", "retrieve"),
        "ppo": ("retrieve", "armretrieve", "skill"),
        "maskable_ppo": ("skill",),
        "dqn": ("skill",),
    }
)
"""The learners of Stable-Baselines3 and sb3-contrib, and the families of environments on which each learns."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Length of training, and evaluation of success.

    Raises:
        LearningError: a number that must be at least 1 is less.
    """

    steps: int = 30_000
    """Steps of the environment, those of all copies together."""
    num_envs: int = 1
    """Copies of the environment."""
    gradient_steps: int = 1
    """Gradient steps after each step of all copies, of SAC, TQC and DQN."""
    device: str = "cpu"
    """Device of the networks, as torch names it."""
    checkpoint_every: int = 5000
    """Steps between checkpoints. The last step is one too."""
    evaluation_episodes: int = 20
    """Number of held-out scenes that are played at every checkpoint."""
    evaluation_steps: int = 600
    """Steps after which a held-out episode is cut off."""

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            if isinstance(value, int) and value < 1:
                raise LearningError(f"{entry.name}={value} is not valid; it must be at least 1")
