"""Torso heights of a map: both ends of the lift, one layer apart."""

import numpy as np
import pytest

from assets.robots import FETCH
from irm.chain import ArmChain
from irm.grid import MapGrid, MapParameters
from irm.ik.solvers import exact_solver
from irm.rotations import rotations

CHAIN = ArmChain.from_robot(FETCH)


@pytest.mark.parametrize("voxel", [0.02, 0.05, 0.1, 0.5])
def test_torso_heights_reach_both_ends_of_the_lift(voxel):
    grid = MapGrid.of(CHAIN, MapParameters(voxel=voxel))
    assert grid.torsos[0] == CHAIN.lower[0]
    assert grid.torsos[-1] == CHAIN.upper[0]
    assert 0.0 < grid.thickness <= voxel + 1e-12
    np.testing.assert_allclose(np.diff(grid.torsos), grid.thickness)
    assert grid.top == pytest.approx(grid.bottom + grid.layers * grid.thickness)


def test_nearly_all_centres_in_reach_are_in_the_map(coarse_map):
    """Against the exact solver at random centres of cells: none too many, and few are missed."""
    grid, rng = coarse_map.grid, np.random.default_rng(0)
    cells = rng.choice(grid.size, 12_000, replace=False)
    z, orientation, x, y = np.unravel_index(cells, grid.shape)
    T = np.tile(np.eye(4), (len(cells), 1, 1))
    T[:, :3, :3] = rotations(*grid.orientations.angles[orientation].T)
    T[:, :3, 3] = np.column_stack([grid.axis(0)[x], grid.axis(1)[y], grid.bottom + (z + 0.5) * grid.thickness])
    truth = exact_solver(CHAIN).solve(T)[0] == 2
    in_map = coarse_map.reachable[z, orientation, x, y]
    assert truth.sum() > 1000
    assert not np.any(in_map & ~truth)
    assert np.mean(in_map[truth]) > 0.975
