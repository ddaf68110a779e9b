"""The outline of a base in pictures."""

import numpy as np
from matplotlib.patches import Circle, Polygon

import assets
from planners.drawing.pictures import footprint


def test_a_base_that_is_not_round_is_drawn_by_its_corners():
    """PR2's square base was a circle in the overview."""
    pr2, fetch = assets.robot("pr2"), assets.robot("fetch")
    square = footprint(pr2, (1.0, 2.0, np.pi / 2))
    assert isinstance(square, Polygon)
    corners = np.array(pr2.base_outline)
    wanted = np.column_stack([2.0 + corners[:, 0], 1.0 - corners[:, 1]])  # y to the side, x up, turned by 90 degrees
    np.testing.assert_allclose(square.get_xy()[: len(corners)], wanted, atol=1e-12)
    assert isinstance(footprint(fetch, (0.0, 0.0, 0.0)), Circle)
