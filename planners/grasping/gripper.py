"""Lengths of a gripper that grasps depend on, read from its collision solids."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from assets.robots import RobotSpec
from irm.chain import pose_of
from planners.collision.scene_arrays import robot_arrays

FINGER_GAP = 0.012
"""[m] between each finger and the object before the fingers close."""
_PALM_ROOM, _PALM_SIDE, _TIP_ROOM, _PAD_ROOM = 0.003, 0.002, 0.0045, 0.0045
"""[m] that are kept before the palm, below the palm, beyond the fingertips and at the upper edge of the pads."""
_DECIMALS = 6


@dataclass(frozen=True)
class GripperClearances:
    """Lengths of the gripper that grasps depend on [m].

    Attributes:
        palm_reach: that the object may extend from the TCP towards the palm; Fetch's palm begins 47 mm behind.
        palm_height: from the approach axis to the palm's lower face, and 2 mm.
        fingertip_reach: that the fingers extend beyond the TCP, and 4.5 mm.
        pad_half_height: of a finger pad, which should not extend above the object.
        least_depth: of the TCP below the object's highest point, so that the pads hold it.
    """

    palm_reach: float
    palm_height: float
    fingertip_reach: float
    pad_half_height: float
    least_depth: float

    def above_support(self, pitch: float) -> float:
        """[m] of the TCP above the support at least, for fingertips and palm at a pitch [rad] to stay clear of it."""
        down, level = math.sin(pitch), math.cos(pitch)
        fingertips = self.fingertip_reach * down + self.pad_half_height * level
        return max(fingertips, self.palm_height * level - self.palm_reach * down)


@cache
def gripper_clearances(robot: RobotSpec) -> GripperClearances:
    """The lengths of a robot's gripper: of its fingers, and of the palm, the solid behind them that is foremost."""
    arrays = robot_arrays(robot)
    T_tcp_link = np.linalg.inv(pose_of(arrays.tip))
    last = arrays.link == arrays.axes.size - 1
    centre = arrays.position @ T_tcp_link[:3, :3].T + T_tcp_link[:3, 3]
    extent = np.array(
        [np.abs(R) @ half for R, half in zip(T_tcp_link[:3, :3] @ arrays.rotation, arrays.half, strict=True)]
    )
    extent += arrays.radius[:, None]
    front = centre[:, 0] + extent[:, 0]
    fingers, others = np.flatnonzero(last & arrays.slides), np.flatnonzero(last & ~arrays.slides)
    palm = others[front[others].argmax()]
    pad = float(extent[fingers, 2].max())
    lengths = (
        -float(front[palm]) - _PALM_ROOM,
        float(abs(centre[palm, 2]) + extent[palm, 2]) + _PALM_SIDE,
        float(front[fingers].max()) + _TIP_ROOM,
        pad,
        pad + _PAD_ROOM,
    )
    return GripperClearances(*(round(length, _DECIMALS) for length in lengths))
