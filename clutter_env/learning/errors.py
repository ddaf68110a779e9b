"""The exceptions of this package."""

from __future__ import annotations

__all__ = ["CollectionError", "DatasetError", "LearningError", "UnknownExpert", "UnknownTask"]


class LearningError(ValueError):
    """Base of all exceptions of this package."""


class DatasetError(LearningError):
    """A directory or file does not hold what is needed; the message says what it holds."""


class CollectionError(LearningError, RuntimeError):
    """The collection had to stop: full disk, workers that die, too many rejected seeds. Stored episodes stay valid."""


class UnknownExpert(LearningError):
    """No expert of that name for that environment; the message lists the known ones."""


class UnknownTask(LearningError):
    """No environment of that name, or not with those keyword arguments; the message lists the known ones."""
