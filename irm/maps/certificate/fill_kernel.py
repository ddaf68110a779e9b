"""Fills a certificate table: the arcs of turns at which the arm certainly, probably, and possibly reaches, compiled.

A turn is the bearing of the wrist centre minus the pan angle. For one cell the turns at which the arm reaches form some
arcs. Turns plus pan angles are the bearings at which the wrist centre is in reach. Pan has a range of at least half a
turn, so of the gaps between the arcs at most one remains, and one arc describes the cell.
"""

from __future__ import annotations

from math import ceil, cos, floor, pi, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.arm.chain_arrays import ChainArrays
from irm.arm.plane_bounds import WristBox
from irm.compilation import njit
from irm.maps.certificate.forearm_kernel import forearm_cone

__all__ = ["ALL_TURNS", "CODES", "LIKELY", "NO_TURN", "POSSIBLE", "SURE", "fill_column"]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Bytes = NDArray[np.uint8]

TURNS = 144
"""Turns that are tried, 2.5 degrees apart; an even number."""

CODES = 250
"""Steps of a full turn in which the ends of arcs are stored."""

ALL_TURNS, NO_TURN = 254, 255
"""Stored in place of an arc."""

SURE, LIKELY, POSSIBLE = 0, 1, 2
"""The three arcs of a cell."""

_CUTS = ((3, 1, 1), (1, 1, 1), (2, 2, 2))
"""Parts of a box in distance, turn and height for each of the three."""


class _Forearms(NamedTuple):
    """Cones of forearms for each turn, by height: `axis` (turns, n, 3), the cosine and sine of the largest angle to an
    approach axis that the wrist allows `limit` (turns, n, 2), and `first` (turns, heights + 1)."""

    axis: Floats
    limit: Floats
    first: Integers


@njit(cache=True)
def _forearms(
    arm: ChainArrays, rho: tuple[float, float], heights: Floats, kind: int, widest: float, is_between: bool
) -> _Forearms:
    """The forearms for all turns and for `heights` (n + 1,), at these or between them, of one kind of arc."""
    count = heights.shape[0] - 1
    axis, limit = np.empty((TURNS, 2 * count, 3)), np.empty((TURNS, 2 * count, 2))
    first = np.zeros((TURNS, count + 1), np.int64)
    step = 2.0 * pi / TURNS
    for j in range(TURNS):
        found = 0
        for k in range(count):
            first[j, k] = found
            turn0, turn1 = -pi + j * step, -pi + (j + 1) * step
            if kind != POSSIBLE:
                turn0 = turn1 = -pi + (j + 0.5) * step
            height1 = heights[k + 1] if is_between else heights[k]
            box = WristBox(rho[0], rho[1], turn0, turn1, heights[k], height1)
            for branch in range(2):
                cone = forearm_cone(arm.links, arm.lower, arm.upper, box, branch, _CUTS[kind])
                if not (cone.is_possible if kind == POSSIBLE else cone.is_certain):
                    continue
                angle = arm.upper[6] + (cone.radius if kind == POSSIBLE else -cone.radius)
                if angle < widest:
                    continue
                axis[j, found, 0], axis[j, found, 1], axis[j, found, 2] = cone.x, cone.y, cone.z
                everything = angle > pi - widest
                limit[j, found, 0] = -2.0 if everything else cos(angle)
                limit[j, found, 1] = 0.0 if everything else sin(angle)
                found += 1
        first[j, count] = found
    return _Forearms(axis, limit, first)


@njit(cache=True)
def _is_reached(forearms: _Forearms, turn: int, window: tuple[int, int], approach: Floats, c: float, s: float) -> bool:
    """Whether a forearm at a turn allows an approach axis; c, s: cosine and signed sine of the cell's radius."""
    for k in range(forearms.first[turn, window[0]], forearms.first[turn, window[1]]):
        cosine = (
            forearms.axis[turn, k, 0] * approach[0]
            + forearms.axis[turn, k, 1] * approach[1]
            + forearms.axis[turn, k, 2] * approach[2]
        )
        if cosine >= forearms.limit[turn, k, 0] * c - forearms.limit[turn, k, 1] * s:
            return True
    return False


@njit(cache=True)
def _arc(
    forearms: _Forearms, window: tuple[int, int], approach: Floats, c: float, s: float, pan_range: float, kind: int
) -> tuple[int, int]:
    """The arc of turns of one cell as codes: its first and its last turn."""
    step = 2.0 * pi / TURNS
    half = 0.5 if kind == POSSIBLE else 0.0
    for middle in (0, TURNS // 2):
        if _is_reached(forearms, middle, window, approach, c, s):
            continue
        first, last = 1, 1
        while first < TURNS and not _is_reached(forearms, (middle + first) % TURNS, window, approach, c, s):
            first += 1
        if first == TURNS:
            return NO_TURN, NO_TURN
        while not _is_reached(forearms, (middle - last) % TURNS, window, approach, c, s):
            last += 1
        if (first + last - 2.0 * half) * step > pan_range:
            low = (middle + first - half + 0.5) * CODES / TURNS
            high = (middle - last + TURNS + half + 0.5) * CODES / TURNS
            return _codes(low, high, kind)
    return ALL_TURNS, ALL_TURNS


@njit(cache=True)
def _codes(low: float, high: float, kind: int) -> tuple[int, int]:
    """An arc in steps from turn -π, rounded inward if it is sure and outward if it is possible."""
    if kind == SURE:
        first, last = ceil(low), floor(high)
    elif kind == LIKELY:
        first, last = floor(low + 0.5), floor(high + 0.5)
    else:
        first, last = floor(low), ceil(high)
    if last < first:
        return NO_TURN, NO_TURN
    if last - first >= CODES:
        return ALL_TURNS, ALL_TURNS
    return first % CODES, last % CODES


@njit(cache=True)
def fill_column(
    arm: ChainArrays, rho: tuple[float, float], layers: tuple[float, float, int], axes: Floats, column: Bytes
) -> None:
    """Fill the cells of one distance.

    Args:
        arm: with the structure of Fetch's arm.
        rho: smallest and largest distance of the wrist centre from the pan axis [m].
        layers: lowest height of the wrist centre above the lift axis, thickness of a layer [m], number of layers.
        axes: (m, 4) of `CertificateCells.approach_axes`.
        column: (layers, m, 3, 2) filled with first and last turn of the three arcs. Between two heights of the wrist
            centre that differ by the lift's range the torso makes up for the difference.
    """
    bottom, thickness, count = layers
    widest = axes[:, 3].max()
    steps = int((arm.upper[0] - arm.lower[0]) / thickness + 0.5)
    pan_range = arm.upper[1] - arm.lower[1]
    heights = bottom - arm.upper[0] + np.arange(count + steps + 1) * thickness
    middle = 0.5 * (rho[0] + rho[1])
    for kind in range(3):
        at = (middle, middle) if kind == LIKELY else rho
        levels = heights + 0.5 * thickness if kind == LIKELY else heights
        is_between = kind == POSSIBLE or (kind == SURE and steps == 0)
        forearms = _forearms(arm, at, levels, kind, widest if kind != LIKELY else 0.0, is_between)
        for layer in range(count):
            lowest = layer + 1 if kind == SURE and steps > 0 else layer
            window = (lowest, layer + steps + 1)
            for m in range(axes.shape[0]):
                radius = axes[m, 3] if kind == POSSIBLE else (-axes[m, 3] if kind == SURE else 0.0)
                codes = _arc(forearms, window, axes[m], cos(radius), sin(radius), pan_range, kind)
                column[layer, m, kind, 0], column[layer, m, kind, 1] = codes
