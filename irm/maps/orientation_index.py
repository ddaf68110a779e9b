"""The sampled orientation that is nearest to a TCP orientation, and its neighbours."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.arm.angles import signed
from irm.errors import QueryError
from irm.maps.orientations import Orientations

__all__ = ["as_poses", "nearest_orientation", "orientation_neighbours", "rotation", "rotations", "yaw_pitch_roll"]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_POLE = 1e-6
"""Horizontal length of the approach axis below which the yaw is undefined and is set to 0."""

_NOT_RIGID = 1e-5
"""How far RᵀR may be from the identity: poses in single precision count as poses."""


def as_poses(T_base_tcp: ArrayLike) -> Floats:
    """(n, 4, 4) poses.

    Raises:
        QueryError: not an array of finite numbers of that shape, or not rotations and translations.
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
    """The same for many angles (n,) [rad]: (n, 3, 3)."""
    rows = _rows(np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll))
    return np.ascontiguousarray(np.moveaxis(np.array(rows), 2, 0))


def _rows(cy: Any, sy: Any, cp: Any, sp: Any, cr: Any, sr: Any) -> list[list[Any]]:
    """Rows of R(γ, β, α), from the cosines and sines of its angles: numbers or arrays."""
    return [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]


def yaw_pitch_roll(R: Floats) -> Floats:
    """(n, 3) angles of rotations (n, 3, 3); at the poles the yaw is 0, and the roll is the whole turn."""
    horizontal = np.hypot(R[:, 0, 0], R[:, 1, 0])
    pitch = np.arctan2(-R[:, 2, 0], horizontal)
    regular = horizontal > _POLE
    yaw = np.where(regular, np.arctan2(R[:, 1, 0], R[:, 0, 0]), 0.0)
    sign = np.sign(pitch)
    roll = np.where(regular, np.arctan2(R[:, 2, 1], R[:, 2, 2]), np.arctan2(sign * R[:, 0, 1], R[:, 1, 1]))
    return np.column_stack([yaw, pitch, roll])


def nearest_orientation(orientations: Orientations, R: Floats) -> Integers:
    """(n,) index of the orientation cell that contains each rotation (n, 3, 3); -1 where the map has no such ring."""
    yaw, pitch, roll = yaw_pitch_roll(R).T
    rings = np.unique(orientations.pitch)
    ring = np.abs(pitch[:, None] - rings).argmin(axis=1)
    inside = np.abs(pitch - rings[ring]) <= orientations.step / 2
    result = np.full(len(R), -1, dtype=np.int64)
    for k, value in enumerate(rings):
        members = np.flatnonzero(orientations.pitch == value)
        here = np.flatnonzero(inside & (ring == k))
        turn = yaw[here]
        if orientations.is_pole(int(members[0])):
            turn = yaw[here] - np.sign(value) * roll[here]
            group = np.full(here.size, members[0])
        elif orientations.free_roll:
            group = np.full(here.size, members[0])
        else:
            group = members[np.round(roll[here] / (2 * np.pi) * members.size).astype(np.int64) % members.size]
        count = orientations.count[group]
        result[here] = orientations.start[group] + np.round(turn / (2 * np.pi) * count).astype(np.int64) % count
    return result


def orientation_neighbours(orientations: Orientations) -> Integers:
    """(size, m) orientations next to each one, padded with -1: yaw ± 1, pitch ± 1, roll ± 1."""
    pitch, roll, count, start = orientations.pitch, orientations.roll, orientations.count, orientations.start
    rolls = len(np.unique(roll))
    rows: list[set[int]] = [set() for _ in range(orientations.size)]
    for group in range(len(pitch)):
        for k in range(count[group]):
            own = int(start[group]) + k
            rows[own] |= {int(start[group]) + (k + turn) % int(count[group]) for turn in (1, -1)} - {own}
            for other in range(len(pitch)):
                steps = abs(pitch[other] - pitch[group]) / orientations.step
                turn = abs(signed(roll[other] - roll[group])) * rolls / (2 * np.pi)
                pole = orientations.is_pole(group) or orientations.is_pole(other)
                if (0.5 < steps < 1.5 and (turn < 0.5 or pole)) or (steps < 0.5 and 0.5 < turn < 1.5):
                    twin = int(start[other]) + round(k * count[other] / count[group]) % int(count[other])
                    rows[own].add(twin)
                    rows[twin].add(own)
    width = max(len(row) for row in rows)
    return np.array([sorted(row) + [-1] * (width - len(row)) for row in rows], dtype=np.int64)
