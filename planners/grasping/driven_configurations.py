"""Arm configurations under a shelf: the base drives straight in and out, the arm rigid; what is in the way counts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from planners.collision.driven_world import Drive, Extents
from planners.collision.world import CollisionWorld
from planners.grasping.arm_configurations import (
    ArmConfigurations,
    ConfigurationGrid,
    GripperPoses,
    scan_configurations,
)
from planners.scene import Body, HeldObject, Scene
from planners.scene.cover import BACK, LEAST_LIFT, direction_out, distance_out, objects_before

_SAME_WAY = 9
"""Decimals of yaws [rad] and directions that count as the same."""


def driven_configurations(
    world: CollisionWorld,
    body: Body,
    poses: GripperPoses,
    grid: ConfigurationGrid,
    opening: float,
    *,
    held: HeldObject | None = None,
    ignore: int = 0,
    first_free: bool = False,
) -> ArmConfigurations:
    """As `scan_configurations`, for a base that drives straight in and out with the arm rigid; see `cover.drive_out`.

    Hits are those of the configuration, of the drive, and of the object `body` that is grasped or put down, moved out.
    """
    parts: list[ArmConfigurations] = []
    extents: dict[bytes, Extents] = {}
    for drive, rows in _drives(world.scene, poses):
        chosen = GripperPoses(poses.bases[rows], poses.gripper_poses[rows])
        backed_off = body.at(body.position + [*drive.offset, 0.0])
        before = objects_before(world.scene, backed_off, drive.direction) & ~ignore
        if first_free and before:
            continue
        way = drive.direction.tobytes()
        if way not in extents:
            extents[way] = Extents.of(world, drive.direction)
        driven = extents[way].driven_world(drive, body if held is None else None)
        found = scan_configurations(
            world, chosen, grid, opening, held=held, ignore=ignore, first_free=first_free, driven=driven
        )
        inside = [
            world.hits(chosen.bases[pair], q, opening, held, ignore)
            for q, pair in zip(found.q, found.pair, strict=True)
        ]
        hits = found.hits | np.array(inside, dtype=np.uint64) | np.uint64(before)
        found = found._replace(pair=rows[found.pair], hits=hits)
        if not first_free:
            parts.append(found)
        elif not hits.all():
            return ArmConfigurations(*(column[hits == 0] for column in found))
    return _joined(parts, len(world.robot.lower))


def _drives(scene: Scene, poses: GripperPoses) -> Iterator[tuple[Drive, NDArray[np.int64]]]:
    """The straight drives out after backing off, and the rows of the pairs of base and gripper pose for each."""
    yaws, directions = poses.gripper_poses[:, 3], direction_out(scene.support, poses.bases)
    ways = np.column_stack((yaws, directions)).round(_SAME_WAY)
    for way in np.unique(ways, axis=0):
        rows = np.flatnonzero((ways == way).all(axis=1))
        yaw, direction = yaws[rows[0]], directions[rows[0]]
        offset = -BACK * np.array([np.cos(yaw), np.sin(yaw)])
        starts = poses.gripper_poses[rows, :2] + offset
        farthest = max(distance_out(scene.support, start, direction) for start in starts)
        yield Drive(offset, direction, farthest, LEAST_LIFT), rows


def _joined(parts: Sequence[ArmConfigurations], joints: int) -> ArmConfigurations:
    none = ArmConfigurations(np.zeros((0, joints)), np.zeros(0, np.int64), np.zeros(0, np.uint64), np.zeros(0))
    return ArmConfigurations(*(np.concatenate(columns) for columns in zip(none, *parts, strict=True)))
