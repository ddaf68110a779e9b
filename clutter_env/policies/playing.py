"""The loop over an episode: a policy acts and the environment steps until either says that it is over."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple


class PlayedStep(NamedTuple):
    """One step: the action as the policy returned it, and the environment's results for it."""

    action: Any
    observation: Any
    reward: Any
    terminated: bool
    truncated: bool
    info: dict[str, Any]

    @property
    def is_over(self) -> bool:
        """Whether the environment has ended the episode."""
        return self.terminated or self.truncated


def played(policy: Any, step: Callable[[Any], tuple[Any, ...]], observation: Any = None) -> Iterator[PlayedStep]:
    """Yield each step of an episode right after it was taken. To stop iterating ends the episode early.

    Example:
        for step in played(expert, env.step): print(expert.phase, step.info["lifted"])

    Args:
        policy: acts on observations, after its reset. `planners.TampExpert` ignores them. A policy without `done` never
            gives up.
        step: of the environment, which has been reset.
        observation: of the reset.
    """
    is_over = False
    while not (is_over or getattr(policy, "done", False)):
        action = policy.act(observation)
        last = PlayedStep(action, *step(action))
        observation, is_over = last.observation, last.is_over
        yield last
