"""Scripts for the goal environments and simple retrievals: functions of the present state, fit to correct a learner."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clutter_env.envs.base import BaseEnv
from clutter_env.envs.goal import GoalEnv
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.scene.layout import TABLE_HEIGHT

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
HAND_AHEAD, HAND_SIDE = (0.65, 0.97), 0.15
"""[m] from the base where the hand may be on its way to the target."""
FUNNEL = 4.0
"""By how much higher the hand stays for what it or the base is off."""
APPROACH = 0.06
"""[m], [rad] off for the base from which the hand begins to sink."""
SINK = 0.04
"""[m] below its height at which the hand stops moving sideways."""
LIFT = 0.01
"""[m] by which an object is carried higher than its goal: it must not scrape along the table."""
GAIN, TURN_GAIN = 1.6, 1.0
"""[1/s] of the hand's velocity over its distance and angle from where it should be: with more it overshoots."""
STANDOFF = 0.75
"""[m] ahead of the base where the hand reaches well."""
READY_HEIGHT = 1.10
"""[m] of the hand while the base drives: above all objects."""
AT_STAND = 0.03
"""[m], [rad] from where the base should stand at which the hand comes down."""
LIFT = 0.15
"""[m] ahead of the hand while it lifts."""


def reach(env: GoalEnv) -> Script:
    """Move the TCP straight to the goal."""

    def script() -> tuple[str, NDArray[Any]]:
        goal = _goal(env)
        x, y, yaw = env.world.controller.state.target[:3]
        ahead = math.cos(yaw) * (goal[0] - x) + math.sin(yaw) * (goal[1] - y) - STANDOFF
        return "reach", _action(env, goal, env.robot.max_opening, (ahead, 0.0, 0.0))

    return script


def pick(env: GoalEnv) -> Script:
    """Come down around the object, close, carry it to the goal."""

    def script() -> tuple[str, NDArray[Any]]:
        if env.measurements.held == env.target_slot:
            above = _goal(env) - env.measurements.poses[env.target_slot, :3] + (0, 0, CARRY_LIFT)
            return "carry", _action(env, _tcp(env) + above, 0.0)
        skill, point, width = _grasp(env)
        return skill, _action(env, point, width)

    return script


def front(env: RetrieveEnv) -> Script:
    """Drive up to the table before the target, come down around it, close, lift; what stands beside it is ignored.

    Nothing but the last two steps begins at a threshold: the hand sinks as far as base and hand are where they should
    be. A clone of a script that switches stands still at the switch, where it has seen both answers.
    """

    def script() -> tuple[str, NDArray[Any]]:
        if env.measurements.held == env.target_slot:
            return "lift", _action(env, _tcp(env) + (0, 0, LIFT), 0.0)
        way = _way_to_stand(env)
        grasp, above, opening = _target_grasp(env)
        tcp = _tcp(env)
        off_hand, off_base = _off_axis(env, tcp, grasp), math.hypot(*way)
        height = min(grasp[2] + FUNNEL * off_hand, above) + FUNNEL * min(off_base, APPROACH)
        point = np.array([*_within_reach(env, grasp), height])
        point[:2] = tcp[:2] + (point[:2] - tcp[:2]) * np.clip(1 - (height - tcp[2]) / SINK, 0.0, 1.0)
        if off_hand == 0 and tcp[2] - grasp[2] < AT_GRASP:
            return "close", _action(env, grasp, 0.0, way)
        return ("drive" if off_base > APPROACH else "descend"), _action(env, point, opening, way)

    return script


SCRIPTS: Mapping[str, Callable[[Any], Script]] = MappingProxyType({"reach": reach, "pick": pick, "front": front})
"""For the environments Reach, Pick and Retrieve; all need control_mode="ee"."""


def _tcp(env: BaseEnv) -> Array:
    return np.array(env.data.site_xpos[env.world.index.tcp_site])


def _goal(env: GoalEnv) -> Array:
    return np.array(env._goal)


def _base(env: BaseEnv) -> Array:
    """x, y, yaw of the base."""
    return np.array(env.data.qpos[env.world.index.drive_qpos[:3]])


def _way_to_stand(env: BaseEnv) -> Array:
    """What is left (3,), ahead, to the left, to turn, to where the base faces the table with the target in reach."""
    target = env.measurements.poses[env.target_slot, :2]
    nearest = -env.layout.depth / 2 - env.robot.base_radius
    x, y, yaw = _base(env)
    to_x, to_y = min(target[0] - STANDOFF, nearest) - x, target[1] - y
    cosine, sine = math.cos(yaw), math.sin(yaw)
    return np.array([cosine * to_x + sine * to_y, cosine * to_y - sine * to_x, -yaw])


def _within_reach(env: BaseEnv, point: Array) -> Array:
    """The place (2,) nearest to a point that the hand can comfortably be at, given where the base is."""
    x, y, yaw = _base(env)
    cosine, sine = math.cos(yaw), math.sin(yaw)
    to_x, to_y = point[0] - x, point[1] - y
    ahead = float(np.clip(cosine * to_x + sine * to_y, *HAND_AHEAD))
    left = float(np.clip(cosine * to_y - sine * to_x, -HAND_SIDE, HAND_SIDE))
    return np.array([x + cosine * ahead - sine * left, y + sine * ahead + cosine * left])


def _target_grasp(env: BaseEnv) -> tuple[Array, float, float]:
    """Where the hand holds the target (3,), the height [m] from which it can come down, the gripper's width then."""
    assert env.world.scene is not None
    at = env.measurements.poses[env.target_slot, :3]
    half_width, half_height = env.world.scene.half_extents[env.target_slot][1:]
    height = max(env.robot.grasp_height, GRASP_SHARE * 2 * half_height)
    return np.array([at[0], at[1], TABLE_HEIGHT + height]), at[2] + half_height + HOVER, 2 * (half_width + FINGER_ROOM)


def _grasp(env: BaseEnv) -> tuple[str, Array, float]:
    """How to go on towards holding the target: the skill, where the hand should go (3,), and the gripper's width."""
    tcp = _tcp(env)
    grasp, above, opening = _target_grasp(env)
    if _off_axis(env, tcp, grasp) == 0:
        return ("close", grasp, 0.0) if tcp[2] - grasp[2] < AT_GRASP else ("descend", grasp, opening)
    if tcp[2] < above - 0.02:
        return "rise", np.array([*tcp[:2], above]), opening
    return "align", np.array([*grasp[:2], above]), opening


def _off_axis(env: BaseEnv, tcp: Array, grasp: Array) -> float:
    """[m] by which the object is not between the fingers as seen from above; 0 if it is."""
    hand = env.data.site_xmat[env.world.index.tcp_site].reshape(3, 3)
    ahead, across, _ = hand.T @ (grasp - tcp)
    return max(abs(float(ahead)) - ALIGNED[0], abs(float(across)) - ALIGNED[1], 0.0)


def _action(env: BaseEnv, point: Array, width: float, way: ArrayLike = (0.0, 0.0, 0.0)) -> NDArray[Any]:
    """The action that moves the hand, level and along the base's heading, towards a point, and drives the base.

    Velocities in proportion to what is seen to be left, so that the same state always gives the same action.

    Args:
        env: where.
        point: (3,) [m] in the world.
        width: of the gripper [m].
        way: (3,) of the base: ahead, to the left [m], turning [rad].
    """
    yaw = float(env.world.controller.state.target[2])
    cosine, sine = math.cos(yaw), math.sin(yaw)
    R_base_world = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    R_base_tcp = R_base_world @ env.data.site_xmat[env.world.index.tcp_site].reshape(3, 3)
    linear = GAIN * (R_base_world @ (point - _tcp(env))) / env.robot.max_tcp_velocity[0]
    angular = TURN_GAIN * _level_error(R_base_tcp) / env.robot.max_tcp_velocity[1]
    linear /= max(1.0, float(np.abs(linear).max()))
    drive = GAIN * np.asarray(way) / np.array(env.robot.max_velocity[:3])
    grip = env.world.controller.grip_action(width)
    return np.clip(np.concatenate((drive, linear, angular, (grip,))), -1.0, 1.0)


def _level_error(R_base_tcp: Array) -> Array:
    """Rotation vector (3,) that turns the hand level and straight ahead, for small angles."""
    x_axis, z_axis = R_base_tcp[:, 0], R_base_tcp[:, 2]
    return 0.5 * (np.cross(x_axis, (1.0, 0.0, 0.0)) + np.cross(z_axis, (0.0, 0.0, 1.0)))
