"""The exceptions of this package."""

from __future__ import annotations

__all__ = ["CollectionError", "DatasetError", "LearningError", "UnknownExpert", "UnknownTask"]


class LearningError(ValueError):
    """Base of every exception raised here for misuse."""


class DatasetError(LearningError):
    """A directory or file does not hold what was asked for; the message says what it holds."""


class CollectionError(LearningError, RuntimeError):
    """Collecting had to stop: a full disk, workers that keep dying, seeds that run out. What is written stays valid."""


class UnknownExpert(LearningError):
    """No expert of that name for that environment; the message lists the known ones."""


class UnknownTask(LearningError):
    """No environment of that name, or not with those keyword arguments; the message lists the known ones."""
