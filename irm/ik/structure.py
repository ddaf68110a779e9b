"""The geometry of an arm that gives it a closed form: axes that meet in one point, or that are parallel.

Two structures are known, which most arms of 6 or 7 hinges have:

- A spherical wrist: three successive axes at one end meet in a point. Of the other joints, the first one is a free
  parameter if there are seven; the next two axes meet; the last one is the elbow. The three axes may be the last ones
  (PR2, Kinova Gen3, KUKA iiwa) or the first ones (Panda, xArm 7): then the arm is solved from the TCP to the base.
- Six joints of which the second, third and fourth are parallel, and the last two meet (UR).
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.chain import PRISMATIC, ArmChain
from irm.kinematics import link_frames

Floats = NDArray[np.float64]
_MEET = 5e-4
"""[m] Axes that pass each other this closely count as meeting: model files have rounded numbers, and the wrist of the
Kinova Gen3 is 0.2 mm off. Solutions are refined afterwards."""
_SLACK_PER_METRE = 20.0
"""[rad/m] How much joint angles of such an arm may differ from the exact ones, per length by which axes miss each
other: a lever arm of 5 cm."""
_ROUNDING = 1e-9
"""[rad] Slack of an arm whose axes meet exactly."""
_PARALLEL = 2e-5
"""Sine of the angle below which two axes are parallel, for the same reason."""
_APART = 1e-3
"""Sine of the angle above which two axes are certainly not parallel."""
_ARC = 1.0 + 1e-6
"""Of an angle so small to its sine, at most."""
CLOSED_FORM, SPHERICAL, PARALLEL, ITERATIVE = range(4)
"""How an arm is solved: by `irm.ik.closed_form`, by the two structures of this file, or by iteration."""


class SphericalArm(NamedTuple):
    """An arm with a spherical wrist, at zero, in the frame that it is solved from.

    `axes` (7, 3), in the order of solving; for six joints the first one is no joint. Points (3,) [m]: `pivot` on the
    free axis, `shoulder` where the next two axes meet, `elbow` on the fourth axis, `wrist` where the last two meet;
    `offset` (3,) from the fifth axis to the wrist: 0 if it is spherical. `R_tool` (3, 3) and `tool`
    (3,): end at zero. `lower`, `upper` (7,) in the same order. `columns` (7,): joint of the chain, -1 for none.
    `reversed`: whether the arm is solved from the TCP to the base. `slack`: error of the solutions' angles [rad].
    `error`: largest distance of its TCP positions from those of the arm whose axes do not quite meet [m].
    """

    axes: Floats
    pivot: Floats
    shoulder: Floats
    elbow: Floats
    wrist: Floats
    offset: Floats
    R_tool: Floats
    tool: Floats
    lower: Floats
    upper: Floats
    columns: NDArray[np.int64]
    reversed: bool
    slack: float
    error: float


class ParallelArm(NamedTuple):
    """Six joints of which the second to fourth are parallel, at zero, in the base frame.

    `axes` (6, 3); `points` (5, 3) on the axes: the last one is where the fifth and sixth axes meet [m]. `R_tool` (3, 3)
    and `tool` (3,): TCP at zero. `lower`, `upper` (6,). `slack`: error of the solutions [rad]. `error`, `turn`: largest
    differences of its TCP poses from those of the arm whose axes are not quite parallel, or meet not quite [m], [rad].
    """

    axes: Floats
    points: Floats
    R_tool: Floats
    tool: Floats
    lower: Floats
    upper: Floats
    slack: float
    error: float
    turn: float


class _Line(NamedTuple):
    """An axis: a point on it and its direction."""

    point: Floats
    axis: Floats


def find_structure(chain: ArmChain) -> SphericalArm | ParallelArm | None:
    """The structure of an arm; None if it has no closed form that is known here."""
    if np.any(chain.axes[1:] >= PRISMATIC):
        return None
    from_base, from_tcp = _views(chain)
    return _spherical(chain, from_base) or _spherical(chain, from_tcp) or _parallel(chain, from_base)


def find_bounds(chain: ArmChain) -> SphericalArm | None:
    """For an arm without such a structure: one with a closed form once the fifth joint is fixed too, for proofs of NO.

    The last two axes of seven meet, and two others as for a spherical wrist. With six joints there is one more, fixed,
    at either end. None if no axes of the arm are such; of several ones that with the smallest offset.
    """
    if np.any(chain.axes[1:] >= PRISMATIC):
        return None
    found = [arm for view in _views(chain) for is_last in (False, True) if (arm := _offset_wrist(chain, view, is_last))]
    return min(found, key=lambda arm: float(np.linalg.norm(arm.offset)), default=None)


class _View(NamedTuple):
    """An arm at zero, seen from one of its ends: its lines, and the other end."""

    lines: list[_Line]
    R_tool: Floats
    tool: Floats
    reversed: bool


def _views(chain: ArmChain) -> tuple[_View, _View]:
    n = chain.size
    R, p = link_frames(chain, np.zeros(n))
    lines = [_Line(p[k], R[k][:, chain.axes[k] % PRISMATIC]) for k in range(1, n)]
    # Seen from the TCP the joints come in the opposite order, and each one turns the other way.
    from_tcp = [_Line(R[n].T @ (line.point - p[n]), -(R[n].T @ line.axis)) for line in reversed(lines)]
    return _View(lines, R[n], p[n], False), _View(from_tcp, R[n].T, -R[n].T @ p[n], True)


def _spherical(chain: ArmChain, view: _View) -> SphericalArm | None:
    wrist, away = _common_point(view.lines[-3:])
    return _with_wrist(chain, view, view.lines, wrist, away) if away.max() <= _MEET else None


def _offset_wrist(chain: ArmChain, view: _View, is_last: bool) -> SphericalArm | None:
    """The arm with a wrist on its last two axes; `is_last`: of six joints add the seventh, in place of the first."""
    lines = list(view.lines)
    if len(lines) == 6 and is_last:
        before, last = lines[-2:]
        side = np.cross(before.axis, last.axis)
        if np.linalg.norm(side) < _APART:
            return None
        # Where the last axis is nearest to the one before: its component across that one must vanish.
        across = np.cross(before.axis, side)
        at = last.point + last.axis * float(across @ (before.point - last.point)) / float(across @ last.axis)
        lines.append(_Line(at, np.cross(last.axis, side / np.linalg.norm(side))))
    elif is_last:
        return None
    wrist, away = _common_point(lines[-2:])
    if away.max() > _MEET or np.linalg.norm(np.cross(lines[-3].axis, lines[-2].axis)) < _APART:
        return None
    arm = _with_wrist(chain, view, lines, wrist, away)
    if arm is None:
        return None
    offset = wrist - lines[-3].point
    return arm._replace(offset=offset - lines[-3].axis * float(lines[-3].axis @ offset))


def _with_wrist(
    chain: ArmChain, view: _View, lines: list[_Line], wrist: Floats, from_wrist: Floats
) -> SphericalArm | None:
    """The arm of six or seven `lines`, those of the view and perhaps a fixed one after them, with a known wrist."""
    shoulder, from_shoulder = _common_point(lines[-6:-4])
    if from_shoulder.max() > _MEET:
        return None
    columns = list(range(1, chain.size))[:: -1 if view.reversed else 1]
    limits = [(float(chain.lower[k]), float(chain.upper[k])) for k in columns]
    if len(lines) == 6:
        lines = [_Line(shoulder, np.array([0.0, 0.0, 1.0])), *lines]
        columns, limits = [-1, *columns], [(0.0, 0.0), *limits]
    elif len(columns) == 6:
        columns, limits = [*columns, -1], [*limits, (0.0, 0.0)]
    error = float(from_wrist.max() + from_shoulder.max())
    return SphericalArm(
        axes=np.array([line.axis for line in lines]),
        pivot=lines[0].point,
        shoulder=shoulder,
        elbow=lines[3].point,
        wrist=wrist,
        offset=np.zeros(3),
        R_tool=np.ascontiguousarray(view.R_tool),
        tool=view.tool,
        lower=np.array([low for low, _ in limits]),
        upper=np.array([high for _, high in limits]),
        columns=np.array(columns),
        reversed=view.reversed,
        slack=_ROUNDING + _SLACK_PER_METRE * error,
        # An axis that is moved to one side moves what it turns by less than twice as much.
        error=float(2.0 * (from_wrist.sum() + from_shoulder.sum())),
    )


def _parallel(chain: ArmChain, view: _View) -> ParallelArm | None:
    lines = view.lines
    if len(lines) != 6:
        return None
    along = lines[1].axis
    meeting, away = _common_point(lines[4:])
    tilt = sum(float(np.linalg.norm(np.cross(along, line.axis))) for line in lines[2:4])
    if away.max() > _MEET or tilt > 2 * _PARALLEL:
        return None
    # An axis that is tilted turns the TCP by less than twice as much, at most at the reach of the arm.
    turn = 2.0 * tilt * _ARC
    axes = np.array([line.axis for line in lines])
    axes[2:4] = np.sign(axes[2:4] @ along)[:, None] * along
    return ParallelArm(
        axes=axes,
        points=np.array([*(line.point for line in lines[:4]), meeting]),
        R_tool=view.R_tool.copy(),
        tool=view.tool.copy(),
        lower=chain.lower[1:].copy(),
        upper=chain.upper[1:].copy(),
        slack=float(_ROUNDING + _SLACK_PER_METRE * (away.max() + turn * chain.reach)),
        error=float(2.0 * away.sum() + turn * chain.reach),
        turn=turn,
    )


def _common_point(lines: list[_Line]) -> tuple[Floats, Floats]:
    """The point nearest to some axes, and its distances from them [m]: infinite if neighbours are parallel."""
    if any(np.linalg.norm(np.cross(a.axis, b.axis)) < _PARALLEL for a, b in itertools.pairwise(lines)):
        return np.full(3, np.nan), np.full(len(lines), np.inf)
    projections = [np.eye(3) - np.outer(line.axis, line.axis) for line in lines]
    rest = [P @ line.point for P, line in zip(projections, lines, strict=True)]
    point = np.linalg.solve(np.sum(projections, axis=0), np.sum(rest, axis=0))
    return point, np.array([np.linalg.norm(P @ point - r) for P, r in zip(projections, rest, strict=True)])
