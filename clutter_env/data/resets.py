"""Resets into the states of demonstrations, for reverse curricula: RFCL (Tao et al. 2024, arXiv:2405.03379), JSRL
(Uchendu et al. 2023, arXiv:2204.02372).

    resets = demonstration_resets(Dataset(Path("outputs/demos/arm")))
    env = FromDemonstrations(gym.make("clutter_env/ArmRetrieve-o1-v0"), resets, share=0.5)
    env.within = 10  # steps before the end; None: anywhere
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

from clutter_env.data.episode import Episode
from clutter_env.errors import DatasetError, LearningError
from clutter_env.seeds import HELD_OUT


@dataclass(frozen=True)
class DemonstrationResets:
    """States of demonstrations, in the order of their steps. The last states, which are successes, are left out."""

    episodes: tuple[tuple[bytes, ...], ...]

    def draw(self, rng: np.random.Generator, within: int | None = None) -> dict[str, Any]:
        """Sample options of `reset`: first a demonstration, uniformly, then a state of it.

        Args:
            rng: random generator.
            within: largest number of steps before the demonstration's end, None for any.

        Raises:
            LearningError: `within` is less than 1.
        """
        if within is not None and within < 1:
            raise LearningError(f"within={within} is not valid; it must be at least 1, or None")
        states = self.episodes[int(rng.integers(len(self.episodes)))]
        count = len(states) if within is None else min(within, len(states))
        return {"state": states[-1 - int(rng.integers(count))]}


def demonstration_resets(dataset: Iterable[Episode]) -> DemonstrationResets:
    """The states of a dataset's demonstrations, or of any episodes.

    Raises:
        DatasetError: no demonstration is given, or one has no saved states. It may be older than them, or from an
            environment that cannot save its state.
    """
    episodes = []
    for episode in dataset:
        if not episode.saved_states:
            raise DatasetError(f"the episode of seed {episode.seed} has no states to reset to; collect it again")
        episodes.append(episode.saved_states[:-1])
    if not episodes:
        raise DatasetError("no demonstrations to reset to")
    return DemonstrationResets(tuple(episodes))


class FromDemonstrations(gym.Wrapper[Any, Any, Any, Any]):
    """Starts a share of the episodes in a state of a demonstration, the others in scenes to learn from.

    Attributes:
        share: of the resets, 0 to 1. May be changed at any time.
        within: see `DemonstrationResets.draw`. May be changed at any time.
    """

    def __init__(
        self, env: gym.Env[Any, Any], resets: DemonstrationResets, share: float = 0.5, within: int | None = None
    ) -> None:
        super().__init__(env)
        self.resets, self.share, self.within = resets, share, within
        self._rng: np.random.Generator | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode. With options it is that of the environment."""
        if seed is not None or self._rng is None:
            self._rng = np.random.default_rng(seed)
        if options is not None:
            return self.env.reset(seed=seed, options=options)
        if self._rng.random() < self.share:
            return self.env.reset(options=self.resets.draw(self._rng, self.within))
        # A state includes its random generator. Without a seed the same scenes would follow each demonstration.
        return self.env.reset(seed=int(self._rng.integers(HELD_OUT)))
