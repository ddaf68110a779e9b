"""Drives among obstacles on a lattice of base poses, compiled: A* with edges that are checked lazily.

Hart, Nilsson & Raphael, "A formal basis for the heuristic determination of minimum cost paths", 1968. Lazy edges as in
Bohlin & Kavraki, "Path planning using lazy PRM", ICRA 2000. The heuristic is the distance along the ground to the goal.
Its weight makes the search find a drive soon, not the shortest one.
"""

from __future__ import annotations

import heapq
import math

import numpy as np
from numpy.typing import NDArray

from irm.compilation import njit
from irm.kernel_arguments import copy_row
from planners.collision.hit_kernels import CollisionQuery, configuration_hits, edge_hits

Array = NDArray[np.float64]

_NONE = np.uint64(0)
_UNSEEN, _FREE, _BLOCKED, _REACHED = np.uint8(0), np.uint8(1), np.uint8(2), np.uint8(3)
"""States of a node."""
_GREED = 1.5
"""Weight of the remaining distance."""
_RADIAN = 0.3
"""Distance [m] that a turn by one radian costs."""
NEAR = 1.6
"""Steps of the lattice from which the goal, which is not a node, is tried."""


@njit(cache=True)
def ways_to(goal: Array, parts: NDArray[np.int64], origin: Array, cell: float) -> Array:
    """Distances [m] from every cell (nx, ny) to the goal, through neighbouring cells of the same part, else inf."""
    nx, ny = parts.shape
    ways, diagonal = np.full((nx, ny), np.inf), math.sqrt(2.0) * cell
    gi = min(max(int((goal[0] - origin[0]) / cell), 0), nx - 1)
    gj = min(max(int((goal[1] - origin[1]) / cell), 0), ny - 1)
    ways[gi, gj] = 0.0
    changed = True
    while changed:
        # Sweeps in four directions: each carries distances across the whole map.
        changed = False
        for sweep in range(4):
            di, dj = 1 - 2 * (sweep & 1), 1 - (sweep & 2)
            for a in range(nx):
                i = a if di > 0 else nx - 1 - a
                for b in range(ny):
                    j = b if dj > 0 else ny - 1 - b
                    if parts[i, j] == 0:
                        continue
                    best = ways[i, j]
                    if 0 <= i - di < nx:
                        best = min(best, ways[i - di, j] + cell)
                        if 0 <= j - dj < ny:
                            best = min(best, ways[i - di, j - dj] + diagonal)
                        if 0 <= j + dj < ny:
                            best = min(best, ways[i - di, j + dj] + diagonal)
                    if 0 <= j - dj < ny:
                        best = min(best, ways[i, j - dj] + cell)
                    if best < ways[i, j] - 1e-9:
                        ways[i, j] = best
                        changed = True
    return ways


@njit(cache=True)
def search_lattice(  # noqa: C901  compiled: one loop over one state
    query: CollisionQuery,
    start: Array,
    goal: Array,
    ways: Array,
    origin: Array,
    cell: float,
    spacing: float,
    turns: int,
    step: float,
    most: int,
) -> tuple[Array, Array]:
    """Search a collision-free drive from one whole-body configuration to a base pose, with a fixed arm.

    Args:
        query: the collision query. `first_only` must be set.
        start: (3 + n,) free configuration, a node of the lattice.
        goal: (3,) free base pose. Its yaw may be any number of turns away.
        ways: (nx, ny) distances [m] of `ways_to`, in cells of edge `cell` [m], with the corner `origin` (2,).
        spacing: spacing [m] of nodes, with `turns` yaws each.
        step: largest motion [m] of a point of the robot between two checks.
        most: most nodes to reach.

    Returns:
        The drive (k, 3 + n), (0, 3 + n) if none was found, and the reached base poses (m, 3).
    """
    d, turn = start.shape[0], 2.0 * math.pi / turns
    low_x, low_y = math.floor((start[0] - origin[0]) / spacing), math.floor((start[1] - origin[1]) / spacing)
    mx = low_x + 1 + math.floor((origin[0] + cell * ways.shape[0] - start[0]) / spacing)
    my = low_y + 1 + math.floor((origin[1] + cell * ways.shape[1] - start[1]) / spacing)
    known, parents = np.zeros((mx, my, turns), np.uint8), np.full(mx * my * turns, -1)
    here, there, first = start.copy(), start.copy(), (low_x * my + low_y) * turns
    heap, reached, count, last = [(0.0, 0.0, first, first)], np.empty((most, 3)), 0, -1
    while len(heap) > 0 and count < most:
        _, cost, node, parent = heapq.heappop(heap)
        i, j, t = node // (my * turns), node // turns % my, node % turns
        if known[i, j, t] >= _BLOCKED:
            continue
        there[0] = start[0] + (i - low_x) * spacing
        there[1] = start[1] + (j - low_y) * spacing
        there[2] = start[2] + t * turn
        if known[i, j, t] == _UNSEEN:
            hit = configuration_hits(query, query.active, there[:3], there[3:]) != _NONE
            known[i, j, t] = _BLOCKED if hit else _FREE
            if hit:
                continue
        if parent != node:
            here[0] = start[0] + (parent // (my * turns) - low_x) * spacing
            here[1] = start[1] + (parent // turns % my - low_y) * spacing
            here[2] = there[2] + _wrapped((parent % turns - t) * turn)
            if edge_hits(query, here, there, step) != _NONE:
                continue
        known[i, j, t], parents[node] = _REACHED, parent
        copy_row(there[:3], reached[count])
        count += 1
        away_x, away_y, away = goal[0] - there[0], goal[1] - there[1], _wrapped(goal[2] - there[2])
        if max(abs(away_x), abs(away_y)) <= NEAR * spacing and abs(away) <= NEAR * turn:
            here[0], here[1], here[2] = goal[0], goal[1], there[2] + away
            if edge_hits(query, there, here, step) == _NONE:
                last = node
                break
        for move in range(10):
            a, b, c = i, j, t
            if move < 8:
                k = move if move < 4 else move + 1
                a, b = i + k // 3 - 1, j + k % 3 - 1
            else:
                c = (t + 2 * (move - 8) - 1) % turns
            if a < 0 or b < 0 or a >= mx or b >= my or known[a, b, c] >= _BLOCKED:
                continue
            x, y = start[0] + (a - low_x) * spacing, start[1] + (b - low_y) * spacing
            u = min(max(int((x - origin[0]) / cell), 0), ways.shape[0] - 1)
            v = min(max(int((y - origin[1]) / cell), 0), ways.shape[1] - 1)
            if ways[u, v] == math.inf:
                continue
            gone = cost + spacing * math.hypot(a - i, b - j) + _RADIAN * turn * (move >= 8)
            to_turn = abs(_wrapped(goal[2] - start[2] - c * turn))
            heapq.heappush(
                heap, (gone + _GREED * (ways[u, v] + _RADIAN * to_turn), gone, (a * my + b) * turns + c, node)
            )
    if last < 0:
        return np.empty((0, d)), reached[:count].copy()
    length, node = 2, last
    while parents[node] != node:
        length, node = length + 1, parents[node]
    path, node = np.empty((length, d)), last
    for row in range(length - 2, -1, -1):
        copy_row(start, path[row])
        path[row, 0] = start[0] + (node // (my * turns) - low_x) * spacing
        path[row, 1] = start[1] + (node // turns % my - low_y) * spacing
        path[row, 2] = start[2] + (node % turns) * turn
        node = parents[node]
    copy_row(start, path[length - 1])
    path[length - 1, :2], path[length - 1, 2] = goal[:2], goal[2]
    for row in range(1, length):
        path[row, 2] = path[row - 1, 2] + _wrapped(path[row, 2] - path[row - 1, 2])
    return path, reached[:count].copy()


@njit(cache=True)
def _wrapped(angle: float) -> float:
    """The same angle [rad], at most half a turn from 0."""
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)
