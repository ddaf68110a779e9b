"""Scripts that solve the goal environments: functions of the present state alone, fit to correct a learner."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clutter_env.goal_env import GoalEnv
from clutter_env.layout import TABLE_HEIGHT

__all__ = ["SCRIPTS", "Script"]

Array = NDArray[np.float64]
Script = Callable[[], tuple[str, NDArray[Any]]]
"""What to do next: the name of the skill, and the action."""

ALIGNED = (0.02, 0.01)
"""[m] from the object's axis, along the hand and across it, within which the hand may come down around it."""
AT_GRASP = 0.02
"""[m] above the grasp at which the fingers close."""
HOVER = 0.06
"""[m] above the object's top: the fingers' half height and a margin."""
GRASP_SHARE = 0.6
"""Where on the object it is held: high enough for the forearm to clear the table."""
FINGER_ROOM = 0.012
"""[m] between the object and each opened finger."""
CARRY_LIFT = 0.01
"""[m] by which an object is carried higher than its goal: it must not scrape along the table."""
GAIN, TURN_GAIN = 1.6, 1.0
"""[1/s] of the hand's velocity over its distance and angle from where it should be: with more it overshoots."""
STANDOFF = 0.75
"""[m] ahead of the base where the hand reaches well."""


def reach(env: GoalEnv) -> Script:
    """Move the TCP straight to the goal."""

    def script() -> tuple[str, NDArray[Any]]:
        goal = _goal(env)
        x, y, yaw = env.world.controller.state.target[:3]
        ahead = math.cos(yaw) * (goal[0] - x) + math.sin(yaw) * (goal[1] - y) - STANDOFF
        return "reach", _hand_action(env, goal, env.robot.max_opening, ahead)

    return script


def pick(env: GoalEnv) -> Script:
    """Come down around the object, close, carry it to the goal."""

    def script() -> tuple[str, NDArray[Any]]:
        tcp, at = _tcp(env), env.seen.poses[env.target_slot, :3]
        half_width, half_height = env.world.scene.half_extents[env.target_slot][1:]  # type: ignore[union-attr]
        opening = 2 * (half_width + FINGER_ROOM)
        if env.seen.held == env.target_slot:
            goal = _goal(env)
            return "carry", _hand_action(env, goal + (tcp - at) + (0, 0, CARRY_LIFT), 0.0)
        height = max(env.robot.grasp_height, GRASP_SHARE * 2 * half_height)
        grasp = np.array([at[0], at[1], TABLE_HEIGHT + height])
        above = at[2] + half_height + HOVER
        if _is_aligned(env, tcp, grasp):
            if tcp[2] - grasp[2] < AT_GRASP:
                return "close", _hand_action(env, grasp, 0.0)
            return "descend", _hand_action(env, grasp, opening)
        if tcp[2] < above - 0.02:
            return "rise", _hand_action(env, np.array([*tcp[:2], above]), opening)
        return "align", _hand_action(env, np.array([*grasp[:2], above]), opening)

    return script


SCRIPTS: Mapping[str, Callable[[Any], Script]] = MappingProxyType({"reach": reach, "pick": pick})
"""By family of environments; all need control_mode="ee"."""


def _tcp(env: GoalEnv) -> Array:
    return np.array(env.data.site_xpos[env.world.index.tcp_site])


def _goal(env: GoalEnv) -> Array:
    return np.array(env._goal)


def _is_aligned(env: GoalEnv, tcp: Array, grasp: Array) -> bool:
    """Whether the object is between the fingers as seen from above."""
    hand = env.data.site_xmat[env.world.index.tcp_site].reshape(3, 3)
    ahead, across, _ = hand.T @ (grasp - tcp)
    return abs(float(ahead)) < ALIGNED[0] and abs(float(across)) < ALIGNED[1]


def _hand_action(env: GoalEnv, point: Array, width: float, ahead: float = 0.0) -> NDArray[Any]:
    """The action that moves the hand, level and along the base's heading, towards a point (3,).

    Velocities in proportion to what is seen to be left, so that the same state always gives the same action.

    Args:
        env: where.
        point: [m] in the world.
        width: of the gripper [m].
        ahead: [m] by which the base should drive forward.
    """
    yaw = float(env.world.controller.state.target[2])
    cosine, sine = math.cos(yaw), math.sin(yaw)
    R_base_world = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    R_base_tcp = R_base_world @ env.data.site_xmat[env.world.index.tcp_site].reshape(3, 3)
    linear = GAIN * (R_base_world @ (point - _tcp(env))) / env.robot.max_tcp_velocity[0]
    angular = TURN_GAIN * _level_error(R_base_tcp) / env.robot.max_tcp_velocity[1]
    linear /= max(1.0, float(np.abs(linear).max()))
    drive = GAIN * ahead / env.robot.max_velocity[0]
    grip = env.world.controller.grip_action(width)
    return np.clip(np.concatenate(((drive, 0.0, 0.0), linear, angular, (grip,))), -1.0, 1.0)


def _level_error(R_base_tcp: Array) -> Array:
    """Rotation vector (3,) that turns the hand level and straight ahead, for small angles."""
    x_axis, z_axis = R_base_tcp[:, 0], R_base_tcp[:, 2]
    return 0.5 * (np.cross(x_axis, (1.0, 0.0, 0.0)) + np.cross(z_axis, (0.0, 0.0, 1.0)))
