"""Paths among obstacles, compiled: random trees, then shortcuts and parabolic blends.

RRT-Connect: Kuffner & LaValle, "RRT-Connect: An efficient approach to single-query path planning", ICRA 2000. Nodes are
whole-body configurations (d,): base, torso and arm. Joints with equal limits stay fixed. Each joint's weight in a
distance is how far it can move a point of the robot, so distances are in metres.

Shortcuts: Geraerts & Overmars, "Creating high-quality paths for motion planning", IJRR 2007.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from irm.compilation import njit
from irm.kernel_arguments import copy_row, copy_rows, leaf_kernel
from planners.collision.hit_kernels import (
    CollisionQuery,
    configuration_hits,
    edge_hits,
    edge_samples,
    is_clear_around,
    motion_on_edge,
)

Array = NDArray[np.float64]
_NONE = np.uint64(0)
_FROM_START, _FROM_GOAL, _NO_PARENT = np.int64(0), np.int64(1), np.int64(-1)
"""Row of each tree, and parent of its roots. They are typed, so that kernels are not compiled again for constants."""
_EXTENSION = 0.5
"""Length [m] by which a tree grows towards a random target."""
_LEAST_PROGRESS = 3
"""Steps that a blocked extension must have made to be kept."""
_AHEAD = 6
"""Steps that are checked together."""
_NEAR_SPREAD = 0.4
"""Standard deviation [m] of targets around the straight line, weighted by each joint's reach."""
_ARC_PIECES = 8
"""Straight segments that approximate a blend."""


@leaf_kernel
def _squared_distance(a: Array, b: Array, weights: Array) -> float:
    """Squared distance [m²] of two whole-body configurations (d,), with a weight (d,) for each joint."""
    total = 0.0
    for joint in range(a.shape[0]):
        difference = (a[joint] - b[joint]) * weights[joint]
        total += difference * difference
    return total


@leaf_kernel
def _nearest(nodes: Array, count: int, target: Array, weights: Array) -> int:
    """Index of the node nearest to `target` among the first `count`."""
    best, index = math.inf, 0
    for i in range(count):
        distance = _squared_distance(nodes[i], target, weights)
        if distance < best:
            best, index = distance, i
    return index


@leaf_kernel
def _write_share(start: Array, target: Array, share: int, parts: int, reached: Array) -> None:
    for joint in range(start.shape[0]):
        reached[joint] = start[joint] + (target[joint] - start[joint]) * share / parts


@leaf_kernel
def advance(query: CollisionQuery, start: Array, target: Array, step: float, reached: Array) -> int:
    """Move from `start` towards `target` until a collision. Write the last free configuration to `reached`.

    Several steps are checked together. They are checked singly only if an obstacle is close to the middle one.

    Returns:
        0 if blocked at once, 1 on the way, 2 if the target was reached.
    """
    reach, slack = query.attached.reach, query.scratch.slack
    parts = edge_samples(reach, start, target, step)
    for first in range(1, parts + 1, _AHEAD):
        last = min(first + _AHEAD - 1, parts)
        middle = (first + last) // 2
        if last > first:
            _write_share(start, target, middle, parts, reached)
            motion_on_edge(reach, start, target, max(middle - first, last - middle) / parts, slack)
            if is_clear_around(query, reached, query.opening, slack):
                continue
        for i in range(first, last + 1):
            _write_share(start, target, i, parts, reached)
            if configuration_hits(query, query.active, reached[:3], reached[3:]) != _NONE:
                _write_share(start, target, i - 1, parts, reached)
                return 1 if i > _LEAST_PROGRESS else 0
    _write_share(start, target, parts, parts, reached)
    return 2


@njit(cache=True)
def _joined(nodes: Array, parents: NDArray[np.int64], start_leaf: int, goal_leaf: int) -> Array:
    """Path (k, d) from the root of the first tree to a leaf, then from a leaf of the second tree to its root."""
    before, node = 0, start_leaf
    while node >= 0:
        before, node = before + 1, parents[_FROM_START, node]
    length, node = before, goal_leaf
    while node >= 0:
        length, node = length + 1, parents[_FROM_GOAL, node]
    path, node = np.empty((length, nodes.shape[2])), start_leaf
    for i in range(before - 1, -1, -1):
        copy_row(nodes[_FROM_START, node], path[i])
        node = parents[_FROM_START, node]
    node = goal_leaf
    for i in range(before, length):
        copy_row(nodes[_FROM_GOAL, node], path[i])
        node = parents[_FROM_GOAL, node]
    return path


@leaf_kernel
def _grow(
    nodes: Array, parents: NDArray[np.int64], counts: NDArray[np.int64], tree: int, parent: int, node: Array
) -> int:
    """Add a node to a tree and return its index."""
    index = counts[tree]
    copy_row(node, nodes[tree, index])
    parents[tree, index] = parent
    counts[tree] += 1
    return int(index)


@njit(cache=True)
def _draw(
    start: Array,
    goal: Array,
    lower: Array,
    upper: Array,
    weights: Array,
    near: float,
    rng: np.random.Generator,
    target: Array,
) -> None:
    """Write a random target within the bounds, with probability `near` around the straight line to the goal."""
    if rng.random() < near:
        share = rng.random()
        for joint in range(target.shape[0]):
            middle = start[joint] + (goal[joint] - start[joint]) * share
            drawn = middle + rng.standard_normal() * _NEAR_SPREAD / weights[joint]
            target[joint] = min(max(drawn, lower[joint]), upper[joint])
        return
    for joint in range(target.shape[0]):
        target[joint] = lower[joint] + (upper[joint] - lower[joint]) * rng.random()


@njit(cache=True)
def rrt_connect(
    query: CollisionQuery,
    start: Array,
    goals: Array,
    lower: Array,
    upper: Array,
    step: float,
    iterations: int,
    near: float,
    rng: np.random.Generator,
) -> Array:
    """Search a collision-free path from one whole-body configuration to one of several.

    Args:
        query: the collision query. `first_only` must be set.
        start: (d,) free configuration.
        goals: (g, d) free configurations.
        lower, upper: (d,) bounds of the random targets. A joint with equal bounds does not move.
        step: largest motion [m] of a point of the robot between two checks.
        iterations: most random targets.
        near: share of targets around the straight line from start to goal, where small detours are found sooner.
        rng: the same generator state gives the same path.

    Returns:
        The path (k, d), (0, d) if none was found.
    """
    weights = query.attached.reach
    d, capacity = start.shape[0], goals.shape[0] + 1 + 2 * iterations
    nodes, parents, counts = np.empty((2, capacity, d)), np.empty((2, capacity), np.int64), np.zeros(2, np.int64)
    _grow(nodes, parents, counts, _FROM_START, _NO_PARENT, start)
    for i in range(goals.shape[0]):
        _grow(nodes, parents, counts, _FROM_GOAL, _NO_PARENT, goals[i])
        if edge_hits(query, start, goals[i], step) == _NONE:
            path = np.empty((2, d))
            copy_row(start, path[0])
            copy_row(goals[i], path[1])
            return path
    target, reached, link = np.empty(d), np.empty(d), np.empty(d)
    tree = _FROM_START
    for _ in range(iterations):
        goal = goals[int(rng.random() * goals.shape[0])]
        _draw(start, goal, lower, upper, weights, near, rng, target)
        stem = _nearest(nodes[tree], counts[tree], target, weights)
        distance = math.sqrt(_squared_distance(nodes[tree, stem], target, weights))
        share = min(1.0, _EXTENSION / max(distance, 1e-12))
        for joint in range(d):
            target[joint] = nodes[tree, stem, joint] + share * (target[joint] - nodes[tree, stem, joint])
        if advance(query, nodes[tree, stem], target, step, reached):
            leaf = _grow(nodes, parents, counts, tree, stem, reached)
            other = 1 - tree
            stem = _nearest(nodes[other], counts[other], reached, weights)
            outcome = advance(query, nodes[other, stem], reached, step, link)
            if outcome == 2:
                return (
                    _joined(nodes, parents, leaf, stem) if tree == _FROM_START else _joined(nodes, parents, stem, leaf)
                )
            if outcome == 1:
                _grow(nodes, parents, counts, other, stem, link)
        tree = 1 - tree
    return np.empty((0, d))


@njit(cache=True)
def _spliced(path: Array, first: int, points: Array, last: int) -> Array:
    """The path with points (k, d) in place of the waypoints from `first` to `last`. `last` itself is kept."""
    spliced = np.empty((first + points.shape[0] + path.shape[0] - last, path.shape[1]))
    copy_rows(path[:first], spliced[:first])
    copy_rows(points, spliced[first : first + points.shape[0]])
    copy_rows(path[last:], spliced[first + points.shape[0] :])
    return spliced


@leaf_kernel
def _interpolate(path: Array, segment: int, share: float, point: Array) -> None:
    """Write the point (d,) at a share of a segment of the path."""
    for i in range(point.shape[0]):
        point[i] = path[segment, i] + (path[segment + 1, i] - path[segment, i]) * share


@njit(cache=True)
def _without_repeats(path: Array, weights: Array) -> Array:
    kept, count, last = np.empty(path.shape), 0, path.shape[0] - 1
    for i in range(path.shape[0]):
        if i in (0, last) or _squared_distance(path[i - 1], path[i], weights) > 1e-12:
            copy_row(path[i], kept[count])
            count += 1
    return kept[:count].copy()


@njit(cache=True)
def shortcut(query: CollisionQuery, path: Array, step: float, attempts: int, rng: np.random.Generator) -> Array:
    """Cut detours of a free path: first between waypoints, then between random points on it.

    Path (k, d) and result (j, d) have the same ends. `attempts` is the number of random shortcuts. `query` and `step`
    are as for `rrt_connect`.
    """
    first = 0
    while first < path.shape[0] - 2:
        for last in range(path.shape[0] - 1, first + 1, -1):
            if edge_hits(query, path[first], path[last], step) == _NONE:
                path = _spliced(path, first + 1, path[:0], last)
                break
        first += 1
    ends = np.empty((2, path.shape[1]))
    for _ in range(attempts):
        segments = path.shape[0] - 1
        if segments < 2:
            break
        u, v = rng.random() * segments, rng.random() * segments
        if u > v:
            u, v = v, u
        i, j = int(u), int(v)
        if i == j:
            continue
        _interpolate(path, i, u - i, ends[0])
        _interpolate(path, j, v - j, ends[1])
        if edge_hits(query, ends[0], ends[1], step) == _NONE:
            path = _without_repeats(_spliced(path, i + 1, ends, j + 1), query.attached.reach)
    return path


@njit(cache=True)
def _arc(before: Array, corner: Array, after: Array, share: float) -> Array:
    """A parabola (pieces + 1, d) tangent to both segments at a corner, over a share of each."""
    arc = np.empty((_ARC_PIECES + 1, corner.shape[0]))
    for k in range(_ARC_PIECES + 1):
        t = k / _ARC_PIECES
        for joint in range(corner.shape[0]):
            into, out = (before[joint] - corner[joint]) * share, (after[joint] - corner[joint]) * share
            arc[k, joint] = corner[joint] + (1.0 - t) * (1.0 - t) * into + t * t * out
    return arc


@njit(cache=True)
def blend_corners(query: CollisionQuery, path: Array, step: float) -> Array:
    """Replace corners of a free path with collision-free parabolas, so that the robot need not stop there.

    Arguments and result as for `shortcut`.
    """
    corners = path.shape[0] - 2
    if corners < 1:
        return path
    rounded = np.empty((2 + corners * (_ARC_PIECES + 1), path.shape[1]))
    copy_row(path[0], rounded[0])
    count = 1
    for i in range(1, corners + 1):
        share, found = 0.5, False
        while not found and share > 0.05:
            arc = _arc(path[i - 1], path[i], path[i + 1], share)
            found = True
            for k in range(_ARC_PIECES):
                if edge_hits(query, arc[k], arc[k + 1], step) != _NONE:
                    found = False
                    break
            share *= 0.5
        if found:
            copy_rows(arc, rounded[count : count + _ARC_PIECES + 1])
            count += _ARC_PIECES + 1
        else:
            copy_row(path[i], rounded[count])
            count += 1
    copy_row(path[corners + 1], rounded[count])
    return _without_repeats(rounded[: count + 1], query.attached.reach)
