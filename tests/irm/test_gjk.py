"""GJK against alternating projections, an unrelated and slow way to the same distance."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from irm.gjk import BOX, CYLINDER, HULL, Solids, are_any_within, are_within, core_distance, height
from tests.planners.collision.slow_gjk import distance, project

NEAR = 1e-5
"""[m] Closer to the threshold than this, both answers are right."""


def random_solids(count: int, rng: np.random.Generator) -> Solids:
    """Boxes, cylinders, segments, ellipsoids and hulls, some of them axis-aligned."""
    core = rng.integers(0, 4, count)
    half = rng.uniform(0.005, 0.1, (count, 3))
    half[core == CYLINDER, 1] = half[core == CYLINDER, 0]
    half[(core == BOX) & (rng.random(count) < 0.4), :2] = 0.0
    rotation = np.empty((count, 9))
    for row in rotation:
        quaternion = rng.normal(size=4) if rng.random() < 0.7 else np.array([1.0, 0, 0, 0])
        mujoco.mju_quat2Mat(row, quaternion / np.linalg.norm(quaternion))
    radius = np.where(rng.random(count) < 0.5, rng.uniform(0, 0.05, count), 0.0)
    hulls = [
        random_corners(size, rng) if kind == HULL else np.zeros((0, 3)) for kind, size in zip(core, half, strict=True)
    ]
    return Solids(
        core,
        half,
        radius,
        np.linalg.norm(half, axis=1) + radius,
        rng.uniform(-0.15, 0.15, (count, 3)),
        rotation.reshape(-1, 3, 3),
        np.concatenate(hulls),
        np.cumsum([0, *(len(corners) for corners in hulls)]),
    )


def random_corners(half: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Points (12, 3) that reach from -half to half along every axis."""
    points = rng.uniform(-1, 1, (12, 3))
    for axis in range(3):
        points[2 * axis, axis], points[2 * axis + 1, axis] = 1.0, -1.0
    return points * half


@pytest.mark.parametrize("seed", range(4))
def test_results_equal_those_of_alternating_projections(seed: int) -> None:
    solids = random_solids(40, np.random.default_rng(seed))
    simplex = np.empty((4, 3))
    for i in range(0, 40, 2):
        for j in range(1, 40, 4):
            exact = distance(solids, i, solids, j)
            for padding in (0.0, 0.002, 0.03):
                if abs(exact - padding) > NEAR:
                    assert are_any_within(solids, i, solids, j, padding, simplex) == (exact < padding)


def test_boxes_and_cylinders_have_the_same_results_in_both_functions() -> None:
    solids = random_solids(40, np.random.default_rng(5))
    simple = np.flatnonzero(solids.core <= CYLINDER)
    simplex = np.empty((4, 3))
    for i in simple:
        for j in simple:
            for padding in (0.0, 0.02, 0.1):
                expected = are_any_within(solids, i, solids, j, padding, simplex)
                assert are_within(solids, i, solids, j, padding, simplex) == expected


def test_bounds_hold() -> None:
    rng = np.random.default_rng(3)
    solids = random_solids(40, rng)
    for i in range(40):
        for point in rng.uniform(-0.4, 0.4, (10, 3)):
            exact = np.linalg.norm(project(solids, i, point) - point)
            assert core_distance(solids, i, *point) <= exact + 1e-12
        far = solids.position[i] + [0.0, 0.0, 1e5]
        top = project(solids, i, far)[2] - solids.position[i, 2] + solids.radius[i]
        assert height(solids, i) == pytest.approx(top, abs=1e-6)
