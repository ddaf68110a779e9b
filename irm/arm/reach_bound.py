"""How far away the base may stand at most: a bound by arithmetic, without inverse kinematics."""

from __future__ import annotations

from math import cos, hypot, sin, sqrt
from typing import NamedTuple

from irm.arm.chain import ArmChain

__all__ = ["WristDisc", "wrist_disc"]


class WristDisc(NamedTuple):
    """The base's centre is at most `radius` from the wrist centre, which is `level` behind the TCP; both horizontal
    [m]."""

    level: float
    radius: float

    @property
    def farthest(self) -> float:
        """[m] between the base's centre and the TCP, at most."""
        return self.level + self.radius


def wrist_disc(chain: ArmChain, torso_range: tuple[float, float], z: float, pitch: float) -> WristDisc | None:
    """Where the base may be for a TCP at height `z` [m] with a pitch [rad]; None if the arm does not reach this height.

    With a closed form, the wrist centre is at most upper arm + forearm away from the lift axis. For any other arm, the
    TCP is at most the sum of all link lengths away from the first joint.
    """
    if chain.has_closed_form:
        pan_x, pan_z, shoulder_x, shoulder_z, upper_arm, forearm, gripper = chain.links.tolist()
        return _disc(
            gripper * cos(pitch),
            abs(pan_x) + shoulder_x,
            upper_arm + forearm,
            torso_range,
            z + gripper * sin(pitch) - pan_z - shoulder_z,
        )
    x, y, height = chain.shoulder.tolist()
    return _disc(0.0, hypot(x, y), chain.reach, torso_range, z - height)


def _disc(
    level: float, inner: float, reach: float, torso_range: tuple[float, float], height: float
) -> WristDisc | None:
    """`inner`: horizontal distance from the base's centre to the joint from which the arm reaches `reach` far [m]."""
    above = max(torso_range[0] - height, height - torso_range[1], 0.0)
    return WristDisc(level, inner + sqrt(reach * reach - above * above)) if above <= reach else None
