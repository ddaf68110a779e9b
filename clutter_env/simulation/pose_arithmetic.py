"""Arithmetic of rigid poses on plain floats: no array is made for three or four numbers.

Quaternions are wxyz tuples of unit length, vectors are tuples of three numbers. Formulas: Solà, Deray and Atchuthan, "A
micro Lie theory for state estimation in robotics", 2018.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Quaternion",
    "Vector3",
    "inverse_left_jacobian",
    "pose_difference",
    "quaternion_of_matrix",
    "quaternion_product",
    "rotated",
    "rotation_vector",
    "rotation_vector_between",
    "turned_by",
]

Quaternion = tuple[float, float, float, float]
Vector3 = tuple[float, float, float]

_TINY = 1e-10
"""[rad²] Below this squared angle, mink's formulas, which these must match, take their limits."""
_SMALL_ANGLE = 1e-2
"""[rad] Below it the coefficients are summed as series; there their closed forms lose digits."""


def quaternion_product(a: Quaternion, b: Quaternion) -> Quaternion:
    """The rotation `b` followed by `a`."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def quaternion_of_matrix(matrix: NDArray[np.float64]) -> Quaternion:
    """The quaternion of a rotation matrix (3, 3) or (9,)."""
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, matrix.ravel())
    w, x, y, z = quaternion.tolist()
    return w, x, y, z


def rotated(vector: Vector3, q: Quaternion) -> Vector3:
    """The vector turned by a quaternion."""
    w, x, y, z = q
    vx, vy, vz = vector
    cx, cy, cz = 2 * (y * vz - z * vy), 2 * (z * vx - x * vz), 2 * (x * vy - y * vx)
    return vx + w * cx + y * cz - z * cy, vy + w * cy + z * cx - x * cz, vz + w * cz + x * cy - y * cx


def rotation_vector(q: Quaternion) -> Vector3:
    """The rotation vector [rad] of a quaternion (Solà et al., eq. 133); its length is at most pi."""
    w, x, y, z = q
    if w < 0:
        w, x, y, z = -w, -x, -y, -z
    length = math.sqrt(x * x + y * y + z * z)
    if length < _TINY:
        return 0.0, 0.0, 0.0
    scale = 2 * math.atan2(length, w) / length
    return scale * x, scale * y, scale * z


def rotation_vector_between(start: Quaternion, end: Quaternion) -> Vector3:
    """The rotation vector [rad], in the frame in which both are given, that turns `start` into `end`."""
    w, x, y, z = start
    return rotation_vector(quaternion_product(end, (w, -x, -y, -z)))


def turned_by(q: Quaternion, vector: Vector3) -> Quaternion:
    """`q` followed by the rotation of a rotation vector [rad], both in the same fixed frame; of unit length."""
    x, y, z = vector
    angle = math.sqrt(x * x + y * y + z * z)
    scale = math.sin(angle / 2) / angle if angle > 0 else 0.5
    w, x, y, z = quaternion_product((math.cos(angle / 2), scale * x, scale * y, scale * z), q)
    length = math.sqrt(w * w + x * x + y * y + z * z)
    return w / length, x / length, y / length, z / length


def pose_difference(
    position: Vector3, rotation: Quaternion, goal_position: Vector3, goal_rotation: Quaternion
) -> tuple[Vector3, Vector3]:
    """The logarithm of the goal pose as seen from the pose, linear [m] and angular [rad] (Solà et al., eq. 173)."""
    w, x, y, z = rotation
    back = (w, -x, -y, -z)
    px, py, pz = rotated(
        (goal_position[0] - position[0], goal_position[1] - position[1], goal_position[2] - position[2]), back
    )
    angular = rotation_vector(quaternion_product(back, goal_rotation))
    ax, ay, az = angular
    square = ax * ax + ay * ay + az * az
    beta = 1 / 12 if square < _TINY else _curvature(math.sqrt(square))[0]
    # The inverse left Jacobian of the rotation applied to the translation: p - a × p / 2 + beta a × (a × p).
    cx, cy, cz = ay * pz - az * py, az * px - ax * pz, ax * py - ay * px
    dx, dy, dz = ay * cz - az * cy, az * cx - ax * cz, ax * cy - ay * cx
    linear = (px - cx / 2 + beta * dx, py - cy / 2 + beta * dy, pz - cz / 2 + beta * dz)
    return linear, angular


def inverse_left_jacobian(linear: Vector3, angular: Vector3) -> tuple[tuple[float, ...], ...] | None:
    """Inverse left Jacobian of a rigid motion at the twist (linear, angular): [[A, B], [0, A]] (Solà et al., eq. 179b).

    A(a) = (1 - beta |a|²) I - [a]/2 + beta a aᵀ is that of the rotation. B is the derivative of A along `linear`,
    because a twist is a rotation vector over the dual numbers.

    Returns:
        The rows of A and of B, one after the other (6 rows of 3); None for the identity (a very small angle).
    """
    ax, ay, az = angular
    square = ax * ax + ay * ay + az * az
    if square < _TINY:
        return None
    rx, ry, rz = linear
    beta, slope = _curvature(math.sqrt(square))
    along = ax * rx + ay * ry + az * rz
    change = slope * along
    a = 1 - beta * square
    b = -(change * square + 2 * beta * along)
    xy, xz, yz = beta * ax * ay, beta * ax * az, beta * ay * az
    mixed_xy = beta * (ax * ry + rx * ay) + change * ax * ay
    mixed_xz = beta * (ax * rz + rx * az) + change * ax * az
    mixed_yz = beta * (ay * rz + ry * az) + change * ay * az
    return (
        (a + beta * ax * ax, xy + az / 2, xz - ay / 2),
        (xy - az / 2, a + beta * ay * ay, yz + ax / 2),
        (xz + ay / 2, yz - ax / 2, a + beta * az * az),
        (b + 2 * beta * ax * rx + change * ax * ax, mixed_xy + rz / 2, mixed_xz - ry / 2),
        (mixed_xy - rz / 2, b + 2 * beta * ay * ry + change * ay * ay, mixed_yz + rx / 2),
        (mixed_xz + ry / 2, mixed_yz - rx / 2, b + 2 * beta * az * rz + change * az * az),
    )


def _curvature(angle: float) -> tuple[float, float]:
    """beta = 1/t² - (t / tan(t/2)) / (2 t²) for the angle t [rad], and (d beta / dt) / t."""
    square = angle * angle
    if angle < _SMALL_ANGLE:
        return 1 / 12 + square / 720 + square * square / 30240, 1 / 360 + square / 7560
    sine = math.sin(angle / 2)
    cotangent = math.cos(angle / 2) / sine
    beta = 1 / square - cotangent / (2 * angle)
    slope = -2 / (square * angle) + cotangent / (2 * square) + 1 / (4 * angle * sine * sine)
    return beta, slope / angle
