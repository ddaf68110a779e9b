"""Free space: exact answers at every resolution."""

import numpy as np
import pytest

from irm.errors import QueryError
from irm.free_space import EVERYWHERE, FreeSpace

BOXES = [(0.0, 0.0, 0.7, 1.0), (0.6, 1.2, 0.4, 0.8, 0.5), (-1.2, -0.9, 0.1, 1.5, -1.1)]
RADIUS = 0.3


def distance_to_box(x, y, box):
    """Slow reference: distance to a filled rotated rectangle."""
    yaw = box[4] if len(box) == 5 else 0.0
    dx, dy = x - box[0], y - box[1]
    u, v = np.cos(yaw) * dx + np.sin(yaw) * dy, np.cos(yaw) * dy - np.sin(yaw) * dx
    return np.hypot(np.maximum(abs(u) - box[2] / 2, 0), np.maximum(abs(v) - box[3] / 2, 0))


@pytest.fixture(scope="module")
def points():
    return np.random.default_rng(0).uniform(-2.5, 2.5, size=(2, 4000))


@pytest.mark.parametrize("resolution", [0.01, 0.05, 0.3])
def test_answers_are_exact_at_every_resolution(points, resolution):
    boxes = np.array([(*box, 0.0)[:5] for box in BOXES])
    space = FreeSpace.from_boxes(boxes, RADIUS, (-2, -2.2, 2.1, 2), resolution)
    x, y = points
    expected = (x >= -2) & (x <= 2.1) & (y >= -2.2) & (y <= 2)
    for box in BOXES:
        expected &= distance_to_box(x, y, box) > RADIUS
    np.testing.assert_array_equal(space.are_free(x, y), expected)
    np.testing.assert_array_equal([space.is_free(*point) for point in points.T], expected)


def test_polygons_may_be_concave():
    corner = [(0, 0), (2, 0), (2, 0.2), (0.2, 0.2), (0.2, 2), (0, 2)]
    space = FreeSpace.from_polygons([corner], radius=0.3, resolution=0.03)
    assert space.is_free(1.0, 1.0)
    assert not space.is_free(1.0, 0.45)
    assert not space.is_free(0.1, 0.1)


def test_nothing_is_free_where_everything_is_blocked_and_everything_is_free_on_an_empty_floor():
    full = FreeSpace.from_boxes([(0, 0, 8, 8)], 0.3, (-2, -2, 2, 2))
    assert full.is_empty
    assert not full.is_free(0.3, 0.4)
    assert EVERYWHERE.is_free(1e6, -1e6)
    assert not EVERYWHERE.is_empty
    assert not EVERYWHERE.is_free(np.nan, 0)
    assert not full.is_free(np.nan, 0)
    assert FreeSpace.from_boxes([], 0.3, (-1, -1, 1, 1)).is_free(0.9, -0.9)


def test_misuse_is_refused():
    with pytest.raises(QueryError, match="4 or 5 columns"):
        FreeSpace.from_boxes([(0, 0, 1)], 0.3)
    with pytest.raises(QueryError, match="4 or 5 columns"):
        FreeSpace.from_boxes([(0, 0, 1, 1), (0, 0, 1, 1, 0.5)], 0.3)
    with pytest.raises(QueryError, match="negative size"):
        FreeSpace.from_boxes([(0, 0, -1, 1)], 0.3)
    with pytest.raises(QueryError, match="finite"):
        FreeSpace.from_boxes([(0, np.nan, 1, 1)], 0.3)
    with pytest.raises(QueryError, match="bounds are"):
        FreeSpace.from_boxes([(0, 0, 1, 1)], 0.3, (1, 0, -1, 1))
    with pytest.raises(QueryError, match="bounds must be given"):
        FreeSpace.from_boxes([], 0.3)
    with pytest.raises(QueryError, match="too many"):
        FreeSpace.from_boxes([(0, 0, 1, 1)], 0.3, resolution=1e-5)
    with pytest.raises(QueryError, match="at least 3 corners"):
        FreeSpace.from_polygons([[(0, 0), (1, 1)]], 0.3)
    with pytest.raises(QueryError, match="at least 3 corners"):
        FreeSpace.from_polygons([[(0, 0), (1, 1), (1,)]], 0.3)
