"""GJK against alternating projections, an unrelated and slow way to the same distance."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from planners.collision.geometry import BOX, CYLINDER, Solids, are_within, core_distance, height
from tests.planners.collision.slow_geometry import distance, project

NEAR = 1e-5
"""[m] Closer to the threshold than this, both answers are right."""


def random_solids(count: int, rng: np.random.Generator) -> Solids:
    """Boxes, cylinders and segments, some of them axis-aligned."""
    core = rng.integers(0, 2, count)
    half = rng.uniform(0.005, 0.1, (count, 3))
    half[core == CYLINDER, 1] = half[core == CYLINDER, 0]
    half[(core == BOX) & (rng.random(count) < 0.4), :2] = 0.0
    rotation = np.empty((count, 9))
    for row in rotation:
        quaternion = rng.normal(size=4) if rng.random() < 0.7 else np.array([1.0, 0, 0, 0])
        mujoco.mju_quat2Mat(row, quaternion / np.linalg.norm(quaternion))
    radius = np.where(rng.random(count) < 0.5, rng.uniform(0, 0.05, count), 0.0)
    bound = np.linalg.norm(half, axis=1) + radius
    return Solids(core, half, radius, bound, rng.uniform(-0.15, 0.15, (count, 3)), rotation.reshape(-1, 3, 3))


@pytest.mark.parametrize("seed", range(4))
def test_verdicts_equal_those_of_alternating_projections(seed: int) -> None:
    solids = random_solids(40, np.random.default_rng(seed))
    simplex = np.empty((4, 3))
    for i in range(0, 40, 2):
        for j in range(1, 40, 4):
            exact = distance(solids, i, j)
            for padding in (0.0, 0.002, 0.03):
                if abs(exact - padding) > NEAR:
                    assert are_within(solids, i, solids, j, padding, simplex) == (exact < padding)


def test_verdicts_are_symmetric_and_monotone() -> None:
    solids = random_solids(30, np.random.default_rng(9))
    simplex = np.empty((4, 3))
    for i in range(30):
        assert are_within(solids, i, solids, i, 0.0, simplex)
        for j in range(i):
            verdicts = [are_within(solids, i, solids, j, padding, simplex) for padding in (0.0, 0.01, 0.1, 1.0)]
            assert verdicts == sorted(verdicts)
            assert verdicts[2] == are_within(solids, j, solids, i, 0.1, simplex)


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
