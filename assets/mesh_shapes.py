"""Boxes, cylinders and capsules in place of a mesh: around the whole mesh, or around its parts between cutting planes.

A single shape around a bent link, such as an upper arm with its two joints, is far larger than the link. It touches
other links in most configurations, where the link itself touches none.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco import mjtGeom
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from assets.robot_parts import rotation_of
from irm.rotations import frame_along

Floats = NDArray[np.float64]

_FACES, _TURNS, _ROUNDS = 12, 18, 100
"""Faces of a hull whose normals are tried as axes, turns of a box about its axis, and steps to the centre of a
circle."""
_SHORTEST = 1e-4
"""[m] Smallest half length of a capsule, which is then nearly a sphere."""
_LONG = 0.1
"""[m] Shortest longest side of a mesh that is cut."""
_CUTS = (0.2, 0.35, 0.5, 0.65, 0.8)
"""Places of the cuts along an axis, as shares of the mesh's length."""
_WORTH = 0.9
"""Largest share of a single shape's volume that several shapes may fill together."""
_POINTS = 5000
"""Random points to compare these volumes."""
_NECKS = (0.12, 0.18, 0.24, 0.3)
"""Places where a link may narrow, as shares of the distance between its two joints, from each joint."""
_FLAT = 1e-5
"""[m] Half thickness given to a flat part of a mesh."""
_FITTED = 5
"""Number of cuts of a mesh to which shapes are fitted: those whose parts have the smallest hulls."""


class JointAxis(NamedTuple):
    """A joint at one end of a link, in the frame of the link: a point on its axis [m], and its direction, (3,) each."""

    point: Floats
    direction: Floats


def shapes_around(
    vertices: Floats, edges: NDArray[np.int64], joints: tuple[JointAxis, JointAxis] | None = None
) -> list[dict[str, Any]]:
    """Find shapes that together contain a mesh and its interior: a single shape, or several that are much smaller.

    Args:
        vertices: (v, 3) [m].
        edges: (e, 2) indices of vertices.
        joints: the two joints of a link, if known. Links often end in cylinders about them.

    Returns:
        Keyword arguments of `MjsBody.add_geom` for each shape.
    """
    one = [smallest_around(vertices)[1]]
    if np.ptp(vertices, axis=0).max() < _LONG:
        return one
    principal = np.linalg.eigh(np.cov(vertices.T))[1].T
    cuts = [*((cut,) for cut in _CUTS), *itertools.combinations(_CUTS, 2)]
    tried = [_parts(vertices, edges, axis, places) for axis in principal for places in cuts]
    several = [[smallest_around(part)[1] for part in parts] for parts in sorted(tried, key=_hull_volume)[:_FITTED]]
    several += [] if joints is None else _around_joints(vertices, edges, *joints)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    points = np.random.default_rng(0).uniform(1.3 * low - 0.3 * high, 1.3 * high - 0.3 * low, (_POINTS, 3))
    smallest = min(several, key=lambda shapes: _filled(shapes, points))
    return smallest if _filled(smallest, points) < _WORTH * _filled(one, points) else one


def _around_joints(
    vertices: Floats, edges: NDArray[np.int64], first: JointAxis, second: JointAxis
) -> Iterator[list[dict[str, Any]]]:
    """Shapes around the part of a link between two joints, cut or not, and cylinders about their axes around its ends.

    Empty if the joints are too near each other.
    """
    along = second.point - first.point
    if (length := float(np.linalg.norm(along))) < _LONG:
        return
    heights = (vertices - first.point) @ (along / length)
    ends = []
    for joint, bounds in ((first, (-np.inf, 0.0)), (second, (length, np.inf))):
        if len(part := _part(vertices, edges, heights, *bounds)):
            R = frame_along(joint.direction)
            local = (part - joint.point) @ R
            low, high = local[:, 2].min(), local[:, 2].max()
            size = np.array([np.hypot(local[:, 0], local[:, 1]).max(), max((high - low) / 2, _SHORTEST), 0.0])
            place = joint.point + R[:, 2] * (low + high) / 2
            ends.append({"type": mjtGeom.mjGEOM_CYLINDER, "size": size, "pos": place, "quat": quaternion_of(R)})
    for share in (None, *_NECKS):
        cuts = (0.0, 1.0) if share is None else (0.0, share, 1.0 - share, 1.0)
        parts = (_part(vertices, edges, heights, length * low, length * high) for low, high in itertools.pairwise(cuts))
        yield [*(smallest_around(part)[1] for part in parts if len(part)), *ends]


def _filled(shapes: list[dict[str, Any]], points: Floats) -> float:
    """Share of points (n, 3) that are inside any of several shapes."""
    inside = np.zeros(len(points), dtype=np.bool_)
    for shape in shapes:
        a, b, c = shape["size"]
        local = np.abs((points - shape["pos"]) @ rotation_of(shape["quat"]))
        across = np.hypot(local[:, 0], local[:, 1])
        match shape["type"]:
            case mjtGeom.mjGEOM_BOX:
                inside |= (local <= (a, b, c)).all(axis=1)
            case mjtGeom.mjGEOM_CYLINDER:
                inside |= (across <= a) & (local[:, 2] <= b)
            case _:
                inside |= np.hypot(across, np.maximum(local[:, 2] - b, 0.0)) <= a
    return float(inside.mean())


def _parts(vertices: Floats, edges: NDArray[np.int64], axis: Floats, places: tuple[float, ...]) -> list[Floats]:
    """Corners of the parts of a mesh between planes across an axis, at given shares of its length."""
    heights = vertices @ axis
    bounds = heights.min() + np.ptp(heights) * np.array([0.0, *places, 1.0])
    parts = (_part(vertices, edges, heights, low, high) for low, high in itertools.pairwise(bounds))
    return [part for part in parts if len(part)]


def _hull_volume(parts: list[Floats]) -> float:
    """Total volume of the convex hulls of parts [m³]."""
    return sum(float(ConvexHull(part).volume) for part in parts)


def _part(vertices: Floats, edges: NDArray[np.int64], heights: Floats, low: float, high: float) -> Floats:
    """Corners (n, 3) of the part of a mesh between two planes: vertices, and intersections of edges with the planes."""
    points = [vertices[(heights >= low) & (heights <= high)]]
    first, second = heights[edges].T
    for plane in (low, high):
        crossing = (first < plane) != (second < plane)
        share = ((plane - first[crossing]) / (second[crossing] - first[crossing]))[:, None]
        start, end = vertices[edges[crossing]].transpose(1, 0, 2)
        points.append(start + share * (end - start))
    part = np.concatenate(points)
    if not len(part):
        return part
    # A flat part, or a point, has no hull, so it gets a thickness.
    centred = part - part.mean(axis=0)
    _, spreads, axes = np.linalg.svd(centred, full_matrices=False) if len(part) > 2 else (0, np.zeros(3), np.eye(3))
    for spread, axis in zip(spreads, axes, strict=True):
        if spread < _FLAT:
            part = np.concatenate([part - _FLAT * axis, part + _FLAT * axis])
    return part


def smallest_around(corners: Floats) -> tuple[float, dict[str, Any]]:
    """Find the smallest box, cylinder or capsule that contains points (v, 3): volume [m³], kind, size, place,
    orientation.

    Its axis is an axis of the body, a principal axis, or normal to one of the largest faces of their hull.
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
    for k in range(_ROUNDS):  # ever smaller steps to the farthest point: towards the centre of the smallest circle
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
