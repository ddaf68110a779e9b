"""Which side grasps a robot reaches while nothing else stands on a table, and the outline of the gripper for them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from irm.chain import pose_of
from planners.collision.scene_arrays import robot_arrays
from planners.collision.world import PADDING, CollisionWorld
from planners.grasping.arm_configurations import ConfigurationGrid, GripperPoses, scan_configurations
from planners.grasping.base_placement import MapPlacer
from planners.grasping.families import SIDE
from planners.grasping.grasp_poses import even_yaws, gripper_clearances, gripper_opening
from planners.scene import Body, Scene
from planners.scene.cover import BACK, HELD_GAP

RADIUS, HEIGHT = 0.03, 0.16
"""[m] of the cylinder that is grasped: the means of the environments' random cylinders."""
PALM_SLACK = 0.001
"""[m] that objects may extend farther towards the palm than the planner allows."""
_IN_LINE = 1e-3
"""[m] A link whose origin is this near to the approach axis is in line with the gripper."""
_BASES_UNDER_A_BOARD = 8
"""Base poses for each gripper pose, as many as the planner tries there before it calls a target obstructed."""

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SideGripper:
    """What a test for objects in the way of side grasps needs to know of gripper and planner; all lengths in [m].

    Attributes:
        margins: `yaws`, the number of directions; what gripper and wrist keep from objects (`padding`), each finger
            from the object before it closes (`finger_gap`), and a held object from others (`held_gap`); how far the
            gripper backs off under a board (`back`).
        palm_reach: how far an object may extend from the TCP towards the palm.
        pad_half_height: of a finger pad.
        solids: gripper and wrist of a level gripper, rows (x0, x1, half width, radius, half height, moves with the
            fingers), x along the approach from the TCP. The half width of a finger is counted from its pad.
    """

    margins: dict[str, Any]
    palm_reach: float
    pad_half_height: float
    solids: tuple[tuple[float, ...], ...]

    @classmethod
    def of(cls, robot: RobotSpec) -> SideGripper:
        """That of a robot's active arm."""
        gripper = gripper_clearances(robot)
        return cls(
            {
                "yaws": SIDE.directions,
                "padding": PADDING,
                "finger_gap": robot.finger_gap,
                "back": BACK,
                "held_gap": HELD_GAP,
            },
            round(gripper.palm_reach + PALM_SLACK, 6),
            gripper.pad_half_height,
            _solids(robot),
        )


def reachable_side_grasps(
    scene: Scene, points: Array, is_covered: bool, tick: Callable[[], object] = lambda: None
) -> NDArray[np.bool_]:
    """Whether side grasps at points (k, 2) [m] of the first support are reached, by direction 2πj/yaws: (k, yaws).

    A grasp counts if one of the base poses that the planner offers has an arm configuration that hits neither furniture
    nor the robot itself; on a covered support, neither on the straight drive to it.

    Args:
        scene: its objects are left out.
        points: where the TCP is, at the robot's height of grasps.
        is_covered: whether a board hangs over the support.
        tick: called after every point.
    """
    robot, scene = scene.robot, replace(scene, objects=(), held=None)
    world, placer, opening = CollisionWorld.from_scene(scene), MapPlacer.of_scene(scene), gripper_opening(robot, RADIUS)
    grid, yaws, top = ConfigurationGrid.over(placer.chain), even_yaws(SIDE.directions), scene.support.top
    size = np.array([RADIUS, RADIUS, HEIGHT / 2])
    grasped = Body("grasped", "cylinder", size, position=np.zeros(3), quaternion=np.eye(4)[0])
    found = np.zeros((len(points), len(yaws)), np.bool_)
    for index, (x, y) in enumerate(points):
        positions = np.tile((x, y, top + robot.grasp_height), (len(yaws), 1))
        poses = np.column_stack((positions, yaws, np.zeros(len(yaws))))
        bases, pose_of_base = placer.bases(poses, _BASES_UNDER_A_BOARD if is_covered else 0)
        body = grasped.at((x, y, top + HEIGHT / 2))
        for yaw in range(len(yaws)):
            mine = bases[pose_of_base == yaw]
            if len(mine):
                tried = GripperPoses(mine, np.tile(poses[yaw], (len(mine), 1)))
                configurations = scan_configurations(world, tried, grid, opening, body=body, first_free=True)
                found[index, yaw] = len(configurations.q) > 0
        tick()
    return found


def _solids(robot: RobotSpec) -> tuple[tuple[float, ...], ...]:
    """Outlines of what moves with the level gripper: the last link, and the one before it if it is in line with it.

    The outer faces of the fingers lie beyond the pads by the half width that is given for them.
    """
    arrays = robot_arrays(robot)
    last = len(arrays.offsets) - 1
    T_tcp_last = np.linalg.inv(pose_of(arrays.tip))
    T_tcp_before = T_tcp_last @ np.linalg.inv(pose_of(arrays.offsets[last]))
    is_in_line = float(np.abs(T_tcp_before[1:3, 3]).max()) < _IN_LINE
    rows: list[tuple[float, ...]] = []
    first = last - 1 if is_in_line else last
    for solid in np.flatnonzero(arrays.link >= first):
        T = T_tcp_last if arrays.link[solid] == last else T_tcp_before
        half = np.abs(T[:3, :3] @ arrays.rotation[solid]) @ arrays.half[solid]
        x, y = (T[:3, :3] @ arrays.position[solid] + T[:3, 3])[:2]
        is_finger = bool(arrays.slides[solid])
        width = abs(y) + half[1] - arrays.gap / 2 if is_finger else half[1]
        row = (x - half[0], x + half[0], width, arrays.radius[solid], half[2] + arrays.radius[solid])
        rows.append((*(round(float(value), 6) for value in row), int(is_finger)))
    return tuple(dict.fromkeys(rows))
