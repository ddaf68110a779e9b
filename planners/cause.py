"""Causes of a solve without a plan.

A cause is found while planning, in `planners.clearing`, and worded in `planners.tamp.explain`. If objects of the goal
are not at rest, `solve` names that as the cause instead.
"""

from __future__ import annotations

from enum import StrEnum


class Cause(StrEnum):
    """Cause of a solve without a plan.

    Attributes:
        NO_SELF_CLEARABLE_SET: in every order, some object that must go before the target waits for itself.
        UNREACHABLE: every base pose and arm configuration that reaches the target is in collision, or none exists.
        TOO_WIDE: the target is too wide for every grasp of the grasp set.
        NO_WAY_FOR_BASE: grasps exist, but the base can drive to none of them.
        NO_CLEARANCE_LOCATION: an object must be put down, but every location is in the way of later steps.
        MOTION: grasps exist, but none is left after refuted motions, or after objects were put aside.
        SPRINGS_SHUT: a door, drawer or lid that must be opened shuts again when it is released.
        SPRINGS_OPEN: a door, drawer or lid that must be shut, or turned back, opens again when it is released.
        NOT_AT_REST: an object to take is sunk into furniture, or in the air. See `planners.check`.
        TOO_HEAVY: an object to take is too heavy for the arm or the fingers.
        TOO_SLIPPERY: friction is too low for the fingers to hold an object to take.
        TIME_LIMIT: the time limit was reached.
        GIVEN_UP: the limit on replans or put-downs was reached.
    """

    NO_SELF_CLEARABLE_SET = "no self-clearable set"
    UNREACHABLE = "unreachable"
    TOO_WIDE = "too wide"
    NO_WAY_FOR_BASE = "no way for the base"
    NO_CLEARANCE_LOCATION = "no clearance location"
    MOTION = "motion"
    SPRINGS_SHUT = "springs shut"
    SPRINGS_OPEN = "springs open"
    NOT_AT_REST = "not at rest"
    TOO_HEAVY = "too heavy"
    TOO_SLIPPERY = "too slippery"
    TIME_LIMIT = "time limit"
    GIVEN_UP = "given up"

    @property
    def lies_in_grasps(self) -> bool:
        """Whether the cause follows from the grasps alone, before any motion is planned."""
        return self in (Cause.NO_SELF_CLEARABLE_SET, Cause.UNREACHABLE, Cause.TOO_WIDE)
