"""Answers of a certificate table: find the cell of a pose and compare its bearing with the arcs, compiled."""

from __future__ import annotations

from math import atan2, hypot, pi

import numpy as np
from numpy.typing import NDArray

from irm.arm.angles import wrap
from irm.arm.answers import NO, OPEN, YES
from irm.arm.chain_arrays import ChainArrays
from irm.compilation import njit
from irm.maps.certificate.cells import CellArrays
from irm.maps.certificate.fill_kernel import ALL_TURNS, CODES, LIKELY, NO_TURN, POSSIBLE, SURE

__all__ = ["look_up"]

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]

_ROUNDING = 1e-9
"""Part of a cell by which rounding may move a pose beyond the last one."""


@njit(cache=True)
def look_up(
    arm: ChainArrays,
    cells: CellArrays,
    arcs: Bytes,
    T: Floats,
    answers: NDArray[np.int8],
    likely: NDArray[np.bool_],
) -> None:
    """Fill `answers` (n,) and `likely` (n,) for poses T (n, 4, 4), given the `arcs` of all cells."""
    for n in range(T.shape[0]):
        answers[n], likely[n] = NO, False
        rho, height, bearing, yaw, elevation, least_pan = _coordinates(arm, T[n])
        column, layer = rho / cells.width, (height - cells.bottom) / cells.thickness
        if column > cells.columns + _ROUNDING or layer < -_ROUNDING or layer > cells.layers + _ROUNDING:
            continue
        i, j = min(cells.columns - 1, int(column)), min(cells.layers - 1, max(0, int(layer)))
        arc = arcs[i, j, _approach_cell(cells, yaw, elevation)]
        beyond, pan_range = bearing - least_pan + pi, arm.upper[1] - arm.lower[1]
        likely[n] = _contains(arc[LIKELY], beyond, pan_range)
        if _contains(arc[SURE], beyond, pan_range):
            answers[n] = YES
        elif _contains(arc[POSSIBLE], beyond, pan_range):
            answers[n] = OPEN


@njit(cache=True)
def _coordinates(arm: ChainArrays, T: Floats) -> tuple[float, float, float, float, float, float]:
    """Of a pose (4, 4): distance, height [m] and bearing of the wrist centre, yaw relative to it and elevation of the
    approach, and the smallest pan angle [rad]. With a negative relative yaw, all is mirrored."""
    links = arm.links
    x, y = T[0, 3] - links[6] * T[0, 0] - links[0], T[1, 3] - links[6] * T[1, 0]
    height = T[2, 3] - links[6] * T[2, 0] - links[1] - links[3]
    bearing = atan2(y, x)
    yaw = wrap(atan2(T[1, 0], T[0, 0]) - bearing)
    elevation = atan2(T[2, 0], hypot(T[0, 0], T[1, 0]))
    if yaw < 0.0:
        return hypot(x, y), height, -bearing, -yaw, elevation, -arm.upper[1]
    return hypot(x, y), height, bearing, yaw, elevation, arm.lower[1]


@njit(cache=True)
def _approach_cell(cells: CellArrays, yaw: float, elevation: float) -> int:
    """The cell of approach axes with a relative yaw ≥ 0 and an elevation [rad]."""
    rings = cells.ring_first.shape[0] - 1
    ring = min(rings - 1, max(0, int((elevation / pi + 0.5) * rings)))
    first = cells.ring_first[ring]
    count = cells.ring_first[ring + 1] - first
    return first + min(count - 1, int(yaw / pi * count))


@njit(cache=True)
def _contains(arc: Bytes, beyond: float, pan_range: float) -> bool:
    """Whether an arc of turns plus the range of pan angles contains a bearing.

    `beyond`: that bearing minus the smallest pan angle, from turn -π on [rad].
    """
    first, last = int(arc[0]), int(arc[1])
    if first >= ALL_TURNS:
        return first != NO_TURN
    unit = 2.0 * pi / CODES
    return (beyond - first * unit) % (2.0 * pi) <= ((last - first) % CODES) * unit + pan_range
