"""Answers of solvers and kernels whether a pose is in reach: the values of `irm.queries.status.Status`."""

from __future__ import annotations

__all__ = ["NO", "OPEN", "YES"]

NO, OPEN, YES = 0, 1, 2
