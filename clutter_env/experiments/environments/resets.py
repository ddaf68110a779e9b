"""Time of a reset beside that of Gymnasium-Robotics' FetchPickAndPlace, a scene with one object.

The comparison needs the extra [visuals], which brings Gymnasium-Robotics.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from statistics import median
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import gymnasium as gym
import mujoco

from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.errors import ConfigError
from clutter_env.experiments.environments.cpu_time import cpu_time
from clutter_env.reporting.progress import progress_bar

__all__ = ["ResetTimes", "compare_resets"]

REFERENCE = "FetchPickAndPlace-v4"
RESETS = 100
"""Resets of each environment in one round."""


@dataclass(frozen=True)
class ResetTimes:
    """Medians of CPU time [s] of a reset, one number for each round.

    Attributes:
        ours: of Retrieve.
        reference: of FetchPickAndPlace.
    """

    ours: tuple[float, ...]
    reference: tuple[float, ...]

    def summary(self) -> str:
        """The figures in one line."""
        ratios = [ours / reference for ours, reference in zip(self.ours, self.reference, strict=True)]
        return (
            f"reset: {median(self.ours) * 1e6:.0f} µs; {REFERENCE}: {median(self.reference) * 1e6:.0f} µs; "
            f"ratio {median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})"
        )


def compare_resets(rounds: int, num_objects: int = 20, seed: int = 0) -> ResetTimes:
    """Resets of Retrieve and of FetchPickAndPlace in turn, `RESETS` of each in every round.

    Raises:
        ConfigError: Gymnasium-Robotics is not installed.
    """
    ours: gym.Env[Any, Any] = RetrieveEnv(num_objects=num_objects)
    with _reference() as reference:
        ours.reset(seed=seed)
        reference.reset(seed=seed)
        times = [
            (_median_reset(ours, first), _median_reset(reference, first))
            for first in progress_bar(range(seed, seed + rounds * RESETS, RESETS), desc="resets", unit="round")
        ]
    return ResetTimes(tuple(pair[0] for pair in times), tuple(pair[1] for pair in times))


@contextmanager
def _reference() -> Iterator[gym.Env[Any, Any]]:
    """FetchPickAndPlace, made to run on MuJoCo 4.

    It compares a model's joint types, which are numbers, with members of an enumeration. In MuJoCo 4 these are never
    equal; here it compares with the members' numbers.
    """
    try:
        import gymnasium_robotics
        from gymnasium_robotics.utils import mujoco_utils
    except ImportError:
        raise ConfigError('this comparison needs Gymnasium-Robotics: pip install "clutter-env[visuals]"') from None
    gym.register_envs(gymnasium_robotics)
    numbers = SimpleNamespace(**{name: int(member) for name, member in mujoco.mjtJoint.__members__.items()})
    with patch.object(mujoco_utils, "mujoco", SimpleNamespace(**{**vars(mujoco), "mjtJoint": numbers})):
        yield gym.make(REFERENCE).unwrapped


def _median_reset(env: gym.Env[Any, Any], first_seed: int) -> float:
    """Median CPU time [s] of `RESETS` resets."""
    return median(cpu_time(partial(env.reset, seed=seed)) for seed in range(first_seed, first_seed + RESETS))
