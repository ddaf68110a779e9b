"""Checks of the fields of a `RobotSpec`; the message names the field."""

from __future__ import annotations

import math
from numbers import Real

from assets.robot_parts import AXES, ChainLink, InvalidRobot

__all__ = ["check_chain", "check_names", "check_numbers", "check_unit", "require"]

_UNIT = 1e-6
"""By how much the length of a unit vector or quaternion may differ from 1."""

_AXIS = "'x', 'y' or 'z', one of these with a minus sign, or a unit vector"


def require(holds: bool, name: str, problem: str) -> None:
    """Raise `InvalidRobot` with the name of a field and its problem, unless a condition holds."""
    if not holds:
        raise InvalidRobot(f"RobotSpec: {name} {problem}")


def check_chain(chain: object) -> None:
    """The chain is a prismatic torso lift and at least one revolute joint, each with an axis and a range."""
    is_chain = isinstance(chain, tuple) and len(chain) >= 2 and all(isinstance(link, ChainLink) for link in chain)
    require(is_chain, "chain", "must be a tuple of ChainLink: a prismatic torso lift, then revolute arm joints")
    assert isinstance(chain, tuple)
    for index, link in enumerate(chain):
        kind = "prismatic" if index == 0 else "revolute"
        require(link.prismatic == (index == 0), "chain", f"must have a {kind} joint as entry {index}: {link.joint!r}")
        is_named = isinstance(link.axis, str) and link.axis in AXES
        require(is_named or not isinstance(link.axis, str), "chain", f"{link.joint!r}: axis must be {_AXIS}")
        check_unit(f"chain, axis of {link.joint!r}", link.direction, 3)
        check_unit(f"chain, quaternion of {link.joint!r}", link.quaternion, 4)
        check_numbers(f"chain, offset of {link.joint!r}", link.offset, 3)
        check_numbers(f"chain, range of {link.joint!r}", (link.lower, link.upper), 2)
        is_range = link.lower < link.upper or (index == 0 and link.lower == link.upper)
        require(is_range, "chain", f"{link.joint!r}: lower must be below upper (equal for a robot without a lift)")


def check_names(name: str, value: object, count: int) -> None:
    """A field is a tuple of so many different names."""
    is_tuple = isinstance(value, tuple) and all(isinstance(entry, str) and entry for entry in value)
    require(is_tuple, name, f"must be a tuple of names, not {value!r}")
    assert isinstance(value, tuple)
    require(len(value) == count == len(set(value)), name, f"must be {count} different names, not {value!r}")


def check_numbers(name: str, value: object, count: int, positive: bool = False) -> None:
    """A field is a tuple of so many finite, or positive, numbers."""
    is_tuple = isinstance(value, tuple) and all(isinstance(entry, Real) for entry in value)
    require(is_tuple, name, f"must be a tuple of numbers, not {value!r}")
    assert isinstance(value, tuple)
    require(len(value) == count, name, f"must have {count} numbers, not {len(value)}")
    holds = all(math.isfinite(entry) and (entry > 0 or not positive) for entry in value)
    require(holds, name, f"must be {'positive' if positive else 'finite'}, not {value!r}")


def check_unit(name: str, value: object, count: int) -> None:
    """A field is a unit vector or quaternion of so many numbers."""
    check_numbers(name, value, count)
    assert isinstance(value, tuple)
    require(abs(math.hypot(*value) - 1.0) < _UNIT, name, f"must have length 1, not {value!r}")
