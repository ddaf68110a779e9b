"""What is believed of where the target is."""

from __future__ import annotations

import numpy as np

from planners.search.belief import Belief
from planners.search.perception import Description
from tests.planners.scenes import cylinder, table_scene

_TARGET = Description((1, 0, 0), "cylinder", (0.03, 0.03, 0.06))


def test_a_place_that_has_been_ruled_out_stays_so_where_an_object_is_put_there() -> None:
    """Every object put aside made new places around it, which were looked at in turn."""
    before, after = cylinder("it", -0.1, 0.2, radius=0.04), cylinder("it", -0.1, -0.2, radius=0.04)
    belief = Belief.begin(table_scene(before), _TARGET)
    (level,) = belief._levels.values()
    level.is_unseen[:], level.is_possible[:] = False, False
    belief.move(before, after)
    assert belief.emptied(after) == 0  # it has not been seen there
    assert not belief.places([])["table_top"].any()
    assert not belief.places([after])["table_top"].any()


def test_where_an_object_was_the_target_was_not() -> None:
    body = cylinder("it", -0.1, 0.2, radius=0.06)
    belief = Belief.begin(table_scene(body), _TARGET)
    grid = belief.grid("table_top")
    at = int((-0.1 - grid.x0) / grid.resolution), int((0.2 - grid.y0) / grid.resolution)
    assert belief.places([])["table_top"][at]
    belief.move(body, body.at((0.3, -0.5, 2.0)))
    assert not belief.places([])["table_top"][at]


def test_a_target_that_was_seen_and_is_lost_can_be_wherever_nothing_is_seen() -> None:
    belief = Belief.begin(table_scene(), _TARGET)
    (level,) = belief._levels.values()
    level.is_possible[:] = False
    assert not belief.places([])["table_top"].any()
    belief.restart()
    assert belief.places([])["table_top"].any()


def test_what_is_seen_in_a_drawer_slides_with_it() -> None:
    belief = Belief.begin(table_scene(), _TARGET)
    name, by = "table_top", np.array((-0.25, 0.03, 0.0))
    belief._levels[name].is_possible[5:] = False
    before, places = belief.grid(name), belief.places(())
    after = belief.slid([name, "elsewhere"], by)
    assert (after.grid(name).x0, after.grid(name).y0) == (before.x0 - 0.25, before.y0 + 0.03)
    np.testing.assert_array_equal(after.places(())[name], places[name])
    points = belief.points(places)
    np.testing.assert_allclose(after.points(places) - points, np.broadcast_to(by, points.shape), atol=1e-12)
    assert belief.grid(name) is before
    assert belief.slid(["elsewhere"], by).grid(name) is before
