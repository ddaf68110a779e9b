"""Drives among obstacles on a lattice of base poses, compiled: A* with edges that are checked lazily.

Hart, Nilsson & Raphael, "A formal basis for the heuristic determination of minimum cost paths", 1968. Lazy edges as in
Bohlin & Kavraki, "Path planning using lazy PRM", ICRA 2000. The heuristic is the distance along the ground to the goal.
Its weight makes the search find a drive soon, not the shortest one.
"""

from __future__ import annotations

import heapq
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.compilation import njit
from irm.kernel_arguments import copy_row
from planners.clock import NO_DEADLINE, Deadline
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
_AT_ONCE = 10_000
"""Nodes to look at between two looks at the clock: about 20 ms."""


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


def search_lattice(
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
    deadline: Deadline = NO_DEADLINE,
) -> tuple[Array, Array | None]:
    """Search a collision-free drive from one whole-body configuration to a base pose, with a fixed arm.

    Args:
        query: the collision query. `first_only` must be set.
        start: (3 + n,) free configuration, a node of the lattice.
        goal: (3,) free base pose. Its yaw may be any number of turns away.
        ways: (nx, ny) distances [m] of `ways_to`, in cells of edge `cell` [m], with the corner `origin` (2,).
        spacing: spacing [m] of nodes, with `turns` yaws each.
        step: largest motion [m] of a point of the robot between two checks.
        most: most nodes to reach.
        deadline: when to stop.

    Returns:
        The drive (k, 3 + n), (0, 3 + n) if none was found, and the reached base poses (m, 3), None at the deadline.
    """
    lattice = _lattice_about(start, ways.shape, origin, cell, spacing, turns)
    heap, reached, count, last = np.array([(0.0, 0.0, lattice.first, lattice.first)]), np.empty((most, 3)), 0, -1
    while last < 0 and len(heap) and count < most:
        if deadline.is_over:
            return np.empty((0, len(start))), None
        heap, count, last = _go_on(query, lattice, start, goal, ways, origin, cell, step, heap, reached, count)
    path = _drive_to(lattice, start, goal, last) if last >= 0 else np.empty((0, len(start)))
    return path, reached[:count].copy()


class _Lattice(NamedTuple):
    """The nodes of a search, its start among them, with what is known of each.

    Attributes:
        spacing, turn: [m] and [rad] between nodes.
        low_x, low_y: indices of the start.
        first: number of the start.
        known: (mx, my, turns) states.
        parents: (mx * my * turns,) number of the node before each, -1 for none.
    """

    spacing: float
    turn: float
    low_x: int
    low_y: int
    first: int
    known: NDArray[np.uint8]
    parents: NDArray[np.int64]


def _lattice_about(
    start: Array, cells: tuple[int, ...], origin: Array, cell: float, spacing: float, turns: int
) -> _Lattice:
    """The lattice with a node at the start, over a map of so many cells."""
    low_x, low_y = (math.floor((start[k] - origin[k]) / spacing) for k in (0, 1))
    mx, my = (
        low + 1 + math.floor((origin[k] + cell * cells[k] - start[k]) / spacing) for k, low in ((0, low_x), (1, low_y))
    )
    known, parents = np.zeros((mx, my, turns), np.uint8), np.full(mx * my * turns, -1)
    return _Lattice(spacing, 2.0 * math.pi / turns, low_x, low_y, (low_x * my + low_y) * turns, known, parents)


@njit(cache=True)
def _go_on(
    query: CollisionQuery,
    lattice: _Lattice,
    start: Array,
    goal: Array,
    ways: Array,
    origin: Array,
    cell: float,
    step: float,
    queue: Array,
    reached: Array,
    count: int,
) -> tuple[Array, int, int]:
    """Go on with a search, as if it had not been interrupted, until `_AT_ONCE` nodes are looked at.

    `queue` (m, 4) is a heap of nodes to look at: estimated cost to the goal [m], cost so far [m], node, node before it.
    The poses of reached nodes go to `reached`, after the first `count`. Returns queue, count, and the node from which
    the goal is reached, -1 for none.
    """
    spacing, turn, low_x, low_y, _, known, parents = lattice
    mx, my, turns = known.shape
    here, there = start.copy(), start.copy()
    heap = [(queue[k, 0], queue[k, 1], int(queue[k, 2]), int(queue[k, 3])) for k in range(len(queue))]
    for _ in range(_AT_ONCE):
        if len(heap) == 0 or count == len(reached):
            break
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
                return np.empty((0, 4)), count, node
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
    left = np.empty((len(heap), 4))
    for k in range(len(heap)):
        left[k, 0], left[k, 1], left[k, 2], left[k, 3] = heap[k]
    return left, count, -1


@njit(cache=True)
def _drive_to(lattice: _Lattice, start: Array, goal: Array, last: int) -> Array:
    """The drive (k, 3 + n) over the nodes up to the `last` one, and from there to the goal."""
    spacing, turn, low_x, low_y, _, known, parents = lattice
    _, my, turns = known.shape
    length, node = 2, last
    while parents[node] != node:
        length, node = length + 1, parents[node]
    path, node = np.empty((length, start.shape[0])), last
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
    return path


@njit(cache=True)
def _wrapped(angle: float) -> float:
    """The same angle [rad], at most half a turn from 0."""
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)
