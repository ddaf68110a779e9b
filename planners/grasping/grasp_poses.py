"""Grasp poses around an object, by families (Lee & Kim 2019, section 3.3, Figs. 5 and 6)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.collision.scene_arrays import robot_arrays
from planners.grasping.antipodal import antipodal_lines, highest_line, lowest_line
from planners.grasping.arm_configurations import gripper_arrays, gripper_rotation
from planners.grasping.families import GRASP_SETS, AntipodalFamily, Family, GraspFamily, families_for
from planners.scene import Body, HeldObject, Opening, Scene
from planners.scene.bodies import pose_matrix

_PALM_CLEARANCE, _PALM_SIDE, _TIP_CLEARANCE, _PAD_CLEARANCE = 0.003, 0.002, 0.0045, 0.0045
"""[m] that are kept before the palm, below the palm, beyond the fingertips and at the upper edge of the pads."""
_SAME = 1e-6
"""[m] by which the fronts of finger tips may differ."""
_DECIMALS = 6
Array: TypeAlias = NDArray[np.float64]
_STRAIGHT_DOWN = 1e-6
"""Cosine of a pitch below which the gripper points straight down, and sine below which it is level."""


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

    @property
    def fingertips(self) -> float:
        """[m] that the fingers extend beyond the TCP."""
        return self.fingertip_reach - _TIP_CLEARANCE

    def above_support(self, pitch: float) -> float:
        """[m] of the TCP above the support at least, for fingertips and palm at a pitch [rad] to stay clear of it."""
        down, level = math.sin(pitch), math.cos(pitch)
        fingertips = self.fingertip_reach * down + self.pad_half_height * level
        return max(fingertips, self.palm_height * level - self.palm_reach * down)


@cache
def gripper_clearances(robot: RobotSpec) -> GripperClearances:
    """The lengths of a robot's gripper: of its finger tips, and of the palm, the foremost solid between them."""
    arrays = gripper_arrays(robot_arrays(robot))  # in the TCP frame
    centre, extent = arrays.position, np.einsum("kij,kj->ki", np.abs(arrays.rotation), arrays.half)
    extent += arrays.radius[:, None]
    front = centre[:, 0] + extent[:, 0]
    fingers = np.flatnonzero(arrays.slides & (front >= front[arrays.slides].max() - _SAME))
    others = np.flatnonzero(~arrays.slides & (np.abs(centre[:, 1]) <= extent[:, 1]))  # not beside the fingers
    palm = others[front[others].argmax()]
    pad = float(extent[fingers, 2].max())
    lengths = (
        -float(front[palm]) - _PALM_CLEARANCE,
        float(abs(centre[palm, 2]) + extent[palm, 2]) + _PALM_SIDE,
        float(front[fingers].max()) + _TIP_CLEARANCE,
        pad,
        pad + _PAD_CLEARANCE,
    )
    return GripperClearances(*(round(length, _DECIMALS) for length in lengths))


@dataclass(frozen=True, eq=False)
class GraspPose:
    """A gripper pose around one object where it is now.

    Attributes:
        yaw: [rad] about the vertical.
        pitch: [rad] of the approach below the horizontal.
        T_world_tcp: (4, 4), Rz(yaw) Ry(pitch) and position; read-only.
        opening: [m] between the finger pads before they close.
    """

    yaw: float
    pitch: float
    T_world_tcp: Array
    opening: float

    def __post_init__(self) -> None:
        self.T_world_tcp.setflags(write=False)


def generate_grasps(
    body: Body, robot: RobotSpec, families: Sequence[Family] = GRASP_SETS["side"]
) -> tuple[GraspPose, ...]:
    """All grasps of an object, of those families by which it is grasped, that fit between the fingers.

    A cylinder that stands is grasped from all directions of a family, a box across the faces that the fingers can span
    (section 3.3, Figs. 5 and 6). δ (TCP above the object's lowest point) and ε (TCP short of its main axis) are adapted
    to objects too low or too long for palm and fingertips. For objects of several pieces see `AntipodalFamily`.
    """
    return tuple(grasp for family in families_for(body, families) for grasp in _of_family(body, robot, family))


@lru_cache(maxsize=256)
def _of_family(body: Body, robot: RobotSpec, family: Family) -> tuple[GraspPose, ...]:
    # The same is asked for bounds, grasps and put-downs of an object.
    of_kind = _antipodal(body, robot, family) if isinstance(family, AntipodalFamily) else _centred(body, robot, family)
    return tuple(of_kind)


def _centred(body: Body, robot: RobotSpec, family: GraspFamily) -> Iterator[GraspPose]:
    for yaw, half in zip(*_yaws(body, family), strict=True):
        if 2 * half < _widest(robot, family):
            pose = _pose(body, robot, family, yaw)
            yield GraspPose(float(yaw), family.pitch, pose, gripper_opening(robot, half))


def _antipodal(body: Body, robot: RobotSpec, family: AntipodalFamily) -> Iterator[GraspPose]:
    gripper, widest = gripper_clearances(robot), _widest(robot, family)
    lowest = -math.inf if family.hangs else gripper.above_support(family.pitch)
    pad, reach = gripper.pad_half_height, gripper.fingertips
    for yaw, position, width in antipodal_lines(body, robot, family, lowest, widest, pad, reach):
        T = pose_matrix(position, gripper_rotation(yaw, family.pitch))
        yield GraspPose(yaw, family.pitch, T, gripper_opening(robot, width / 2))


def too_wide(body: Body, robot: RobotSpec, families: Sequence[Family]) -> str:
    """Why no grasp of some families fits around an object, "" if one does."""
    chosen = families_for(body, families)
    if not chosen:
        if body.shape != "pieces":
            return f"no family of grasps is for {body.name}, a {body.shape}"
        return f"{body.name} consists of several pieces, and no family of grasps is an AntipodalFamily"
    widest = max(_widest(robot, family) for family in chosen)
    span = f"{1000 * widest:.0f} mm"
    most = f"the families of grasps take {span} at most" if widest < robot.max_opening else f"the gripper opens {span}"
    centred = [family for family in chosen if isinstance(family, GraspFamily)]
    if not centred:
        if generate_grasps(body, robot, families):
            return ""
        lines = [family for family in chosen if isinstance(family, AntipodalFamily)]
        if any(one.hangs for one in lines):
            return f"the gripper gets around no two opposite faces of {body.name} within the friction cones; {most}"
        gripper, highest = gripper_clearances(robot), highest_line(body)
        heights = ((gripper.above_support(one.pitch), one.pitch) for one in lines)
        needed = min(lowest_line(lowest, pitch, gripper.fingertips) for lowest, pitch in heights)
        if highest < needed:
            return (
                f"{body.name} is too low: the pads could hold it up to {1000 * highest:.0f} mm above what it stands "
                f"on, and the fingertips need {1000 * needed:.0f} mm there; {most}"
            )
        faces = f"the gripper gets around no two opposite faces of {body.name} within the friction cones"
        return f"{faces}; {most}"
    spans = [(2 * float(half), _widest(robot, family)) for family in centred for half in _yaws(body, family)[1]]
    if any(width < limit for width, limit in spans):
        return ""
    return f"{body.name} is {1000 * min(spans)[0]:.0f} mm wide, and {most}"


def _widest(robot: RobotSpec, family: Family) -> float:
    """[m] Objects are grasped by the family if they are less wide."""
    return robot.max_opening if family.max_width is None else min(family.max_width, robot.max_opening)


def even_yaws(count: int) -> Array:
    """Yaws (count,) [rad] in (-π, π], evenly about the vertical: those from which round objects are grasped."""
    return wrap_to_pi(np.linspace(0.0, 2 * math.pi, count, endpoint=False))


def gripper_opening(robot: RobotSpec, half_span: float) -> float:
    """Opening [m] with which to approach an object that is 2 `half_span` wide between the fingers."""
    return min(2 * (float(half_span) + robot.finger_gap), robot.max_opening)


def opening_around(robot: RobotSpec, body: Body, held: HeldObject) -> float:
    """Opening [m] with which to let go of an object as it is held, or to close on it so."""
    pieces = body.shape == "pieces"
    return gripper_opening(robot, body.width_in_gripper(held.T_tcp_object) / 2 if pieces else body.half_width)


def _yaws(body: Body, family: GraspFamily) -> tuple[Array, Array]:
    """Yaws [rad] from which the object can be grasped, and its half width [m] between the fingers at each: (n,), (n,).

    The fingers close along the horizontal normal of the approach. Straight down, half a turn makes no difference
    unless the object is grasped beside its axis.
    """
    if body.shape == "cylinder" and body.is_upright:
        yaws = even_yaws(family.directions)
        half_spans = np.full(len(yaws), body.half_width)
    else:
        rotation = body.rotation
        level_axes = np.delete(np.arange(3), np.abs(rotation[2]).argmax())
        if body.shape == "cylinder":
            level_axes = np.array([2])
        headings: Array = np.arctan2(rotation[1, level_axes], rotation[0, level_axes])
        yaws = wrap_to_pi(np.concatenate((headings, headings + math.pi)))
        across = np.stack((-np.sin(yaws), np.cos(yaws), np.zeros(len(yaws))), axis=-1)
        half_spans = np.array([body.half_extent_along(direction) for direction in across])
    if family.yaws is not None:
        low, high = family.yaws
        kept = (yaws >= low) & (yaws <= high)
        return yaws[kept], half_spans[kept]
    is_symmetric = math.cos(family.pitch) < _STRAIGHT_DOWN and not family.axis_offset
    count = len(yaws) // 2 if is_symmetric else len(yaws)
    return yaws[:count], half_spans[:count]


def _pose(body: Body, robot: RobotSpec, family: GraspFamily, yaw: float) -> Array:
    """T_world_tcp (4, 4) of the grasp from one direction."""
    gripper, down, level = gripper_clearances(robot), math.sin(family.pitch), math.cos(family.pitch)
    heading = np.array((math.cos(yaw), math.sin(yaw), 0.0))
    approach = level * heading - np.array((0.0, 0.0, down))
    # Palm and centre must stay this far apart along the approach.
    behind = body.half_extent_along(approach) - gripper.palm_reach
    height = body.top - body.bottom
    if family.depth is not None:
        # Level, the palm is behind the object, however deep the fingers are.
        deepest = height / 2 - behind / down if down > _STRAIGHT_DOWN else math.inf
        delta = height - min(max(deepest, gripper.least_depth), max(family.depth, gripper.pad_half_height))
    else:
        delta = min(robot.grasp_height if family.height is None else family.height, height - gripper.pad_half_height)
        delta = delta if body.is_upright else min(delta, height / 2)
    delta = max(delta, gripper.above_support(family.pitch))
    if level > _STRAIGHT_DOWN:
        epsilon = robot.grasp_axis_offset if family.axis_offset is None else family.axis_offset
        epsilon = max(epsilon, (behind - (delta - height / 2) * down) / level)
    else:
        epsilon = family.axis_offset or 0.0  # no palm is kept off the object by it
    T = np.eye(4)
    T[:3, :3] = gripper_rotation(yaw, family.pitch)
    T[:3, 3] = body.position - epsilon * heading
    T[2, 3] = body.bottom + delta
    return T


def wrap_to_pi(angles: Array) -> Array:
    """Angles [rad] in (-π, π]."""
    return math.pi - np.mod(math.pi - angles, 2 * math.pi)


_FAR_OUT = 0.4
"""Share of a lever's length from its axis at which it is held at least."""
_AGAINST, _FROM_ABOVE = 0.3, 0.7
"""Cosines: how much the approach must lead against the pull, or straight down where the pull is level."""


def can_pull(scene: Scene, body: Body, T_world_tcp: Array) -> bool:
    """Whether a gripper at T_world_tcp (4, 4) is on the side of a handle to which it is pulled; of other objects True.

    From there it holds a bar between its fingers or hooks it. From beside it would slip along it, from behind it would
    be in the way of what it pulls.
    """
    if scene.pull is None or body.name != scene.pull.handle:
        return True
    opening, approach = scene.opening(scene.pull.opening), T_world_tcp[:3, 0]
    if scene.pull.lever and not _is_far_out(scene.opening(scene.pull.lever), body, T_world_tcp[:3, 3]):
        return False
    direction = opening.direction(body.position)
    if not direction.any() or opening.is_about(body.position):  # a knob: it turns in the hand
        return bool(abs(approach @ opening.axis) >= _FROM_ABOVE)
    is_level = abs(direction[2]) < _FROM_ABOVE
    return bool(approach @ direction <= -_AGAINST or (is_level and approach[2] <= -_FROM_ABOVE))


def _is_far_out(lever: Opening, body: Body, point: Array) -> bool:
    """Whether a lever is held so far from its axis that the hand turns it, and does not slip about it."""
    longest = max(lever.lever_arm(corner) for piece in body.placed for corner in piece.corners)
    return lever.lever_arm(point) >= _FAR_OUT * longest
