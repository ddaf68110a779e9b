"""Why a solve ended without a plan."""

from __future__ import annotations

from enum import StrEnum

__all__ = ["Cause"]


class Cause(StrEnum):
    """Why a solve ended without a plan."""

    NO_SELF_CLEARABLE_SET = "no self-clearable set"
    UNREACHABLE = "unreachable"
    NO_CLEARANCE_LOCATION = "no clearance location"
    MOTION = "motion"
    TIME_LIMIT = "time limit"
