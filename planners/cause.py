"""Why a solve ended without a plan."""

from __future__ import annotations

from enum import StrEnum


class Cause(StrEnum):
    """Why a solve ended without a plan.

    Attributes:
        NO_SELF_CLEARABLE_SET: whatever is removed first, some object that must go before the target blocks itself.
        UNREACHABLE: no free base pose and arm configuration reach the target.
        TOO_WIDE: no grasp of the grasp set fits around the target.
        NO_WAY_FOR_BASE: some do, but the base can drive to none of them.
        NO_CLEARANCE_LOCATION: an object must be put down, but no location keeps clear of what remains to be done.
        MOTION: grasps exist, but motion planning refuted so many, or objects were put aside so, that no way to clear
            and take the target is left.
        SPRINGS_SHUT: what must be opened shuts again when nobody holds it.
        NOT_AT_REST: an object that is to be taken is sunk into furniture, or in the air; see `planners.check`.
        TOO_HEAVY: one is heavier than the arm or the fingers hold.
        TOO_SLIPPERY: the fingers cannot hold one for lack of friction.
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
    NOT_AT_REST = "not at rest"
    TOO_HEAVY = "too heavy"
    TOO_SLIPPERY = "too slippery"
    TIME_LIMIT = "time limit"
    GIVEN_UP = "given up"

    @property
    def lies_in_grasps(self) -> bool:
        """Whether it follows from the grasps alone, before any motion is planned."""
        return self in (Cause.NO_SELF_CLEARABLE_SET, Cause.UNREACHABLE, Cause.TOO_WIDE)
