"""Shapes in place of meshes contain them, and are few and small."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.spatial import ConvexHull

from assets.mesh_shapes import JointAxis, _around_joints, shapes_around, smallest_around


def is_inside(shape: dict[str, Any], points: np.ndarray) -> np.ndarray:
    """(n,) whether points (n, 3) are in a shape, as MuJoCo places it."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(**shape)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    local = (points - data.geom_xpos[0]) @ data.geom_xmat[0].reshape(3, 3)
    kind, size = mujoco.mjtGeom(int(model.geom_type[0])), model.geom_size[0]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return np.asarray((np.abs(local) <= size + 1e-6).all(axis=1))
    beyond, across = np.maximum(np.abs(local[:, 2]) - size[1], 0.0), np.hypot(local[:, 0], local[:, 1])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return np.asarray(np.hypot(across, beyond) <= size[0] + 1e-6)
    return np.asarray((beyond <= 1e-6) & (across <= size[0] + 1e-6))


def test_the_shape_in_place_of_a_mesh_contains_it() -> None:
    rng = np.random.default_rng(3)
    for sizes in rng.uniform(0.01, 0.2, (7, 3)):
        points = rng.normal(size=(60, 3)) * sizes + rng.uniform(-1, 1, 3)
        assert is_inside(smallest_around(points)[1], points).all()


def boxes(*pieces: tuple[tuple[float, ...], tuple[float, ...]]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and edges of boxes (centre, half extents), a mesh of several pieces."""
    vertices, edges = [], []
    for centre, half in pieces:
        corners = np.array(centre) + np.array(half) * np.array(list(np.ndindex(2, 2, 2))) * 2 - half
        edges.append(np.sort(ConvexHull(corners).simplices[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1))
        edges[-1] += 8 * len(vertices)
        vertices.append(corners)
    return np.concatenate(vertices), np.unique(np.concatenate(edges), axis=0)


ELBOW = (((0.0, 0.0, 0.2), (0.04, 0.04, 0.2)), ((0.15, 0.0, 0.36), (0.19, 0.04, 0.04)))
DUMB_BELL = (((0, 0, 0), (0.02, 0.02, 0.3)), ((0, 0, 0.3), (0.1, 0.1, 0.05)), ((0, 0, -0.3), (0.1, 0.1, 0.05)))


@pytest.mark.parametrize(("pieces", "count", "share"), [(ELBOW, (2, 3), 0.75), (DUMB_BELL, (3, 3), 0.6)])
def test_a_bent_link_gets_several_shapes_that_contain_it(pieces, count, share) -> None:
    """One box around an elbow touched others in most configurations, the link in none."""
    vertices, edges = boxes(*pieces)
    shapes = shapes_around(vertices, edges)
    assert count[0] <= len(shapes) <= count[1]
    rng = np.random.default_rng(0)
    within = np.concatenate([np.array(c) + rng.uniform(-1, 1, (400, 3)) * h for c, h in pieces])
    assert np.any([is_inside(shape, within) for shape in shapes], axis=0).all()
    whole, one = smallest_around(vertices)
    around = rng.uniform(vertices.min(axis=0) - 0.05, vertices.max(axis=0) + 0.05, (20_000, 3))
    several = np.any([is_inside(shape, around) for shape in shapes], axis=0).mean()
    assert several < share * is_inside(one, around).mean()
    assert whole > 0


def test_a_straight_or_short_link_gets_one_shape() -> None:
    assert len(shapes_around(*boxes(((0, 0, 0), (0.05, 0.05, 0.3))))) == 1
    small = tuple((tuple(0.1 * np.array(c)), tuple(0.1 * np.array(h))) for c, h in ELBOW)
    assert len(shapes_around(*boxes(*small))) == 1


def test_a_link_ends_in_cylinders_about_its_joints() -> None:
    """The corners of a box around an upper arm touched the base, above which its round end turns, in 9 of 10 poses."""
    turn = np.linspace(0, np.pi, 24)
    low = np.column_stack([0.06 * np.cos(turn), 0 * turn, -0.06 * np.sin(turn)])
    end = np.concatenate([low - (0, 0.06, 0), low + (0, 0.06, 0)])
    vertices = np.concatenate([end, (0, 0, 0.4) - end])
    hull = ConvexHull(vertices)
    edges = np.unique(np.sort(hull.simplices[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    y = np.array([0.0, 1.0, 0.0])
    joints = JointAxis(np.zeros(3), y), JointAxis(np.array([0.0, 0.0, 0.4]), y)
    points = np.random.default_rng(0).uniform((-0.1, -0.07, -0.1), (0.1, 0.07, 0.5), (20_000, 3))
    shapes = next(_around_joints(vertices, edges, *joints))
    inside = np.any([is_inside(shape, points) for shape in shapes], axis=0)
    radius = np.hypot(points[:, 0], np.maximum(np.maximum(-points[:, 2], points[:, 2] - 0.4), 0.0))
    is_solid = (radius <= 0.06) & (np.abs(points[:, 1]) <= 0.06)
    assert inside[is_solid].all()
    assert radius[inside].max() < 0.061, "no corner beyond the round ends"
