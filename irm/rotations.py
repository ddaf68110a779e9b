"""Rotation matrices in the paper's ZYX convention, and angles within one turn."""

from __future__ import annotations

import math
from math import pi
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.errors import QueryError

Floats = NDArray[np.float64]
Angle = TypeVar("Angle", float, NDArray[np.floating[Any]])
_POLE = 1e-6
"""Horizontal length of the approach axis below which the yaw is undefined and is set to 0."""
_NOT_RIGID = 1e-5
"""Largest deviation of RᵀR from the identity. It allows poses in single precision."""

_CROSS = np.array([(0, 0, 0, 0, 0, -1, 0, 1, 0), (0, 0, 1, 0, 0, 0, -1, 0, 0), (0, -1, 0, 1, 0, 0, 0, 0, 0)], float)
"""Matrix of the cross product with each axis, row by row."""
_TINY = 1e-12
"""[rad] Smallest angle of a rotation: no division by zero."""
_arctan2 = np.frompyfunc(math.atan2, 2, 1)


def arctan2(sine: ArrayLike, cosine: ArrayLike) -> Floats:
    """Angles [rad], with the same bits on all processors. The last bits of NumPy's arctan2 depend on AVX-512."""
    return np.asarray(_arctan2(sine, cosine), dtype=float)


def as_poses(T_base_tcp: ArrayLike) -> Floats:
    """Convert to poses (n, 4, 4).

    Raises:
        QueryError: not an array of finite numbers of this shape, or not rotations and translations.
    """
    try:
        T = np.asarray(T_base_tcp, dtype=float)
    except (TypeError, ValueError):
        raise QueryError("TCP poses are an array (n, 4, 4) of finite numbers") from None
    if T.ndim != 3 or T.shape[1:] != (4, 4) or not np.isfinite(T).all():
        raise QueryError(f"TCP poses are an array (n, 4, 4) of finite numbers, not {T.shape}")
    R = T[:, :3, :3]
    off = np.abs(np.einsum("nji,njk->nik", R, R) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    off = np.maximum(off, np.abs(T[:, 3] - (0, 0, 0, 1)).max(axis=1, initial=0.0))
    valid = (off < _NOT_RIGID) & (np.linalg.det(R) > 0.0)
    if not valid.all():
        raise QueryError(f"pose {int(valid.argmin())} is not a rotation and a translation:\n{T[int(valid.argmin())]}")
    return T


def rotation(yaw: float, pitch: float, roll: float) -> Floats:
    """R(γ, β, α) = Rz(yaw) Ry(pitch) Rx(roll) (3, 3), the paper's ZYX convention."""
    return np.array(_rows(np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)))


def rotations(yaw: Floats, pitch: Floats, roll: Floats) -> Floats:
    """`rotation` for many angles (n,) [rad]: (n, 3, 3)."""
    rows = _rows(np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll))
    return np.ascontiguousarray(np.moveaxis(np.array(rows), 2, 0))


def _rows(cy: Any, sy: Any, cp: Any, sp: Any, cr: Any, sr: Any) -> list[list[Any]]:
    """Rows of R(γ, β, α), from the cosines and sines of its angles: numbers or arrays."""
    return [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]


def rotations_by(vectors: Floats) -> Floats:
    """Rotations (..., 3, 3) of rotation vectors (..., 3) [rad]."""
    angle = np.maximum(np.linalg.norm(vectors, axis=-1), _TINY)[..., None, None]
    K = (vectors @ _CROSS).reshape(*vectors.shape, 3)
    half = np.sin(angle / 2) / angle
    return np.asarray(np.eye(3) + np.sin(angle) / angle * K + 2 * half * half * (K @ K))


def rotation_vectors(R: Floats) -> Floats:
    """Rotation vectors (..., 3) [rad] of rotations (..., 3, 3). Zero for half turns, whose axis has no sign."""
    twice = R.reshape(*R.shape[:-2], 9) @ _CROSS.T
    sine = np.linalg.norm(twice, axis=-1)
    angle = arctan2(sine, np.trace(R, axis1=-2, axis2=-1) - 1.0)
    return np.asarray(twice * (angle / np.maximum(sine, _TINY))[..., None])


def world_to_base(base: Floats) -> Floats:
    """T_base_world (4, 4) of a base pose x, y [m], yaw [rad]."""
    T = np.eye(4)
    T[:3, :3] = rotation(-float(base[2]), 0.0, 0.0)
    T[:2, 3] = -T[:2, :2] @ base[:2]
    return T


def yaw_pitch_roll(R: Floats) -> Floats:
    """(n, 3) angles of rotations (n, 3, 3). At the poles the yaw is 0, and the roll is the whole turn."""
    horizontal = np.hypot(R[:, 0, 0], R[:, 1, 0])
    pitch = np.arctan2(-R[:, 2, 0], horizontal)
    regular = horizontal > _POLE
    yaw = np.where(regular, np.arctan2(R[:, 1, 0], R[:, 0, 0]), 0.0)
    sign = np.sign(pitch)
    roll = np.where(regular, np.arctan2(R[:, 2, 1], R[:, 2, 2]), np.arctan2(sign * R[:, 0, 1], R[:, 1, 1]))
    return np.column_stack([yaw, pitch, roll])


def wrap_to_pi(angle: Angle) -> Angle:
    """Wrap an angle, or an array of angles, to [-π, π) [rad]."""
    return (angle + pi) % (2 * pi) - pi


def frame_along(axis: Floats) -> Floats:
    """A rotation (3, 3) with the given z axis."""
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(axis)))], axis)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(axis, x), axis])
