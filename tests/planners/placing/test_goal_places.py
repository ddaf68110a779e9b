"""Places in regions: boxes along the sides fit where the circles about them do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from planners.goals import Region, inside
from planners.placing.goal_places import (
    in_the_way,
    locations_in,
    of_same_area,
    place_of,
    reserved_regions,
)
from planners.placing.locations import stand_at
from planners.regions import footprint, overlap
from planners.scene import Body, Scene
from tests.planners.scenes import cylinder, table_scene

Array = NDArray[np.float64]
GAP = 0.004
"""[m] between neighbours at least."""


def box(name: str, x: float, y: float, half: tuple[float, float] = (0.035, 0.035), turn: float = 0.0) -> Body:
    body = replace(cylinder(name, x, y), shape="box", half_extents=np.array([*half, 0.08]))
    return stand_at(body, np.append(body.position[:2], body.bottom), turn)


def anywhere(points: Array) -> NDArray[np.bool_]:
    return np.ones(len(points), dtype=np.bool_)


def filled(scene: Scene, region: Region, bodies: list[Body]) -> Scene:
    """Each object at the first place that is found for it, in its first yaw there."""
    scene = replace(scene, regions=(region,))
    for number, body in enumerate(bodies):
        others = bodies[number + 1 :]
        place = place_of(scene, inside(body.name, region.name).placed[0])
        waiting = [other.name for other in others]
        point, (yaw, *_) = next(locations_in(scene, body, place, waiting, others, anywhere))
        turn = 0.0 if yaw is None else yaw - body.yaw
        scene = scene.with_body(stand_at(body, np.append(point, body.bottom), turn))
    return scene


@pytest.mark.parametrize(
    ("size", "half", "count", "yaw"),
    [
        ((0.22, 0.18), (0.05, 0.02), 6, 0.4),
        pytest.param((0.27, 0.27), (0.035, 0.035), 9, 0.0, marks=pytest.mark.slow),
    ],
)
def test_boxes_fill_a_region_that_circles_about_them_would_not(
    size: tuple[float, float], half: tuple[float, float], count: int, yaw: float
) -> None:
    region = Region("tray", "table_top", (0.0, 0.2), (size[0] / 2, size[1] / 2), yaw)
    bodies = [box(f"object_{k:02d}", -0.25 + 0.06 * k, -0.4, half, turn=0.3 * k) for k in range(count)]
    scene = filled(table_scene(*bodies), region, bodies)
    for one in scene.objects:
        assert region.contains(one)
        for other in scene.objects:
            if other.name != one.name:
                assert overlap(footprint(one), footprint(other)) <= -GAP + 1e-6


def test_a_stranger_between_boxes_is_in_the_way_only_where_no_turn_helps() -> None:
    region = Region("tray", "table_top", (0.0, 0.2), (0.075, 0.05))
    tray, body = inside("object_00", "tray").placed[0], box("object_00", 0.2, -0.3, (0.06, 0.02))
    beside, within = cylinder("object_01", 0.0, 0.228, 0.02), cylinder("object_01", 0.0, 0.2, 0.02)
    for stranger, found in ((beside, ()), (within, ("object_01",))):
        scene = replace(table_scene(body, stranger), regions=(region,))
        assert in_the_way(scene, body, place_of(scene, tray), ()) == found


def test_a_region_that_is_there_twice_is_not_kept_from_its_own_object() -> None:
    """Rounding left the corners of each outside the other, so that neither object had a place."""
    half = (0.13, 0.31)
    wider = tuple(float(np.nextafter(np.nextafter(side, 1.0), 1.0)) for side in half)
    one, two = Region("one", "table_top", (0.05, 0.07), half), Region("two", "table_top", (0.05, 0.07), wider)
    scene = replace(table_scene(cylinder("a", -0.2, 0.0), cylinder("b", -0.2, 0.2)), regions=(one, two))
    goal = inside("a", "one") & inside("b", "two")
    assert reserved_regions(scene, goal, "a") == ()
    assert reserved_regions(scene, goal, "b") == ()
    assert [one.name for one in of_same_area(scene, goal, "a", ("a", "b"))] == ["b"]  # room is left for it
