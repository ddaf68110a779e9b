"""Closed-form inverse kinematics of arms with the structure of Fetch's arm, compiled.

The structure: a vertical lift, a vertical pan axis, then lift (y), roll (x), flex (y), roll (x), flex (y), roll (x)
with every offset after the lift joint along x. The last three axes meet in the wrist centre, so position and
orientation of the TCP can be solved one after the other. `links` are the seven lengths of such an arm [m]:

    pan_x, pan_z        pan axis in the base frame with the torso at 0
    shoulder_x, shoulder_z   lift axis in the frame that pans
    upper_arm, forearm, gripper   lift axis → elbow → wrist centre → TCP
"""

from __future__ import annotations

from collections.abc import Sequence
from math import acos, asin, atan2, cos, pi, sin, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.chain import ArmChain
from irm.compilation import njit
from irm.errors import ChainError
from irm.kinematics import wrap

Floats = NDArray[np.float64]
MAX_SOLUTIONS = 8
"""For a fixed torso and upper-arm roll: two elbow cosines × two elbow signs × two wrists."""
_SINGULAR = 1e-9
"""Sine or length [m] below which an angle is undefined and is set to 0."""
_NO_ROWS = np.int64(0)
"""Typed, so that `_wrist` is not compiled once more for the constant."""
_ROUNDING = 1e-9
"""How far rounding may push a cosine beyond ±1, or an angle [rad] beyond its limit."""


@njit(cache=True)
def _wrist(q: Floats, R: Floats, lower: Floats, upper: Floats, out: Floats, count: int) -> int:
    """Complete shoulder and elbow in `q[1:5]` with both wrist solutions that give the TCP orientation `R`.

    With R47 = (Rz(q1) Ry(q2) Rx(q3) Ry(q4))ᵀ R = Rx(q5) Ry(q6) Rx(q7), its first column gives q5 and q6, its first row
    q6 and q7. Writes the solutions within the limits into `out[count:]`; returns the new count.
    """
    M = R.copy()
    for joint in range(1, 5):
        c = cos(q[joint])
        s = sin(q[joint])
        for k in range(3):
            x, y, z = M[0, k], M[1, k], M[2, k]
            if joint == 1:
                M[0, k], M[1, k] = c * x + s * y, c * y - s * x
            elif joint == 3:
                M[1, k], M[2, k] = c * y + s * z, c * z - s * y
            else:
                M[0, k], M[2, k] = c * x - s * z, c * z + s * x
    flex = acos(min(1.0, max(-1.0, M[0, 0])))
    if sin(flex) < _SINGULAR:
        wrists = 1
        roll5, roll7 = 0.0, atan2(M[2, 1], M[1, 1]) if M[0, 0] > 0.0 else atan2(-M[2, 1], M[1, 1])
    else:
        wrists = 2
        roll5, roll7 = atan2(M[1, 0], -M[2, 0]), atan2(M[0, 1], M[0, 2])
    for k in range(wrists):
        q[5] = roll5 if k == 0 else wrap(roll5 + pi)
        q[6] = flex if k == 0 else -flex
        q[7] = roll7 if k == 0 else wrap(roll7 + pi)
        inside = True
        for joint in range(8):
            if q[joint] < lower[joint] - _ROUNDING or q[joint] > upper[joint] + _ROUNDING:
                inside = False
        if inside:
            for joint in range(8):
                out[count, joint] = min(upper[joint], max(lower[joint], q[joint]))
            count += 1
    return count


@njit(cache=True)
def ik_arm(
    links: Floats,
    R: Floats,
    p: Floats,
    torso: float,
    upper_arm_roll: float,
    lower: Floats,
    upper: Floats,
    out: Floats,
) -> int:
    """Every solution for a TCP at `R`, `p` with the torso and the upper-arm roll given.

    The wrist centre seen from the lift axis is v = Ry(q2) u with u = (L1 + L2 c4, L2 s3 s4, -L2 c3 s4). Equating
    lengths gives v_x as a linear function of c4, and v_x² + v_z² = u_x² + u_z² a quadratic in c4.

    Args:
        links: (7,) lengths of the arm, see the module.
        R: (3, 3) orientation of the TCP in the base frame.
        p: (3,) its position [m].
        torso: [m].
        upper_arm_roll: [rad], in [-π, π].
        lower, upper: (8,) limits of torso and arm joints.
        out: (8, 8) filled with rows of (torso, arm), roll joints in [-π, π].

    Returns:
        The number of rows written.
    """
    shoulder_x, shoulder_z, L1, L2, gripper = links[2], links[3], links[4], links[5], links[6]
    if upper_arm_roll < lower[3] or upper_arm_roll > upper[3] or torso < lower[0] or torso > upper[0]:
        return 0
    wx = p[0] - gripper * R[0, 0] - links[0]
    wy = p[1] - gripper * R[1, 0]
    vz = p[2] - gripper * R[2, 0] - links[1] - torso - shoulder_z
    radius2 = wx * wx + wy * wy
    c3, s3 = cos(upper_arm_roll), sin(upper_arm_roll)
    constant = radius2 + vz * vz - L1 * L1 - L2 * L2 - shoulder_x * shoulder_x
    slope = -L1 * L2 / shoulder_x
    offset = constant / (2.0 * shoulder_x)
    a = slope * slope - L2 * L2 * s3 * s3
    b = 2.0 * slope * offset - 2.0 * L1 * L2
    c = offset * offset - L1 * L1 - L2 * L2 * c3 * c3 + vz * vz
    discriminant = b * b - 4.0 * a * c
    if not discriminant >= 0.0:
        return 0
    q = np.empty(8)
    q[0], q[3] = torso, upper_arm_roll
    half = -0.5 * (b + (sqrt(discriminant) if b >= 0.0 else -sqrt(discriminant)))
    count = _NO_ROWS
    for root in range(2):
        if root == 0:
            if abs(a) < _SINGULAR * _SINGULAR:
                continue
            c4 = half / a
        else:
            if half == 0.0 or discriminant == 0.0:
                continue
            c4 = c / half
        if abs(c4) > 1.0 + _ROUNDING:
            continue
        c4 = min(1.0, max(-1.0, c4))
        vx = offset + slope * c4
        for sign in range(2):
            q[4] = acos(c4) if sign == 0 else -acos(c4)
            if sign == 1 and q[4] == 0.0:
                continue
            s4 = sin(q[4])
            ux, uy, uz = L1 + L2 * c4, L2 * s3 * s4, -L2 * c3 * s4
            q[1] = wrap(atan2(wy, wx) - atan2(uy, shoulder_x + vx))
            q[2] = wrap(atan2(uz, ux) - atan2(vz, vx))
            count = _wrist(q, R, lower, upper, out, count)
    return int(count)


@njit(cache=True)
def ik_pan(
    links: Floats,
    approach: Floats,
    wrist: Floats,
    c1: float,
    s1: float,
    lower: Floats,
    upper: Floats,
    out: Floats,
) -> int:
    """Every arm configuration with the approach axis `approach` and the wrist centre `wrist`, for a given pan angle.

    Solutions that differ only in the signs of elbow and wrist have the same link poses and the same manipulability;
    one of each is returned, with a positive elbow and wrist. The roll of the TCP is not determined. Requires symmetric
    limits of elbow and wrist flex.

    Args:
        links: (7,) lengths of the arm.
        approach: (3,) unit x axis of the TCP.
        wrist: (3,) wrist centre relative to the pan axis at shoulder height, for a torso at 0 [m].
        c1, s1: cosine and sine of the pan angle.
        lower, upper: (8,) limits; that of the pan joint is not checked.
        out: (2, 5) filled with rows of (lift, upper-arm roll, elbow, forearm roll, wrist flex).

    Returns:
        The number of rows written: 0, 1 or 2.
    """
    L1, L2 = links[4], links[5]
    vx = c1 * wrist[0] + s1 * wrist[1] - links[2]
    vy = c1 * wrist[1] - s1 * wrist[0]
    vz = wrist[2] - links[3]
    c4 = (vx * vx + vy * vy + vz * vz - L1 * L1 - L2 * L2) / (2.0 * L1 * L2)
    if c4 > 1.0 or c4 < cos(upper[4]):
        return 0
    s4 = sqrt(max(0.0, 1.0 - c4 * c4))
    if L2 * s4 < _SINGULAR or abs(vy) > L2 * s4:
        return 0
    s3 = vy / (L2 * s4)
    bearing = atan2(vz, vx)
    ax, ay, az = c1 * approach[0] + s1 * approach[1], c1 * approach[1] - s1 * approach[0], approach[2]
    count = 0
    for branch in range(2):
        c3 = sqrt(max(0.0, 1.0 - s3 * s3)) if branch == 0 else -sqrt(max(0.0, 1.0 - s3 * s3))
        lift = wrap(atan2(-L2 * c3 * s4, L1 + L2 * c4) - bearing)
        if lift < lower[2] or lift > upper[2]:
            continue
        c2, s2 = cos(lift), sin(lift)
        x, y, z = c2 * ax - s2 * az, ay, s2 * ax + c2 * az
        y, z = c3 * y + s3 * z, c3 * z - s3 * y
        x, z = c4 * x - s4 * z, c4 * z + s4 * x
        flex = acos(min(1.0, max(-1.0, x)))
        if flex > upper[6]:
            continue
        out[count, 0] = lift
        out[count, 1] = asin(min(1.0, max(-1.0, s3))) if branch == 0 else wrap(pi - asin(min(1.0, max(-1.0, s3))))
        out[count, 2] = acos(c4)
        out[count, 3] = atan2(y, -z)
        out[count, 4] = flex
        count += 1
    return count


@njit(cache=True)
def _inverse_grid(
    links: Floats, R: Floats, p: Floats, torsos: Floats, rolls: Floats, lower: Floats, upper: Floats, rows: Floats
) -> int:
    """Write all solutions on the grid into `rows`; the number of solutions."""
    found = np.empty((MAX_SOLUTIONS, 8))
    total = 0
    for torso in torsos:
        for roll in rolls:
            count = ik_arm(links, R, p, torso, roll, lower, upper, found)
            for k in range(count):
                rows[total] = found[k]
                total += 1
    return total


def inverse(chain: ArmChain, T_base_tcp: ArrayLike, torsos: Sequence[float] | Floats, rolls: ArrayLike) -> Floats:
    """Every closed-form solution within the limits on a grid of the two free parameters.

    Args:
        chain: of an arm with a closed form.
        T_base_tcp: (4, 4) target.
        torsos: torso heights to try [m].
        rolls: upper-arm rolls to try [rad], in [-π, π].

    Returns:
        (k, 8) configurations, k = 0 if there is none; roll joints in [-π, π].

    Raises:
        ChainError: the arm has no closed form.
    """
    if not chain.has_closed_form:
        raise ChainError(f"{chain.robot} has no closed form; use irm.ik.numerical.solve")
    T = np.ascontiguousarray(T_base_tcp, dtype=float)
    if T.shape != (4, 4):
        raise ChainError(f"T_base_tcp has shape (4, 4), not {T.shape}")
    heights = np.atleast_1d(np.asarray(torsos, dtype=float))
    angles = np.atleast_1d(np.asarray(rolls, dtype=float))
    rows = np.empty((MAX_SOLUTIONS * heights.size * angles.size, 8))
    R, p = np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3])
    count = _inverse_grid(chain.links, R, p, heights, angles, chain.lower, chain.upper, rows)
    return rows[:count].copy()
