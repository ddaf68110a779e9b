"""Forward and inverse kinematics of a torso lift and an arm in the base frame, compiled.

The base frame lies on the floor under the robot, x ahead. A configuration `q` is torso and arm, shape (1 + n,).

Example:
    chain = ArmChain.from_robot(FETCH)
    T_base_tcp = forward(chain, FETCH.home)
    configurations = inverse(chain, T_base_tcp, torsos=[0.2], rolls=np.linspace(-np.pi, np.pi, 36))
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, sin

import numpy as np
from numpy.typing import ArrayLike, NDArray

from assets.robots import ChainLink, RobotSpec
from irm.arm.closed_form import MAX_SOLUTIONS, ik_arm
from irm.arm.manipulability import manipulability
from irm.compilation import njit
from irm.errors import ChainError

__all__ = [
    "ArmChain",
    "arm_jacobian",
    "fk_frames",
    "forward",
    "has_free_roll",
    "ik_arm",
    "inverse",
    "jacobian",
    "manipulability",
]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

PRISMATIC = 3
"""Added to the axis number (x 0, y 1, z 2) of a joint that slides along its axis."""

_FULL_TURN_ROUNDING = 1e-6
"""[rad] A joint range shorter than a full turn by less counts as unlimited."""

FETCH_AXES = (2 + PRISMATIC, 2, 1, 0, 1, 0, 1, 0)


@dataclass(frozen=True)
class ArmChain:
    """A robot's torso and arm as arrays for kernels. Arrays are read-only.

    Attributes:
        robot: its name.
        offsets: (1 + n, 3) origin of each joint frame in its parent's frame [m].
        axes: (1 + n,) 0, 1, 2 for hinges about x, y, z; 3, 4, 5 for slides along them.
        lower, upper: (1 + n,) joint limits [m], [rad].
        tip: (3,) TCP in the last link's frame [m].
        links: (7,) lengths for `irm.arm.closed_form`; empty for arms without a closed form.
    """

    robot: str
    offsets: Floats
    axes: Integers
    lower: Floats
    upper: Floats
    tip: Floats
    links: Floats

    @property
    def has_closed_form(self) -> bool:
        """Whether `inverse` works for this arm."""
        return self.links.size > 0

    @property
    def size(self) -> int:
        """Number of joints, torso included."""
        return self.axes.size

    @staticmethod
    def from_robot(robot: RobotSpec) -> ArmChain:
        """The chain of a robot.

        Raises:
            ChainError: its first joint is no vertical slide, or it names a closed form that does not fit it.
        """
        axes = np.array([_axis_number(link) for link in robot.chain], dtype=np.int64)
        if axes[0] != 2 + PRISMATIC:
            raise ChainError(
                f"{robot.name}: the first joint of the chain must slide along z (lower = upper for a robot without a "
                f"lift), not {robot.chain[0]}"
            )
        arrays = {
            "offsets": np.array([link.offset for link in robot.chain], dtype=float),
            "axes": axes,
            "lower": np.array([link.lower for link in robot.chain], dtype=float),
            "upper": np.array([link.upper for link in robot.chain], dtype=float),
            "tip": np.array(robot.tcp_offset, dtype=float),
            "links": _closed_form_links(robot, axes),
        }
        for array in arrays.values():
            array.setflags(write=False)
        return ArmChain(robot.name, **arrays)


def has_free_roll(chain: ArmChain) -> bool:
    """Whether the last joint turns the gripper about its approach axis without limit."""
    turns_about_approach = chain.axes[-1] == 0 and not chain.tip[1:].any()
    return bool(turns_about_approach and chain.upper[-1] - chain.lower[-1] >= 2 * np.pi - _FULL_TURN_ROUNDING)


def _axis_number(link: ChainLink) -> int:
    if link.axis not in ("x", "y", "z"):
        raise ChainError(f"{link.joint}: axis {link.axis!r} is none of 'x', 'y', 'z'")
    return "xyz".index(link.axis) + (PRISMATIC if link.prismatic else 0)


def _closed_form_links(robot: RobotSpec, axes: Integers) -> Floats:
    """The seven lengths of `irm.arm.closed_form`, from the chain; empty if the robot names no closed form."""
    if robot.closed_form_ik == "":
        return np.empty(0)
    if robot.closed_form_ik != "fetch":
        raise ChainError(f"{robot.name}: no closed form {robot.closed_form_ik!r}; known: 'fetch', or '' for none")
    offset = np.array([link.offset for link in robot.chain])
    along_x = np.vstack([offset[3:], [robot.tcp_offset]])
    limits = np.array([(link.lower, link.upper) for link in robot.chain])
    fits = (
        tuple(axes.tolist()) == FETCH_AXES
        and not along_x[:, 1:].any()
        and not offset[:3, 1].any()
        and offset[2, 0] > 0.0
        and bool(np.allclose(limits[[4, 6], 0], -limits[[4, 6], 1]))
        and bool(np.all(limits[[3, 5, 7], 0] <= -np.pi))
        and bool(np.all(limits[[3, 5, 7], 1] >= np.pi))
    )
    if not fits:
        raise ChainError(
            f"{robot.name}: the closed form 'fetch' needs a vertical slide, then axes z y x y x y x with every offset "
            "after the shoulder along x and none to the side, symmetric limits of elbow and wrist flex, and free rolls"
        )
    return np.array(
        [
            offset[0, 0] + offset[1, 0],
            offset[0, 2] + offset[1, 2],
            offset[2, 0],
            offset[2, 2],
            offset[3, 0] + offset[4, 0],
            offset[5, 0] + offset[6, 0],
            offset[7, 0] + robot.tcp_offset[0],
        ]
    )


@njit(cache=True)
def fk_frames(offsets: Floats, axes: Integers, tip: Floats, q: Floats, R: Floats, p: Floats) -> None:
    """Frames of every link in the base frame, each after its own joint's motion.

    Args:
        offsets, axes, tip: of `ArmChain`.
        q: (n,) torso and arm.
        R: (n + 1, 3, 3) filled with orientations; the last one is the TCP's.
        p: (n + 1, 3) filled with origins [m].
    """
    n = axes.shape[0]
    for k in range(n):
        o = offsets[k]
        if k == 0:
            for i in range(3):
                p[0, i] = o[i]
                for j in range(3):
                    R[0, i, j] = 1.0 if i == j else 0.0
        else:
            for i in range(3):
                p[k, i] = p[k - 1, i] + R[k - 1, i, 0] * o[0] + R[k - 1, i, 1] * o[1] + R[k - 1, i, 2] * o[2]
                for j in range(3):
                    R[k, i, j] = R[k - 1, i, j]
        axis = axes[k]
        if axis >= PRISMATIC:
            for i in range(3):
                p[k, i] += R[k, i, axis - PRISMATIC] * q[k]
        else:
            c, s = cos(q[k]), sin(q[k])
            u, v = (axis + 1) % 3, (axis + 2) % 3
            for i in range(3):
                a, b = R[k, i, u], R[k, i, v]
                R[k, i, u] = c * a + s * b
                R[k, i, v] = c * b - s * a
    for i in range(3):
        p[n, i] = p[n - 1, i] + R[n - 1, i, 0] * tip[0] + R[n - 1, i, 1] * tip[1] + R[n - 1, i, 2] * tip[2]
        for j in range(3):
            R[n, i, j] = R[n - 1, i, j]


@njit(cache=True)
def arm_jacobian(axes: Integers, R: Floats, p: Floats, J: Floats) -> None:
    """Geometric Jacobian (6, n - 1) of the arm alone at the frames of `fk_frames`: linear rows first, base frame."""
    n = axes.shape[0]
    for k in range(1, n):
        axis = axes[k] % PRISMATIC
        ax, ay, az = R[k, 0, axis], R[k, 1, axis], R[k, 2, axis]
        dx, dy, dz = p[n, 0] - p[k, 0], p[n, 1] - p[k, 1], p[n, 2] - p[k, 2]
        if axes[k] >= PRISMATIC:
            J[0, k - 1], J[1, k - 1], J[2, k - 1] = ax, ay, az
            J[3, k - 1], J[4, k - 1], J[5, k - 1] = 0.0, 0.0, 0.0
        else:
            J[0, k - 1], J[1, k - 1], J[2, k - 1] = ay * dz - az * dy, az * dx - ax * dz, ax * dy - ay * dx
            J[3, k - 1], J[4, k - 1], J[5, k - 1] = ax, ay, az


def _frames(chain: ArmChain, q: ArrayLike) -> tuple[Floats, Floats]:
    configuration = np.array(q, dtype=float)
    if configuration.shape != (chain.size,):
        raise ChainError(
            f"{chain.robot}: a configuration has shape ({chain.size},), torso and arm, not {configuration.shape}"
        )
    R = np.empty((chain.size + 1, 3, 3))
    p = np.empty((chain.size + 1, 3))
    fk_frames(chain.offsets, chain.axes, chain.tip, configuration, R, p)
    return R, p


def forward(chain: ArmChain, q: ArrayLike) -> Floats:
    """T_base_tcp (4, 4) of a configuration (1 + n,)."""
    R, p = _frames(chain, q)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R[-1], p[-1]
    return T


def jacobian(chain: ArmChain, q: ArrayLike) -> Floats:
    """Geometric Jacobian (6, n) of the TCP with respect to the arm joints, in the base frame.

    Rows: linear velocity [m] per unit of joint motion, then angular [rad]. The torso has no column.
    """
    R, p = _frames(chain, q)
    J = np.empty((6, chain.size - 1))
    arm_jacobian(chain.axes, R, p, J)
    return J


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
        raise ChainError(f"{chain.robot} has no closed form; use irm.arm.numerical.solve")
    T = np.ascontiguousarray(T_base_tcp, dtype=float)
    if T.shape != (4, 4):
        raise ChainError(f"T_base_tcp has shape (4, 4), not {T.shape}")
    heights = np.atleast_1d(np.asarray(torsos, dtype=float))
    angles = np.atleast_1d(np.asarray(rolls, dtype=float))
    rows = np.empty((MAX_SOLUTIONS * heights.size * angles.size, 8))
    R, p = np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3])
    count = _inverse_grid(chain.links, R, p, heights, angles, chain.lower, chain.upper, rows)
    return rows[:count].copy()
