"""Boxes, cylinders and capsules in place of a mesh: around all of it, or around the parts into which planes cut it.

One shape around a bent link, such as an upper arm with its two joints, is far larger than the link: it touches others
in most configurations, where the link touches none.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
from mujoco import mjtGeom
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from irm.rotations import frame_along

Floats = NDArray[np.float64]

_FACES, _TURNS, _ROUNDS = 12, 18, 100
"""Faces of a hull whose normals are tried as axes; turns of a box about its axis; steps to the centre of a circle."""
_SHORTEST = 1e-4
"""[m] Half length of a capsule that is a sphere."""
_LONG = 0.1
"""[m] A mesh whose longest side is shorter is not cut."""
_CUTS = (0.2, 0.35, 0.5, 0.65, 0.8)
"""Places of the cuts along an axis, as shares of the mesh's length."""
_WORTH = 0.9
"""Share of the volume of one shape that several together may have at most."""
_FITTED = 5
"""Ways to cut a mesh, those whose parts have the smallest hulls, of which shapes are fitted."""


def shapes_around(vertices: Floats, edges: NDArray[np.int64]) -> list[dict[str, Any]]:
    """Shapes that together contain a mesh, and the space within it: one, or two or three that are much smaller.

    Args:
        vertices: (v, 3) [m].
        edges: (e, 2) indices of vertices.

    Returns:
        Keyword arguments of `MjsBody.add_geom` for each.
    """
    whole, shape = smallest_around(vertices)
    if np.ptp(vertices, axis=0).max() < _LONG:
        return [shape]
    principal = np.linalg.eigh(np.cov(vertices.T))[1].T
    cuts = [*((cut,) for cut in _CUTS), *itertools.combinations(_CUTS, 2)]
    tried = [_parts(vertices, edges, axis, places) for axis in principal for places in cuts]
    fits = [[smallest_around(part) for part in parts] for parts in sorted(tried, key=_hull_volume)[:_FITTED]]
    smallest = min(fits, key=lambda fit: sum(volume for volume, _ in fit))
    if sum(volume for volume, _ in smallest) > _WORTH * whole:
        return [shape]
    return [shape for _, shape in smallest]


def _parts(vertices: Floats, edges: NDArray[np.int64], axis: Floats, places: tuple[float, ...]) -> list[Floats]:
    """The corners of the parts into which planes across an axis cut a mesh, at these shares of its length."""
    heights = vertices @ axis
    bounds = heights.min() + np.ptp(heights) * np.array([0.0, *places, 1.0])
    return [_part(vertices, edges, heights, low, high) for low, high in itertools.pairwise(bounds)]


def _hull_volume(parts: list[Floats]) -> float:
    """[m³] of the convex hulls of parts, all together."""
    return sum(float(ConvexHull(part).volume) for part in parts)


def _part(vertices: Floats, edges: NDArray[np.int64], heights: Floats, low: float, high: float) -> Floats:
    """The corners (n, 3) of what of a mesh lies between two planes: vertices, and where edges cross the planes."""
    points = [vertices[(heights >= low) & (heights <= high)]]
    first, second = heights[edges].T
    for plane in (low, high):
        crossing = (first < plane) != (second < plane)
        share = ((plane - first[crossing]) / (second[crossing] - first[crossing]))[:, None]
        start, end = vertices[edges[crossing]].transpose(1, 0, 2)
        points.append(start + share * (end - start))
    return np.concatenate(points)


def smallest_around(corners: Floats) -> tuple[float, dict[str, Any]]:
    """The smallest box, cylinder or capsule that contains points (v, 3): volume [m³], kind, size, place, orientation.

    Its axis is one of the body, a principal one, or normal to one of the largest faces of their hull.
    """
    hull = ConvexHull(corners)
    corners = corners[hull.vertices]
    faces = hull.points[hull.simplices]
    areas = np.linalg.norm(np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0]), axis=1)
    normals = hull.equations[np.argsort(-areas)[:_FACES], :3]
    principal = np.linalg.eigh(np.cov(corners.T))[1].T
    fits = (
        (volume, {"type": kind, "size": size, "pos": R @ centre, "quat": quaternion_of(R @ turn)})
        for R in map(frame_along, (*np.eye(3), *principal, *normals))
        for volume, kind, size, centre, turn in _around_axis(corners @ R)
    )
    return min(fits, key=lambda fit: fit[0])


def _around_axis(points: Floats) -> Iterator[tuple[float, mjtGeom, Floats, Floats, Floats]]:
    """Volume, kind, size, centre and rotation of a box, a cylinder and a capsule along z that contain points (v, 3)."""
    flat, middle = points[:, :2], (points[:, 2].max() + points[:, 2].min()) / 2
    half, centre = float(points[:, 2].max() - middle), flat.mean(axis=0)
    for k in range(_ROUNDS):  # towards the farthest point, by less and less: the centre of the smallest circle
        away = flat - centre
        centre = centre + away[np.argmax((away * away).sum(axis=1))] / (k + 2)
    beside = np.linalg.norm(flat - centre, axis=1)
    radius, place = float(beside.max()), np.array([*centre, middle])
    yield 2 * np.pi * radius**2 * half, mjtGeom.mjGEOM_CYLINDER, np.array([radius, half, 0.0]), place, np.eye(3)
    caps = np.abs(points[:, 2] - middle) - np.sqrt(np.maximum(radius**2 - beside**2, 0.0))
    length = max(float(caps.max()), _SHORTEST)
    volume = np.pi * radius**2 * (2 * length + 4 / 3 * radius)
    yield volume, mjtGeom.mjGEOM_CAPSULE, np.array([radius, length, 0.0]), place, np.eye(3)
    for angle in np.arange(_TURNS) * (np.pi / 2 / _TURNS):
        c, s = np.cos(angle), np.sin(angle)
        turned = flat @ np.array([[c, -s], [s, c]])
        low, high = turned.min(axis=0), turned.max(axis=0)
        size = np.array([*((high - low) / 2), half])
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        yield 8 * float(size.prod()), mjtGeom.mjGEOM_BOX, size, turn @ np.array([*((high + low) / 2), middle]), turn


def quaternion_of(R: Floats) -> Floats:
    """The quaternion wxyz of a rotation matrix."""
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(R).ravel())
    return quaternion
