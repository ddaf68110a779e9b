"""What a task adds to the environment that all tasks share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from clutter_env.envs.reset_options import ResetOptions
from clutter_env.scene.table_scene import TableScene

__all__ = ["Task"]


class Task(ABC):
    """The methods that `BaseEnv` leaves to its subclasses."""

    @abstractmethod
    def _draw_scene(self, options: ResetOptions) -> TableScene:
        """The scene of a new episode."""

    @abstractmethod
    def _begin(self) -> None:
        """Start the task's bookkeeping; the world and `measurements` are those of the first state."""

    @abstractmethod
    def _advance(self) -> tuple[float, bool]:
        """Bookkeeping after a step: the reward, and whether the episode has ended."""

    @abstractmethod
    def _observe(self) -> dict[str, Any]:
        """The observation."""

    @abstractmethod
    def _is_success(self) -> bool:
        """Whether the task is done in the present state."""

    @abstractmethod
    def _memory(self) -> dict[str, Any]:
        """The task's bookkeeping as JSON values."""

    @abstractmethod
    def _read_memory(self, memory: Any) -> Any:
        """The bookkeeping in what `_memory` returned, for `_recall`; StateError where it is not valid."""

    @abstractmethod
    def _recall(self, bookkeeping: Any) -> None:
        """Restore the bookkeeping that `_read_memory` returned."""
