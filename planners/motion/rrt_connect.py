"""Bidirectional rapidly exploring random trees and shortcuts, compiled.

RRT-Connect: Kuffner & LaValle, "RRT-Connect: An efficient approach to single-query path planning", ICRA 2000. Vectors
are whole-body configurations (d,), base and configuration; joints whose limits coincide stay fixed. Distances weigh
each joint by how far it can move a point of the robot, so they are in metres.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planners.collision.configuration_kernel import Obstacles, Workspace, configuration_hits
from planners.collision.path_kernel import edge_hits, edge_samples
from planners.collision.robot_model import RobotArrays

__all__ = ["blend_corners", "rrt_connect", "shortcut"]

Array = NDArray[np.float64]

_NONE = np.uint64(0)
_EXTENSION = 0.5
"""[m] that a tree grows towards a random target at once."""
_ARC_PIECES = 8
_LEAST_PROGRESS = 3
"""Steps that a blocked extension must have made to be kept."""
_NEAR_SPREAD = 0.4
"""[m] Standard deviation of targets drawn about the straight way, each joint weighed by its reach."""


@njit(cache=True)
def _squared_distance(a: Array, b: Array, weights: Array) -> float:
    total = 0.0
    for joint in range(a.shape[0]):
        difference = (a[joint] - b[joint]) * weights[joint]
        total += difference * difference
    return total


@njit(cache=True)
def _nearest(nodes: Array, count: int, target: Array, weights: Array) -> int:
    best, index = math.inf, 0
    for i in range(count):
        distance = _squared_distance(nodes[i], target, weights)
        if distance < best:
            best, index = distance, i
    return index


@njit(cache=True)
def _advance(
    robot: RobotArrays,
    obstacles: Obstacles,
    work: Workspace,
    start: Array,
    target: Array,
    opening: float,
    active: np.uint64,
    padding: float,
    step: float,
    reached: Array,
) -> int:
    """Walk from `start` towards `target` until something is hit; write the last free vector to `reached`.

    Returns:
        0 when blocked at once, 1 on the way, 2 when the target was reached.
    """
    parts = edge_samples(work, start, target, step)
    for i in range(1, parts + 1):
        for joint in range(start.shape[0]):
            reached[joint] = start[joint] + (target[joint] - start[joint]) * i / parts
        if (
            configuration_hits(robot, obstacles, work, reached[:3], reached[3:], opening, active, padding, True)
            != _NONE
        ):
            for joint in range(start.shape[0]):
                reached[joint] = start[joint] + (target[joint] - start[joint]) * (i - 1) / parts
            return 1 if i > _LEAST_PROGRESS else 0
    return 2


@njit(cache=True)
def _trace(nodes: Array, parents: NDArray[np.int64], leaf: int) -> Array:
    """The branch from the root to a leaf, (k, d)."""
    length, node = 0, leaf
    while node >= 0:
        length, node = length + 1, parents[node]
    branch, node = np.empty((length, nodes.shape[1])), leaf
    for i in range(length - 1, -1, -1):
        branch[i] = nodes[node]
        node = parents[node]
    return branch


@njit(cache=True)
def _grow(
    nodes: Array, parents: NDArray[np.int64], counts: NDArray[np.int64], tree: int, parent: int, vector: Array
) -> int:
    index = counts[tree]
    nodes[tree, index] = vector
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
    """A random target within the bounds, with probability `near` about the straight way."""
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
    robot: RobotArrays,
    obstacles: Obstacles,
    work: Workspace,
    start: Array,
    goals: Array,
    lower: Array,
    upper: Array,
    opening: float,
    active: np.uint64,
    padding: float,
    step: float,
    iterations: int,
    near: float,
    rng: np.random.Generator,
) -> Array:
    """A free path (k, d) from `start` (d,) to one of `goals` (g, d), which must be free; (0, d) when none was found.

    Random targets are drawn between `lower` and `upper` (d,); where these coincide nothing moves.
    A share `near` of them lies about the straight way from start to goal: where detours are small that finds them
    sooner. No point moves more than `step` [m] between checks.
    """
    d, capacity = start.shape[0], goals.shape[0] + 1 + 2 * iterations
    nodes, parents = np.empty((2, capacity, d)), np.empty((2, capacity), np.int64)
    counts = np.zeros(2, np.int64)
    _grow(nodes, parents, counts, 0, -1, start)
    for i in range(goals.shape[0]):
        _grow(nodes, parents, counts, 1, -1, goals[i])
        if edge_hits(robot, obstacles, work, start, goals[i], opening, active, padding, step, True) == _NONE:
            path = np.empty((2, d))
            path[0], path[1] = start, goals[i]
            return path
    target, reached, link = np.empty(d), np.empty(d), np.empty(d)
    tree = 0
    for _ in range(iterations):
        goal = goals[int(rng.random() * goals.shape[0])]
        _draw(start, goal, lower, upper, work.reach, near, rng, target)
        stem = _nearest(nodes[tree], counts[tree], target, work.reach)
        distance = math.sqrt(_squared_distance(nodes[tree, stem], target, work.reach))
        share = min(1.0, _EXTENSION / max(distance, 1e-12))
        for joint in range(d):
            target[joint] = nodes[tree, stem, joint] + share * (target[joint] - nodes[tree, stem, joint])
        if _advance(robot, obstacles, work, nodes[tree, stem], target, opening, active, padding, step, reached):
            leaf = _grow(nodes, parents, counts, tree, stem, reached)
            other = 1 - tree
            stem = _nearest(nodes[other], counts[other], reached, work.reach)
            outcome = _advance(
                robot, obstacles, work, nodes[other, stem], reached, opening, active, padding, step, link
            )
            if outcome == 2:
                first = _trace(nodes[tree], parents[tree], leaf)
                second = _trace(nodes[other], parents[other], stem)
                path = np.vstack((first, second[::-1]))
                return path if tree == 0 else path[::-1].copy()
            if outcome == 1:
                _grow(nodes, parents, counts, other, stem, link)
        tree = 1 - tree
    return np.empty((0, d))


@njit(cache=True)
def _splice(path: Array, i: int, a: Array, j: int, b: Array) -> Array:
    """The path with everything between point a on piece i and point b on piece j replaced by a straight line."""
    shorter = np.empty((i + 1 + 2 + path.shape[0] - j - 1, path.shape[1]))
    shorter[: i + 1] = path[: i + 1]
    shorter[i + 1], shorter[i + 2] = a, b
    shorter[i + 3 :] = path[j + 1 :]
    return shorter


@njit(cache=True)
def _without_repeats(path: Array, weights: Array) -> Array:
    """The path without waypoints that repeat the one before."""
    keep = np.ones(path.shape[0], np.bool_)
    for i in range(1, path.shape[0]):
        keep[i] = _squared_distance(path[i - 1], path[i], weights) > 1e-12
    keep[path.shape[0] - 1] = True
    return path[keep]


@njit(cache=True)
def shortcut(
    robot: RobotArrays,
    obstacles: Obstacles,
    work: Workspace,
    path: Array,
    opening: float,
    active: np.uint64,
    padding: float,
    step: float,
    attempts: int,
    rng: np.random.Generator,
) -> Array:
    """The path with detours cut: first between waypoints, then between random points on it."""
    first = 0
    while first < path.shape[0] - 2:
        for last in range(path.shape[0] - 1, first + 1, -1):
            if (
                edge_hits(robot, obstacles, work, path[first], path[last], opening, active, padding, step, True)
                == _NONE
            ):
                path = np.vstack((path[: first + 1], path[last:]))
                break
        first += 1
    for _ in range(attempts):
        pieces = path.shape[0] - 1
        if pieces < 2:
            break
        u, v = rng.random() * pieces, rng.random() * pieces
        if u > v:
            u, v = v, u
        i, j = int(u), int(v)
        if i == j:
            continue
        a = path[i] + (path[i + 1] - path[i]) * (u - i)
        b = path[j] + (path[j + 1] - path[j]) * (v - j)
        if edge_hits(robot, obstacles, work, a, b, opening, active, padding, step, True) == _NONE:
            path = _without_repeats(_splice(path, i, a, j, b), work.reach)
    return path


@njit(cache=True)
def _arc(before: Array, corner: Array, after: Array, share: float) -> Array:
    """A parabola (pieces + 1, d) tangent to both sides of a corner, over that share of each side."""
    arc = np.empty((_ARC_PIECES + 1, corner.shape[0]))
    for k in range(_ARC_PIECES + 1):
        t = k / _ARC_PIECES
        for joint in range(corner.shape[0]):
            into, out = (before[joint] - corner[joint]) * share, (after[joint] - corner[joint]) * share
            arc[k, joint] = corner[joint] + (1.0 - t) * (1.0 - t) * into + t * t * out
    return arc


@njit(cache=True)
def blend_corners(
    robot: RobotArrays,
    obstacles: Obstacles,
    work: Workspace,
    path: Array,
    opening: float,
    active: np.uint64,
    padding: float,
    step: float,
) -> Array:
    """The path with its corners rounded as far as that is free: it can then be followed without stopping at them."""
    corners = path.shape[0] - 2
    if corners < 1:
        return path
    rounded = np.empty((2 + corners * (_ARC_PIECES + 1), path.shape[1]))
    rounded[0] = path[0]
    count = 1
    for i in range(1, corners + 1):
        share, found = 0.5, False
        while not found and share > 0.05:
            arc = _arc(path[i - 1], path[i], path[i + 1], share)
            found = True
            for k in range(_ARC_PIECES):
                if edge_hits(robot, obstacles, work, arc[k], arc[k + 1], opening, active, padding, step, True) != _NONE:
                    found = False
                    break
            share *= 0.5
        if found:
            rounded[count : count + _ARC_PIECES + 1] = arc
            count += _ARC_PIECES + 1
        else:
            rounded[count] = path[i]
            count += 1
    rounded[count] = path[corners + 1]
    return _without_repeats(rounded[: count + 1], work.reach)
