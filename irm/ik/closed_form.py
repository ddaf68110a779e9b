"""Inverse kinematics of arms with the structure of Fetch's arm, compiled: closed forms, and exact decisions.

The structure: a vertical lift, a vertical pan axis, then lift (y), roll (x), flex (y), roll (x), flex (y), roll (x)
with every offset after the lift joint along x. The last three axes meet in the wrist centre, so position and
orientation of the TCP can be solved one after the other. The seven lengths `links` of such an arm are [m]:

    pan_x, pan_z        pan axis in the base frame with the torso at 0
    shoulder_x, shoulder_z   lift axis in the frame that pans
    upper_arm, forearm, gripper   lift axis → elbow → wrist centre → TCP

Exact decisions use branch and bound over the two free parameters. With torso height and pan angle fixed, the closed
form tells whether a pose is reached. A rectangle of torso heights and pan angles is tested at its middle. If the middle
does not reach the pose, interval arithmetic bounds the joint angles over the whole rectangle. Either it proves that no
point of the rectangle reaches the pose, or the rectangle is cut in two. So YES comes with a configuration, NO is
proved, and a pose is UNKNOWN only if the remaining rectangles are very small.

In the plane that turns with the pan joint (x ahead, z up, origin at the lift axis), the wrist centre v depends on its
distance ρ from the pan axis, on φ = bearing of the wrist centre - pan, and on its height:

    v = (ρ cos φ - shoulder_x, ρ sin φ, v_z)                d² = |v|²
    a = L1 + L2 cos(elbow) = (d² + L1² - L2²) / 2 L1        h² = L2² sin²(elbow) - v_y²
    lift = ∓ atan2(h, a) - atan2(v_z, v_x)
    L2 cos(wrist flex) = (v - L1 (cos(lift), 0, -sin(lift))) · approach
"""

from __future__ import annotations

from math import acos, asin, atan2, ceil, cos, floor, hypot, pi, sin, sqrt
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from irm.answers import NO, UNKNOWN, YES
from irm.chain import ChainArrays
from irm.compilation import njit
from irm.kernel_arguments import inlined_kernel, leaf_kernel
from irm.kinematics import fk_frames, wrap

Floats = NDArray[np.float64]
Cosines: TypeAlias = tuple[float, float, float, float]
MAX_SOLUTIONS = 8
"""For a fixed torso and upper-arm roll: two elbow cosines × two elbow signs × two wrists."""
_SINGULAR = 1e-9
"""Sine or length [m] below which an angle is undefined and is set to 0."""
MIRRORED, NOT_MIRRORED = np.bool_(True), np.bool_(False)
"""Whether solutions with a negative elbow are wanted. Typed, so that kernels are not compiled again for constants."""
_NO_ROWS = np.int64(0)
"""Zero with a type, so that `_wrist` is not compiled again for the constant."""
_ROUNDING = 1e-9
"""Largest excess of a cosine beyond ±1, or of an angle beyond its limit [rad], due to rounding."""


@inlined_kernel
def _in_forearm(x: float, y: float, z: float, c: Cosines, s: Cosines) -> tuple[float, float, float]:
    """A vector of the base frame in the frame after (Rz(q1) Ry(q2) Rx(q3) Ry(q4))."""
    x, y = c[0] * x + s[0] * y, c[0] * y - s[0] * x
    x, z = c[1] * x - s[1] * z, c[1] * z + s[1] * x
    y, z = c[2] * y + s[2] * z, c[2] * z - s[2] * y
    return c[3] * x - s[3] * z, y, c[3] * z + s[3] * x


@leaf_kernel
def _wrist(arm: ChainArrays, R: Floats, out: Floats, count: int) -> int:
    """Complete shoulder and elbow in `out[count, :5]` with both wrist solutions that give the TCP orientation `R`.

    As R47 = Rx(q5) Ry(q6) Rx(q7), its first column gives q5 and q6, its first row q6 and q7. Writes the solutions
    within the limits into `out[count:]`. Returns the new count.
    """
    first = out[count]
    c = cos(first[1]), cos(first[2]), cos(first[3]), cos(first[4])
    s = sin(first[1]), sin(first[2]), sin(first[3]), sin(first[4])
    xx, xy, xz = _in_forearm(R[0, 0], R[1, 0], R[2, 0], c, s)
    yx, yy, yz = _in_forearm(R[0, 1], R[1, 1], R[2, 1], c, s)
    zx = _in_forearm(R[0, 2], R[1, 2], R[2, 2], c, s)[0]
    flex = acos(min(1.0, max(-1.0, xx)))
    if sin(flex) < _SINGULAR:
        wrists = 1
        roll5, roll7 = 0.0, atan2(yz, yy) if xx > 0.0 else atan2(-yz, yy)
    else:
        wrists = 2
        roll5, roll7 = atan2(xy, -xz), atan2(yx, zx)
    for k in range(wrists):
        q = out[count]
        for joint in range(5):
            q[joint] = first[joint]
        q[5] = roll5 if k == 0 else wrap(roll5 + pi)
        q[6] = flex if k == 0 else -flex
        q[7] = roll7 if k == 0 else wrap(roll7 + pi)
        inside = True
        for joint in range(8):
            if q[joint] < arm.lower[joint] - _ROUNDING or q[joint] > arm.upper[joint] + _ROUNDING:
                inside = False
        if inside:
            for joint in range(8):
                q[joint] = min(arm.upper[joint], max(arm.lower[joint], q[joint]))
            count += 1
    return count


@leaf_kernel
def ik_arm(
    arm: ChainArrays, R: Floats, p: Floats, torso: float, upper_arm_roll: float, out: Floats, mirrored: bool
) -> int:
    """Find every solution for a TCP at `R` (3, 3), `p` (3,) in the base frame, with given torso and upper-arm roll.

    Writes them into `out` (8, 8), rows of (torso, arm) with roll joints in [-π, π]. Returns their number. Without
    `mirrored`, only those with a positive elbow: the others have the links of those for the upper-arm roll half a turn
    on at the same places.

    The wrist centre seen from the lift axis is v = Ry(q2) u with u = (L1 + L2 c4, L2 s3 s4, -L2 c3 s4). Equating
    lengths gives v_x as a linear function of c4, and v_x² + v_z² = u_x² + u_z² a quadratic in c4.
    """
    links, lower, upper = arm.links, arm.lower, arm.upper
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
        for sign in range(2 if mirrored else 1):
            elbow = acos(c4) if sign == 0 else -acos(c4)
            if sign == 1 and elbow == 0.0:
                continue
            s4, q = sin(elbow), out[count]
            ux, uy, uz = L1 + L2 * c4, L2 * s3 * s4, -L2 * c3 * s4
            q[0], q[3], q[4] = torso, upper_arm_roll, elbow
            q[1] = wrap(atan2(wy, wx) - atan2(uy, shoulder_x + vx))
            q[2] = wrap(atan2(uz, ux) - atan2(vz, vx))
            count = _wrist(arm, R, out, count)
    return int(count)


@njit(cache=True)
def ik_pan(arm: ChainArrays, approach: Floats, wrist: Floats, c1: float, s1: float, out: Floats) -> int:
    """Find every arm configuration with the approach axis `approach` (3,) and the wrist centre `wrist` (3,), for a pan
    angle of cosine `c1` and sine `s1`. The limits of the pan joint are not checked.

    `wrist` is relative to the pan axis at shoulder height, for a torso at 0 [m]. Writes the solutions into `out` (2,
    5), rows of (lift, upper-arm roll, elbow, forearm roll, wrist flex). Returns their number.

    Solutions that differ only in the signs of elbow and wrist have the same link poses and the same manipulability.
    Only the solution with a positive elbow and wrist is returned. The roll of the TCP stays undetermined. Elbow and
    wrist flex must have symmetric limits.
    """
    links, lower, upper = arm.links, arm.lower, arm.upper
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


SLACK = 1e-8
"""[m], [m²] or [rad] Tolerance of a violated bound, so that rounding cannot exclude a solution."""
MAX_RECTANGLES = 4000
"""Most rectangles examined per pose before it stays UNKNOWN. Most poses need fewer than 30."""


@njit(cache=True)
def cosine_range(low: float, high: float) -> tuple[float, float]:
    """Smallest and largest cosine of the angles from `low` to `high`."""
    at_low, at_high = cos(low), cos(high)
    smallest, largest = min(at_low, at_high), max(at_low, at_high)
    if floor(high / (2.0 * pi)) >= ceil(low / (2.0 * pi)):
        largest = 1.0
    if floor((high - pi) / (2.0 * pi)) >= ceil((low - pi) / (2.0 * pi)):
        smallest = -1.0
    return smallest, largest


@njit(cache=True)
def bearing_range(x0: float, x1: float, z0: float, z1: float) -> tuple[float, float]:
    """Smallest and largest atan2(z, x) over a rectangle, continuous across ±π."""
    if x0 <= 0.0 <= x1 and z0 <= 0.0 <= z1:
        return -pi, pi
    middle = atan2(0.5 * (z0 + z1), 0.5 * (x0 + x1))
    low, high = 0.0, 0.0
    for x in (x0, x1):
        for z in (z0, z1):
            off = wrap(atan2(z, x) - middle)
            low, high = min(low, off), max(high, off)
    return middle + low, middle + high


@njit(cache=True)
def products(a0: float, a1: float, b0: float, b1: float) -> tuple[float, float]:
    """Smallest and largest product of two intervals."""
    p, q, r, s = a0 * b0, a0 * b1, a1 * b0, a1 * b1
    return min(p, q, r, s), max(p, q, r, s)


class WristBox(NamedTuple):
    """A box of wrist centres: ranges of the distance `rho` from the pan axis [m], the angle `turn` from the plane of
    the arm [rad], and the `height` above the lift axis [m]."""

    rho0: float
    rho1: float
    turn0: float
    turn1: float
    height0: float
    height1: float


class LiftBounds(NamedTuple):
    """Bounds of the lift angle over a box of wrist centres.

    `is_possible`: whether the lengths of the arm and the limit of the elbow allow any lift angle. `bend` and `bearing`:
    smallest and largest value of the two angles that make up the lift [rad].
    """

    is_possible: bool
    bend0: float
    bend1: float
    bearing0: float
    bearing1: float


@njit(cache=True)
def lift_bounds(links: Floats, upper: Floats, box: WristBox) -> LiftBounds:
    """Bounds of the lift angle over a box, in both branches."""
    L1, L2, shoulder = links[4], links[5], links[2]
    z0, z1 = box.height0, box.height1
    c0, c1 = cosine_range(box.turn0, box.turn1)
    s0, s1 = cosine_range(box.turn0 - 0.5 * pi, box.turn1 - 0.5 * pi)
    z_near = 0.0 if z0 <= 0.0 <= z1 else min(abs(z0), abs(z1))
    z_far = max(abs(z0), abs(z1))
    rho = min(box.rho1, max(box.rho0, shoulder * c1))
    near = rho * rho + shoulder * shoulder - 2.0 * rho * shoulder * c1 + z_near * z_near
    far = shoulder * shoulder + z_far * z_far
    far += max(box.rho0 * (box.rho0 - 2.0 * shoulder * c0), box.rho1 * (box.rho1 - 2.0 * shoulder * c0))
    shortest = L1 * L1 + L2 * L2 + 2.0 * L1 * L2 * cos(upper[4])
    longest = (L1 + L2) * (L1 + L2)
    if near > longest + SLACK or far < shortest - SLACK:
        return LiftBounds(False, 0.0, 0.0, 0.0, 0.0)
    near, far = max(near, shortest), min(far, longest)
    a0, a1 = (near + L1 * L1 - L2 * L2) / (2.0 * L1), (far + L1 * L1 - L2 * L2) / (2.0 * L1)
    side_near = 0.0 if s0 <= 0.0 <= s1 else box.rho0 * min(abs(s0), abs(s1))
    side_far = box.rho1 * max(abs(s0), abs(s1))
    widest = L2 * L2 if near <= L1 * L1 + L2 * L2 <= far else max(near - a0 * a0, far - a1 * a1)
    widest -= side_near * side_near
    if widest < -SLACK:
        return LiftBounds(False, 0.0, 0.0, 0.0, 0.0)
    # The root is 0 for a straight elbow. Rounding of the radicand must not bound the lift angle.
    narrowest = min(near - a0 * a0, far - a1 * a1) - side_far * side_far - SLACK
    h0, h1 = sqrt(max(0.0, narrowest)), sqrt(max(0.0, widest + SLACK))
    bend0 = atan2(h0 if a1 > 0.0 else h1, a1)
    bend1 = atan2(h1 if a0 > 0.0 else h0, a0)
    x0 = min(box.rho0 * c0, box.rho1 * c0) - shoulder
    x1 = max(box.rho0 * c1, box.rho1 * c1) - shoulder
    low, high = bearing_range(x0, x1, z0, z1)
    return LiftBounds(True, bend0, bend1, low, high)


@njit(cache=True)
def lift_of_branch(bounds: LiftBounds, branch: int) -> tuple[float, float]:
    """Smallest and largest lift angle of a branch of the elbow, 0 or 1, without the joint's limits [rad]."""
    if branch == 0:
        return -bounds.bend1 - bounds.bearing1, -bounds.bend0 - bounds.bearing0
    return bounds.bend0 - bounds.bearing1, bounds.bend1 - bounds.bearing0


class _Pose(NamedTuple):
    """A pose relative to the arm. `rho`, `bearing`: polar coordinates of the wrist centre about the pan axis [m],
    [rad]. `height`: its height above the lift axis with the torso at 0 [m]. `level`, `yaw`, `upward`: horizontal
    length, yaw [rad] and vertical component of the approach axis. `inner`: scalar product of the horizontal parts of
    wrist centre and approach [m]."""

    rho: float
    bearing: float
    height: float
    level: float
    yaw: float
    upward: float
    inner: float


@njit(cache=True)
def _relative_pose(links: Floats, T: Floats) -> _Pose:
    """A TCP pose (4, 4) in the base frame, relative to the arm."""
    ax, ay, az = T[0, 0], T[1, 0], T[2, 0]
    wx, wy = T[0, 3] - links[6] * ax - links[0], T[1, 3] - links[6] * ay
    wz = T[2, 3] - links[6] * az - links[1] - links[3]
    return _Pose(hypot(wx, wy), atan2(wy, wx), wz, hypot(ax, ay), atan2(ay, ax), az, wx * ax + wy * ay)


@njit(cache=True)
def _flex_is_possible(
    links: Floats, upper: Floats, pose: _Pose, ahead: tuple[float, float], up: tuple[float, float], lift: Floats
) -> bool:
    """Whether the wrist flex may be within its limit for any lift angle in `lift` (2,).

    `ahead`: range of the approach's component along the plane. `up`: range of the wrist centre's height [m].
    """
    cosine = cosine_range(lift[0], lift[1])
    sine = cosine_range(lift[0] - 0.5 * pi, lift[1] - 0.5 * pi)
    rising = products(up[0], up[1], pose.upward, pose.upward)
    reaching = products(links[2] + links[4] * cosine[0], links[2] + links[4] * cosine[1], ahead[0], ahead[1])
    tilting = products(links[4] * sine[0], links[4] * sine[1], pose.upward, pose.upward)
    largest = pose.inner + rising[1] - reaching[0] + tilting[1]
    return largest >= links[5] * cos(upper[6]) - SLACK


@njit(cache=True)
def _may_reach(links: Floats, lower: Floats, upper: Floats, pose: _Pose, box: Floats, lift: Floats) -> bool:
    """Whether any point of a rectangle may reach a pose. False only if no point does.

    `box` (4,): lowest and highest torso height [m] and pan angle [rad]. `lift` (2,) is scratch space.
    """
    up = pose.height - box[1], pose.height - box[0]
    wrist = WristBox(pose.rho, pose.rho, pose.bearing - box[3], pose.bearing - box[2], up[0], up[1])
    bounds = lift_bounds(links, upper, wrist)
    if not bounds.is_possible:
        return False
    d0, d1 = cosine_range(pose.yaw - box[3], pose.yaw - box[2])
    ahead = (pose.level * d0, pose.level * d1)
    for branch in range(2):
        low, high = lift_of_branch(bounds, branch)
        for turn in range(-1, 2):
            lift[0] = max(lower[2], low + 2.0 * pi * turn) - SLACK
            lift[1] = min(upper[2], high + 2.0 * pi * turn) + SLACK
            if lift[0] <= lift[1] and _flex_is_possible(links, upper, pose, ahead, up, lift):
                return True
    return False


@njit(cache=True)
def decide_poses(arm: ChainArrays, T: Floats, answers: NDArray[np.int8], configurations: Floats) -> None:
    """Fill `answers` (n,) and `configurations` (n, 8) for poses T (n, 4, 4), as in
    `irm.ik.solvers.ExactSolver.reach`."""
    links, lower, upper = arm.links, arm.lower, arm.upper
    queue, lift, rows = np.empty((MAX_RECTANGLES + 2, 4)), np.empty(2), np.empty((2, 5))
    approach, wrist = np.empty(3), np.empty(3)
    R, p = np.empty((9, 3, 3)), np.empty((9, 3))
    for n in range(T.shape[0]):
        pose = _relative_pose(links, T[n])
        for i in range(3):
            approach[i] = T[n, i, 0]
            wrist[i] = T[n, i, 3] - links[6] * approach[i]
        wrist[0] -= links[0]
        height = wrist[2] - links[1]
        queue[0, 0], queue[0, 1], queue[0, 2], queue[0, 3] = lower[0], upper[0], lower[1], upper[1]
        first, last = 0, 1
        answers[n] = NO
        while first < last:
            box = queue[first]
            first += 1
            if not _may_reach(links, lower, upper, pose, box, lift):
                continue
            torso, pan = 0.5 * (box[0] + box[1]), 0.5 * (box[2] + box[3])
            wrist[2] = height - torso
            if ik_pan(arm, approach, wrist, cos(pan), sin(pan), rows) > 0:
                answers[n] = YES
                q = configurations[n]
                q[0], q[1], q[7] = torso, pan, 0.0
                q[2:7] = rows[0]
                _turn_wrist(arm, T[n], q, R, p)
                break
            if last + 2 > queue.shape[0]:
                answers[n] = UNKNOWN
                break
            queue[last], queue[last + 1] = box, box
            # Cut the longer side. A turn moves the wrist by about rho times the angle.
            cut = 0 if box[1] - box[0] > pose.rho * (box[3] - box[2]) else 2
            middle = torso if cut == 0 else pan
            queue[last, cut + 1], queue[last + 1, cut] = middle, middle
            last += 2


@njit(cache=True)
def _turn_wrist(arm: ChainArrays, T: Floats, q: Floats, R: Floats, p: Floats) -> None:
    """Set the last joint of `q`, initially 0, so that the TCP has the roll of T (4, 4)."""
    fk_frames(arm.offsets, arm.axes, arm.tip, q, R, p)
    sine = cosine = 0.0
    for i in range(3):
        cosine += R[8, i, 1] * T[i, 1]
        sine += R[8, i, 2] * T[i, 1]
    q[7] = atan2(sine, cosine)
