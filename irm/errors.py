"""Errors for misuse of this package. Expected failures are values (`Status.NO`)."""

from __future__ import annotations


class ReachabilityError(ValueError):
    """Base of every error this package raises for misuse."""


class ChainError(ReachabilityError):
    """The robot's chain does not have the required structure."""


class MapFileError(ReachabilityError):
    """A map file is damaged, or is not a map file of this version."""


class MapMismatchError(ReachabilityError):
    """A map belongs to another robot, or to other parameters, than those it is used with."""


class QueryError(ReachabilityError):
    """A query that has no meaning: not a number, an empty range, a wrong shape, an unknown keyword."""
