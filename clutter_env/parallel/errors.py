"""The exception of this package."""

__all__ = ["WorkerError"]


class WorkerError(ValueError):
    """Jobs cannot be started: too few workers, or Ray is not installed."""
