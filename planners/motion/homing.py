"""Bringing the arm home from any configuration, so that the base can drive.

A robot may start with its gripper among the objects. Then it moves straight up first.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from planners.collision.straight_lines import trace_by_torso, trace_straight
from planners.collision.world import OVERLAP, CollisionWorld
from planners.motion.approaches import SIDE_CLEARANCE
from planners.motion.arm import ROOM, ArmPath, NoPath, on_base, plan_arm, unwrap_joints
from planners.motion.arm_query import ArmQuery
from planners.scene import SELF_BIT, RobotState
from planners.scene.masks import FIXED_BITS

Array = NDArray[np.float64]

_UP = np.array([0.0, 0.0, 1.0])
_RISES = (0.25, 0.19, 0.12, 0.06)
"""[m] that the gripper moves straight up, tried in this order."""


def is_at_home(world: CollisionWorld, state: RobotState) -> bool:
    """Whether torso and arm are in the home configuration, but for whole turns."""
    return np.array_equal(state.q, unwrap_joints(world.robot, state.q, world.scene.robot.home))


def is_among_objects(world: CollisionWorld, state: RobotState) -> bool:
    """Whether the robot, away from home, is nearer than `ROOM` to something other than itself."""
    if is_at_home(world, state):
        return False
    gap, held = world.scene.robot.opening(state.finger_position), world.scene.held
    return bool(world.with_padding(ROOM).hits(state.base, state.q, gap, held, 1 << SELF_BIT))


def plan_home(world: CollisionWorld, state: RobotState, rng: np.random.Generator) -> ArmPath | NoPath:
    """A free path of torso and arm to the home configuration, on a standing base.

    Where the start is nearer to something than the world's padding, as in a grasp or after a disturbance, less padding
    will do.

    Args:
        world: the scene, compiled, with what is held.
        state: where the robot is.
        rng: for the random trees.

    Returns:
        the path, whose `opening` the gripper takes before it; or why there is none.
    """
    held, robot = world.scene.held, world.scene.robot
    gap = robot.opening(state.finger_position)
    touched, is_among = world.hits(state.base, state.q, gap, held), is_among_objects(world, state)
    opening = min(gap + 2 * SIDE_CLEARANCE, robot.max_opening) if touched and held is None else gap
    for padded in (world, world.with_padding(0.0), world.with_padding(-OVERLAP)):
        for line in sorted(_lines_up(padded, state), key=len, reverse=is_among):
            ignore = padded.hits(state.base, state.q, opening, held) & ~FIXED_BITS
            if padded.path_hits(on_base(state.base, line), opening, held, ignore):
                continue
            query = ArmQuery(state.base, opening, held)
            path = plan_arm(padded, query, line[-1], robot.home, rng=rng, find_blockers=False)
            if isinstance(path, ArmPath):
                return ArmPath(state.base, np.vstack([line[:-1], path.waypoints]), opening, held)
    return NoPath("home: no free path of the arm to its home configuration found")


def _lines_up(world: CollisionWorld, state: RobotState) -> Iterator[Array]:
    """Configurations (n, 8) from the present one: none but itself, then straight lines up."""
    yield state.q[None]
    for rise in _RISES:
        for trace in (trace_straight, trace_by_torso):
            line = trace(world, state.base, state.q, _UP, rise)
            if line is not None:
                yield line
