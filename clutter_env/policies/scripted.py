"""Scripts: experts whose action is a function of the present state, so that it can be cloned and can correct a learner.

They command the velocity of the gripper (`control_mode="ee"`), and know the exact poses of all objects.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from assets import RobotSpec
from clutter_env.envs.arm import GOAL_RANGE, ArmEnv
from clutter_env.envs.arm_retrieve import LOWEST, ArmRetrieveEnv
from clutter_env.envs.base import BaseEnv
from clutter_env.envs.from_above import TIP, Standing
from clutter_env.envs.goal import GoalEnv
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.scene.layout import TABLE_HEIGHT

Array = NDArray[np.float64]
Step = tuple[str, NDArray[Any]]
"""Name of the skill, and the action."""

ALIGNED = (0.02, 0.01)
"""[m] between TCP and object, along the gripper's axis and across it, within which the gripper may descend."""
AT_GRASP = 0.02
"""[m] above the grasp at which the fingers close."""
HOVER = 0.06
"""[m] of the TCP above the object's top before the descent: half the height of the fingers, and a margin."""
NEAR_HOVER = 0.02
"""[m] below that height from which the gripper moves sideways too."""
GRASP_SHARE = 0.6
"""Height of the grasp as a share of the object's height: high enough for the forearm to clear the table."""
FINGER_ROOM = 0.012
"""[m] between the object and each opened finger."""
CARRY_LIFT = 0.01
"""[m] by which an object is carried higher than its goal, so that it does not scrape along the table."""
GAIN, TURN_GAIN = 1.6, 1.0
"""[1/s] Velocity of the gripper divided by its remaining distance, and by its remaining angle. Larger gains
overshoot."""
STANDOFF = 0.75
"""[m] ahead of the base, where the arm reaches well."""
REACH_AHEAD, REACH_SIDE = (0.65, 0.97), 0.15
"""[m] Region ahead of the base, and to each side, in which the TCP moves to the target."""
FUNNEL = 4.0
"""Height [m] that the TCP keeps for each metre of remaining distance of gripper or base."""
APPROACH = 0.06
"""[m], [rad] Remaining motion of the base below which the gripper begins to descend."""
STEER_HEIGHT = 0.04
"""[m] below its commanded height at which the gripper stops moving sideways."""
LIFT = 0.15
"""[m] of the commanded TCP above its present height while the target is lifted."""

FULL_SPEED_GAIN = 20.0
"""[1/s] As `GAIN`, for a gripper that moves at its greatest speed until it is 2 cm from its goal."""
CHARGE_FROM = 0.10
"""[m] before the table's front edge: where the gripper waits until it is in line with the target."""
IN_LINE = 0.02
"""[m] from the line to the target, across and up, within which the gripper charges."""

OVER_TOPS, OVER_OTHERS = 0.04, 0.02
"""[m] of the TCP, and of the bottom of the held object, above the tops of the objects while it moves over them."""
STEEP, NARROW, WIDE = 8.0, 0.006, 0.016
"""Height [m] kept per metre of horizontal distance to the point of descent. Distances [m] below which no height is
kept, before and after the gripper surrounds the object."""
SLOW = 0.2
"""[m/s] across, above which it must be exactly over the object to go down around it."""
BRAKED, SLOWEST = 0.5, 0.01
"""Share of the remaining descent commanded in a step, and its minimum [m], so that the gripper arrives without a
blow."""
AT_TOP = 0.012
"""[m] above the grasp from above at which the fingers close."""
PLACE_STEP, PLACE_BEYOND = 0.02, 0.06
"""[m] between the places where an object may be put aside, and by which they reach beyond where objects stand."""
PLACE_GAPS, PUT_DOWN, AT_PLACE = (0.02, 0.012), 0.012, 0.08
"""[m] Gaps between such a place and its neighbours, preferred and least. Height above the table at which an object is
released. Height from which the object is lowered in any case."""


def reach(env: GoalEnv) -> Step:
    """Move the TCP straight to the goal."""
    goal = env.goal
    x, y, yaw = env.world.controller.state.target[:3]
    ahead = math.cos(yaw) * (goal[0] - x) + math.sin(yaw) * (goal[1] - y) - STANDOFF
    return "reach", _action(env, goal, env.robot.max_opening, (ahead, 0.0, 0.0))


def pick(env: GoalEnv) -> Step:
    """Descend around the object, close the fingers, carry the object to the goal."""
    if env.measurements.held == env.target_slot:
        remaining = env.goal - env.measurements.poses[env.target_slot, :3] + (0, 0, CARRY_LIFT)
        return "carry", _action(env, _tcp(env) + remaining, 0.0)
    tcp = _tcp(env)
    grasp, above, opening = _target_grasp(env)
    if _off_axis(env, tcp, grasp) == 0:
        if tcp[2] - grasp[2] < AT_GRASP:
            return "close", _action(env, grasp, 0.0)
        return "descend", _action(env, grasp, opening)
    if tcp[2] < above - NEAR_HOVER:
        return "rise", _action(env, np.array([*tcp[:2], above]), opening)
    return "align", _action(env, np.array([*grasp[:2], above]), opening)


def retrieve(env: RetrieveEnv) -> Step:
    """Drive to the table in front of the target, descend around it, close the fingers, lift. Other objects are ignored.

    Only the last two steps begin at a threshold. Before them the height of the gripper falls continuously with the
    remaining distance of base and gripper. The clone of a script that switches would stop at the switch, because the
    examples at this point contain both actions.
    """
    if env.measurements.held == env.target_slot:
        return "lift", _action(env, _tcp(env) + (0, 0, LIFT), 0.0)
    drive = _remaining_drive(env)
    grasp, above, opening = _target_grasp(env)
    tcp = _tcp(env)
    tcp_error, base_error = _off_axis(env, tcp, grasp), math.hypot(*drive)
    height = min(grasp[2] + FUNNEL * tcp_error, above) + FUNNEL * min(base_error, APPROACH)
    point = np.array([*_within_reach(env, grasp), height])
    point[:2] = tcp[:2] + (point[:2] - tcp[:2]) * np.clip(1 - (height - tcp[2]) / STEER_HEIGHT, 0.0, 1.0)
    if tcp_error == 0 and tcp[2] - grasp[2] < AT_GRASP:
        return "close", _action(env, grasp, 0.0, drive)
    return ("drive" if base_error > APPROACH else "descend"), _action(env, point, opening, drive)


def direct_approach(env: RetrieveEnv) -> Step:
    """Line up before the table at the height of the grasp, charge straight at the target, close the fingers, lift.

    Whatever stands in between is pushed aside or toppled, at full speed.
    """
    tcp = _tcp(env)
    if env.measurements.held == env.target_slot:
        return "lift", _action(env, tcp + (0, 0, LIFT), 0.0)
    grasp, _, opening = _target_grasp(env)
    drive = _remaining_drive(env)
    if _off_axis(env, tcp, grasp) == 0:
        return "close", _action(env, grasp, 0.0)
    start = -env.layout.depth / 2 - CHARGE_FROM
    if tcp[0] < start + IN_LINE and np.abs(tcp - grasp)[1:].max() > IN_LINE:
        drive[0] = min(drive[0], start - STANDOFF - _base(env)[0])
        return "line up", _action(env, np.array([start, *grasp[1:]]), opening, drive, FULL_SPEED_GAIN)
    return "charge", _action(env, grasp, opening, drive, FULL_SPEED_GAIN)


def arm_reach(env: ArmEnv) -> Step:
    """Move the TCP straight to the goal."""
    return "reach", env.arm_action(env.goal, env.robot.max_opening)


def arm_pick(env: ArmEnv) -> Step:
    """Descend around the object, close the fingers, carry the object to the goal."""
    tcp, at, opening = env.tcp, env.measurements.poses[0, :3] - env.origin, env.robot.max_opening
    if env.measurements.held == 0:
        remaining = env.goal - at
        is_near = math.hypot(*remaining[:2]) < IN_LINE
        return "carry", env.arm_action(tcp + remaining + (0, 0, 0.0 if is_near else 2 * CARRY_LIFT), 0.0)
    hover = float(env.world.scene.half_extents[0, 2]) + HOVER
    above, off_axis = float(tcp[2] - at[2]), math.hypot(*(tcp - at)[:2])
    if off_axis > (ALIGNED[1] if above > hover - NEAR_HOVER else ALIGNED[0]):
        return "align", env.arm_action(at + (0, 0, hover), opening)
    return ("close", env.arm_action(at, 0.0)) if above < AT_GRASP else ("descend", env.arm_action(at, opening))


def arm_retrieve(env: ArmRetrieveEnv) -> Step:
    """Put aside objects in the way of the target, take the target from above, lift it."""
    tcp, held, target = env.tcp, env.measurements.held, env.target_slot
    if held == target:
        return "lift", env.arm_action(tcp + (0, 0, LIFT), 0.0)
    wanted = (env.in_the_way or [target])[0]
    if held == wanted:
        return _put_aside(env, held)
    standing, origin = env.standing(), env.origin
    opening = 2 * (float(standing.half_widths[wanted]) + FINGER_ROOM)
    above_table = TABLE_HEIGHT - float(origin[2])
    height = above_table + standing.grasp_height(wanted, LOWEST)
    to_x, to_y = standing.centres[wanted] - origin[:2] - tcp[:2]
    over = above_table + float(standing.tops.max()) + OVER_TOPS
    slack = WIDE if tcp[2] - TIP < above_table + standing.tops[wanted] else NARROW
    if math.hypot(to_x, to_y) < WIDE and tcp[2] - height < AT_TOP:
        return "close", env.arm_action(tcp + (to_x, to_y, height - tcp[2]), 0.0)
    return "approach", _down_a_funnel(env, np.array([to_x, to_y]), tcp[2], height, over, opening, slack)


def _put_aside(env: ArmRetrieveEnv, held: int) -> Step:
    """Carry the held object over the others to a free place, lower it, release it."""
    standing, at = env.standing(), env.measurements.poses[held, :3]
    raised = env.world.lowest_point(env.measurements, held) - TABLE_HEIGHT
    away = free_place(env, held) - at[:2]
    if raised < PUT_DOWN and math.hypot(*away) < WIDE:
        return "open", env.arm_action(env.tcp, 2 * (float(standing.half_widths[held]) + FINGER_ROOM))
    over = float(np.delete(standing.tops, held).max()) + OVER_OTHERS
    return "put aside", _down_a_funnel(
        env, away, raised, PUT_DOWN / 2, over, 0.0, WIDE if raised < AT_PLACE else NARROW
    )


def _down_a_funnel(
    env: ArmRetrieveEnv, away: Array, height: float, end: float, over: float, opening: float, slack: float
) -> NDArray[Any]:
    """The action that brings the gripper down to a point, high where it is far away, and first up where it is low.

    Args:
        env: the environment.
        away: (2,) [m] to the point, in the plane.
        height: [m] of the gripper, or of the held object.
        end: [m] at the point.
        over: [m] at which it passes over the objects.
        opening: [m] of the gripper.
        slack: [m] `NARROW` or `WIDE`.
    """
    is_slow = math.hypot(*env.tcp_velocity[:2]) < SLOW
    distance = math.hypot(*away) - (slack if is_slow or slack == WIDE else 0.0)
    wanted = min(end + STEEP * max(distance, 0.0), over)
    share = min(max(1.0 - (wanted - height) / STEER_HEIGHT, 0.0), 1.0)
    fastest = max(BRAKED * (height - end), SLOWEST)
    return env.arm_action(env.tcp + (*(away * share), max(wanted - height, -fastest)), opening)


def free_place(env: ArmRetrieveEnv, held: int) -> Array:
    """Free place (2,) [m] of a grid that is nearest to the target, clear of its grasp and of the other objects.

    The held object's present position is ignored, so that the place stays the same while the object is carried.
    """
    target = env.standing().centres[env.target_slot]
    half = np.add(GOAL_RANGE[:2], PLACE_BEYOND)
    grid = np.stack(np.meshgrid(*(np.arange(-size, size + 1e-9, PLACE_STEP) for size in half), indexing="ij"), axis=-1)
    places = env.origin[:2] + grid.reshape(-1, 2)
    nearest = places[np.argsort(np.hypot(*(places - target).T), kind="stable")]
    free = (place for gap in PLACE_GAPS for place in nearest if _is_free(env, held, place, gap))
    return np.asarray(next(free, env.standing().centres[held]))


def _is_free(env: ArmRetrieveEnv, held: int, place: Array, gap: float) -> bool:
    """Whether the held object can be released at a place: this far [m] from the others and from the target's grasp."""
    standing, centres = env.standing(), env.standing().centres.copy()
    centres[held] = place
    there = Standing(centres, standing.half_widths, standing.tops)
    gaps = np.hypot(*(centres - place).T) - standing.half_widths - standing.half_widths[held]
    gaps[held] = math.inf
    is_apart = gaps.min() > gap and there.gap(env.target_slot, held) > gap
    return bool(is_apart) and not there.in_the_way(held, LOWEST)


SCRIPTS: Mapping[str, Callable[[Any], Step]] = MappingProxyType(
    {
        "reach": reach,
        "pick": pick,
        "armreach": arm_reach,
        "armpick": arm_pick,
        "armretrieve": arm_retrieve,
        "scripted": retrieve,
    }
)
"""The scripts for the goal environments and Retrieve, by name. Each gives the next step in an environment."""


def _tcp(env: BaseEnv) -> Array:
    return np.array(env.data.site_xpos[env.world.index.tcp_site])


def _base(env: BaseEnv) -> Array:
    """x [m], y [m], yaw [rad] of the base."""
    return np.array(env.data.qpos[env.world.index.drive_qpos[:3]])


def _remaining_drive(env: BaseEnv) -> Array:
    """Remaining motion (3,) of the base to where the arm reaches the target: ahead [m], left [m], turning [rad]."""
    target = env.measurements.poses[env.target_slot, :2]
    nearest = -env.layout.depth / 2 - env.robot.base_radius
    x, y, yaw = _base(env)
    to_x, to_y = min(target[0] - STANDOFF, nearest) - x, target[1] - y
    cosine, sine = math.cos(yaw), math.sin(yaw)
    return np.array([cosine * to_x + sine * to_y, cosine * to_y - sine * to_x, -yaw])


def _within_reach(env: BaseEnv, point: Array) -> Array:
    """The point (2,) nearest to a point (2+,) within `REACH_AHEAD` and `REACH_SIDE` of the base."""
    x, y, yaw = _base(env)
    cosine, sine = math.cos(yaw), math.sin(yaw)
    to_x, to_y = point[0] - x, point[1] - y
    ahead = float(np.clip(cosine * to_x + sine * to_y, *REACH_AHEAD))
    left = float(np.clip(cosine * to_y - sine * to_x, -REACH_SIDE, REACH_SIDE))
    return np.array([x + cosine * ahead - sine * left, y + sine * ahead + cosine * left])


def grasp_height(robot: RobotSpec, half_height: ArrayLike) -> Array:
    """(...) [m] of the TCP above the table at the grasp of objects with these half heights (...) [m]."""
    return np.maximum(robot.grasp_height, GRASP_SHARE * 2 * np.asarray(half_height))


def _target_grasp(env: BaseEnv) -> tuple[Array, float, float]:
    """TCP position (3,) [m] of the grasp, height [m] from which the gripper descends, opening [m] of the gripper."""
    at = env.measurements.poses[env.target_slot, :3]
    half_width, half_height = env.world.scene.half_extents[env.target_slot][1:]
    height = grasp_height(env.robot, half_height)
    return np.array([at[0], at[1], TABLE_HEIGHT + height]), at[2] + half_height + HOVER, 2 * (half_width + FINGER_ROOM)


def _off_axis(env: BaseEnv, tcp: Array, grasp: Array) -> float:
    """Horizontal distance [m] of the object from the space between the fingers, 0 inside."""
    R_world_tcp = env.data.site_xmat[env.world.index.tcp_site].reshape(3, 3)
    ahead, across, _ = R_world_tcp.T @ (grasp - tcp)
    return max(abs(float(ahead)) - ALIGNED[0], abs(float(across)) - ALIGNED[1], 0.0)


def _action(
    env: BaseEnv, point: Array, opening: float, drive: ArrayLike = (0.0, 0.0, 0.0), gain: float = GAIN
) -> NDArray[Any]:
    """The action that moves the TCP towards a point, keeps the gripper level and straight ahead, and drives the base.

    Velocities are proportional to the remaining distances, so that the same state always gives the same action.

    Args:
        env: the environment.
        point: (3,) [m] in the world.
        opening: of the gripper [m].
        drive: remaining motion (3,) of the base: ahead [m], to the left [m], turning [rad].
        gain: [1/s] velocity of the gripper divided by its remaining distance.
    """
    yaw = float(env.world.controller.state.target[2])
    cosine, sine = math.cos(yaw), math.sin(yaw)
    R_base_world = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    R_base_tcp = R_base_world @ env.data.site_xmat[env.world.index.tcp_site].reshape(3, 3)
    linear = gain * (R_base_world @ (point - _tcp(env))) / env.robot.max_tcp_velocity[0]
    # The rotation vector [rad] that turns the gripper level and straight ahead, for small angles.
    error = 0.5 * (np.cross(R_base_tcp[:, 0], (1.0, 0.0, 0.0)) + np.cross(R_base_tcp[:, 2], (0.0, 0.0, 1.0)))
    angular = TURN_GAIN * error / env.robot.max_tcp_velocity[1]
    linear /= max(1.0, float(np.abs(linear).max()))
    base = GAIN * np.asarray(drive) / np.array(env.robot.max_velocity[:3])
    grip = env.world.controller.grip_action(opening)
    return np.clip(np.concatenate((base, linear, angular, (grip,))), -1.0, 1.0)
