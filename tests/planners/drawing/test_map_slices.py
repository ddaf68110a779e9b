"""Slices of reachability maps as pictures."""

import numpy as np
import pytest

from assets import FETCH
from irm import ReachabilityError, ReachabilityMap
from planners.drawing.map_slices import plot_slices


@pytest.fixture(scope="module")
def rm() -> ReachabilityMap:
    return ReachabilityMap.build(FETCH, voxel=0.1, orientations=62, heights=(0.4, 1.0))


def test_a_slice_shows_the_index_of_its_layer(rm: ReachabilityMap) -> None:
    (axis, _) = plot_slices(rm, [0.7]).axes
    shown = axis.images[0].get_array()
    layer = int((0.7 - rm.grid.bottom) / rm.grid.thickness)
    np.testing.assert_allclose(shown.filled(0.0), rm.reachability_index[layer].T)
    assert len(plot_slices(rm).axes) == 5, "four heights and the scale"


def test_mu_of_one_pitch_is_the_best_of_its_cells(rm: ReachabilityMap) -> None:
    (axis, _) = plot_slices(rm, [0.7], value="mu", pitch=0.0).axes
    layer, (z, orientation, x, y) = int((0.7 - rm.grid.bottom) / rm.grid.thickness), rm.indices()
    is_level = (rm.grid.orientations.angles[orientation, 1] == 0.0) & (z == layer)
    best = np.zeros(axis.images[0].get_array().shape)
    np.maximum.at(best, (y[is_level], x[is_level]), rm.manipulability[is_level])
    np.testing.assert_allclose(axis.images[0].get_array().filled(0.0), best)


def test_what_the_map_does_not_have_is_refused(rm: ReachabilityMap) -> None:
    with pytest.raises(ReachabilityError, match="the map reaches from"):
        plot_slices(rm, [3.0])
    for heights in (0.7, "abc", [np.nan], [[0.7]]):
        with pytest.raises(ReachabilityError, match="heights="):
            plot_slices(rm, heights)
    with pytest.raises(ReachabilityError, match=r"which are .*0\.000"):
        plot_slices(rm, pitch=0.3)
    with pytest.raises(ReachabilityError, match="'index', 'mu'"):
        plot_slices(rm, value="D")  # type: ignore[arg-type]  # on purpose
