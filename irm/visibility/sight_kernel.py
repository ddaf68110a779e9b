"""Lines of sight from a camera past the links of its robot, compiled."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from irm.arm.chain_arrays import ChainArrays
from irm.arm.closed_form import MAX_SOLUTIONS, ik_arm
from irm.arm.kinematics import fk_frames
from irm.compilation import njit
from irm.visibility.robot_view import BASE, BOX, CAPSULE, RobotView

__all__ = ["FULL_SHARE", "fill_shares", "seen_points"]

Floats = NDArray[np.float64]

FULL_SHARE = 255
"""What a map stores where every configuration sees all points of the target."""

_PARALLEL = 1e-12
"""[m] of a line's motion along an axis that counts as none."""


@njit(cache=True)
def _distance_to_line(start: Floats, along: Floats, z: float) -> float:
    """[m] from the point (0, 0, z) to the segment start + t along, 0 ≤ t ≤ 1."""
    square, inner = 0.0, -z * along[2]
    for i in range(3):
        square += along[i] * along[i]
        inner += start[i] * along[i]
    t = min(1.0, max(0.0, -inner / square)) if square > 0.0 else 0.0
    x, y, height = start[0] + t * along[0], start[1] + t * along[1], start[2] + t * along[2] - z
    return sqrt(x * x + y * y + height * height)


@njit(cache=True)
def _meets(kind: int, size: Floats, start: Floats, along: Floats) -> bool:
    """Whether the segment start + t along, 0 ≤ t ≤ 1, in the solid's frame, meets the solid.

    The values of t inside a box, or inside a cylinder, are the intersection of one interval for each of its surfaces. A
    capsule is a cylinder and two balls.
    """
    low, high = 0.0, 1.0
    for axis in range(0 if kind == BOX else 2, 3):
        if abs(along[axis]) < _PARALLEL:
            if abs(start[axis]) > size[axis]:
                high = -1.0
        else:
            one, other = (-size[axis] - start[axis]) / along[axis], (size[axis] - start[axis]) / along[axis]
            low, high = max(low, min(one, other)), min(high, max(one, other))
    if kind != BOX:
        a = along[0] * along[0] + along[1] * along[1]
        b = start[0] * along[0] + start[1] * along[1]
        c = start[0] * start[0] + start[1] * start[1] - size[0] * size[0]
        root = b * b - a * c
        if a < _PARALLEL * _PARALLEL:
            if c > 0.0:
                high = -1.0
        elif root < 0.0:
            high = -1.0
        else:
            low, high = max(low, (-b - sqrt(root)) / a), min(high, (-b + sqrt(root)) / a)
    if low <= high:
        return True
    if kind != CAPSULE:
        return False
    return min(_distance_to_line(start, along, size[2]), _distance_to_line(start, along, -size[2])) <= size[0]


@njit(cache=True)
def _to_frame(R: Floats, p: Floats, point: Floats, result: Floats) -> None:
    """`result` = Rᵀ (point - p)."""
    for i in range(3):
        result[i] = 0.0
        for k in range(3):
            result[i] += R[k, i] * (point[k] - p[k])


@njit(cache=True)
def _is_hidden(view: RobotView, R: Floats, p: Floats, eye: Floats, point: Floats) -> bool:
    """Whether a solid is between the camera and a point; `R` (p, 3, 3) and `p` (p, 3) are the poses of the solids."""
    start, end = np.empty(3), np.empty(3)
    for solid in range(view.kind.shape[0]):
        _to_frame(R[solid], p[solid], eye, start)
        _to_frame(R[solid], p[solid], point, end)
        for i in range(3):
            end[i] -= start[i]
        if _distance_to_line(start, end, 0.0) > view.bound[solid]:
            continue
        if _meets(view.kind[solid], view.size[solid], start, end):
            return True
    return False


@njit(cache=True)
def _place_in_link(
    link: int, R_links: Floats, p_links: Floats, R: Floats, p: Floats, R_placed: Floats, p_placed: Floats
) -> None:
    """The pose (R, p) in the frame of a link, as `R_placed` and `p_placed` in the base frame."""
    for i in range(3):
        p_placed[i] = p[i] if link == BASE else p_links[link, i]
        for j in range(3):
            if link == BASE:
                R_placed[i, j] = R[i, j]
            else:
                p_placed[i] += R_links[link, i, j] * p[j]
                R_placed[i, j] = 0.0
                for k in range(3):
                    R_placed[i, j] += R_links[link, i, k] * R[k, j]


@njit(cache=True)
def _points_in_image(
    view: RobotView, R_links: Floats, p_links: Floats, points: Floats, eye: Floats, inside: NDArray[np.bool_]
) -> int:
    """How many points (m, 3) are in the image; fills `inside` (m,) and the camera's position `eye` (3,)."""
    R_eye, image = np.empty((3, 3)), np.empty(3)
    _place_in_link(view.camera_link, R_links, p_links, view.camera_rotation, view.camera, R_eye, eye)
    total = 0
    for m in range(points.shape[0]):
        _to_frame(R_eye, eye, points[m], image)
        edge = -image[2] * view.slope
        inside[m] = edge > 0.0 and abs(image[0]) <= edge and abs(image[1]) <= edge
        total += inside[m]
    return total


@njit(cache=True)
def _is_possible(arm: ChainArrays, view: RobotView, torso: float, points: Floats, seen: NDArray[np.bool_]) -> bool:
    """False if no arm configuration can bring a point into the image: the camera is fixed to base or torso."""
    if view.camera_link > 0:
        return True
    n, q, eye = arm.axes.shape[0], np.zeros(arm.axes.shape[0]), np.empty(3)
    R_links, p_links = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    q[0] = torso
    fk_frames(arm.offsets, arm.axes, arm.tip, q, R_links, p_links)
    return _points_in_image(view, R_links, p_links, points, eye, seen) > 0


@njit(cache=True)
def seen_points(arm: ChainArrays, view: RobotView, q: Floats, points: Floats, seen: NDArray[np.bool_]) -> int:
    """How many of the points the camera sees past a robot in one configuration.

    Args:
        arm: of the robot.
        view: of the same robot.
        q: (1 + n,) torso and arm.
        points: (m, 3) in the base frame [m].
        seen: (m,) filled: whether each point is in the image and no solid of the robot is in front of it.
    """
    n, count = arm.axes.shape[0], view.kind.shape[0]
    R_links, p_links = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    fk_frames(arm.offsets, arm.axes, arm.tip, q, R_links, p_links)
    eye = np.empty(3)
    total = _points_in_image(view, R_links, p_links, points, eye, seen)
    if total == 0:
        return 0
    R, p = np.empty((count, 3, 3)), np.empty((count, 3))
    for solid in range(count):
        place = view.rotation[solid], view.position[solid]
        _place_in_link(view.link[solid], R_links, p_links, place[0], place[1], R[solid], p[solid])
    for m in range(points.shape[0]):
        if seen[m] and _is_hidden(view, R, p, eye, points[m]):
            seen[m] = False
            total -= 1
    return total


@njit(cache=True)
def fill_shares(
    arm: ChainArrays,
    view: RobotView,
    R: Floats,
    orientation: NDArray[np.int64],
    positions: Floats,
    torso: Floats,
    rolls: Floats,
    target: Floats,
    shares: NDArray[np.uint8],
) -> None:
    """How much of the target the camera sees at each TCP pose, on average over the arm's configurations.

    Args:
        arm: of the robot; it has a closed form.
        view: of the same robot.
        R: (o, 3, 3) orientations of the TCP.
        orientation: (n,) an index into `R` for each pose; `positions` (n, 3) of the TCP [m]; `torso` (n,) heights [m].
        rolls: (r,) angles of the upper-arm roll joint that are tried [rad].
        target: (m, 3) points of the target relative to the TCP's position [m].
        shares: (n,) filled with 0 to `FULL_SHARE`; 0 where no configuration was found.
    """
    found, points, seen = np.empty((MAX_SOLUTIONS, 8)), np.empty_like(target), np.empty(len(target), dtype=np.bool_)
    for i in range(positions.shape[0]):
        points[:] = target + positions[i]
        total = configurations = 0
        if not _is_possible(arm, view, torso[i], points, seen):
            shares[i] = 0
            continue
        for roll in rolls:
            count = ik_arm(arm.links, R[orientation[i]], positions[i], torso[i], roll, arm.lower, arm.upper, found)
            for k in range(count):
                total += seen_points(arm, view, found[k], points, seen)
            configurations += count
        shares[i] = round(FULL_SHARE * total / max(1, configurations * target.shape[0]))
