"""Places in regions: boxes along the sides fit where the circles about them do not."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from planners.goals import At, Goal, Region, at, inside, on
from planners.hollows import hollow_of
from planners.placing import goal_places
from planners.placing.goal_places import (
    Place,
    RoomForOthers,
    distances,
    distances_to_polygon,
    fixed_about,
    in_the_way,
    locations_in,
    must_go_first,
    of_same_area,
    place_of,
    reserved_regions,
    without_room,
)
from planners.placing.locations import stand_at
from planners.regions import footprint, overlap
from planners.scene import Body, Scene, Solid, StaticObstacle, solid
from tests.planners.pieces import mug
from tests.planners.scenes import HEIGHT, UPRIGHT, cylinder, table_scene

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


def test_about_a_pose_its_tolerance_is_tried_the_very_pose_first() -> None:
    scene = table_scene(cylinder("a", 0.2, -0.3))
    place = place_of(scene, At("a", 0.0, 0.1, tolerance=0.03))
    points = np.array([point for point, _ in locations_in(scene, scene.body("a"), place, (), (), anywhere)])
    away = np.linalg.norm(points - (0.0, 0.1), axis=1)
    assert away[0] == 0.0
    assert (np.diff(away) > -1e-9).all()
    assert 0.02 < away[-1] < 0.03
    exact = place_of(scene, At("a", 0.0, 0.1, tolerance=0.001))
    assert len(list(locations_in(scene, scene.body("a"), exact, (), (), anywhere))) == 1


def test_about_a_pose_in_a_region_only_what_lies_in_the_region_is_tried() -> None:
    region = Region("tray", "table_top", (0.0, 0.2), (0.06, 0.04), 0.5)
    scene = replace(table_scene(box("a", 0.2, -0.3, (0.05, 0.02))), regions=(region,))
    body = scene.body("a")
    place = place_of(scene, At("a", 0.005, 0.205, tolerance=0.02, within=("tray",)))
    found = list(locations_in(scene, body, place, (), (), anywhere))
    assert found
    for point, yaws in found:
        for yaw in yaws:
            assert yaw is not None
            assert region.contains(stand_at(body, np.append(point, body.bottom), yaw - body.yaw))


@pytest.mark.parametrize("yaw", np.linspace(0.0, 3.0, 13))
@pytest.mark.parametrize("room", [0.0, 0.0002, 0.003, 0.005, 0.009])
def test_a_region_hardly_larger_than_a_box_has_room_for_it_whatever_its_yaw(yaw: float, room: float) -> None:
    region = Region("slot", "table_top", (0.03, 0.21), (0.04 + room, 0.02 + room), yaw)
    scene = replace(table_scene(box("a", -0.2, -0.3, (0.04, 0.02))), regions=(region,))
    body, fact = scene.body("a"), inside("a", "slot").placed[0]
    found = list(locations_in(scene, body, place_of(scene, fact), (), (), anywhere))
    assert found
    assert in_the_way(scene, body, place_of(scene, fact), ()) == ()
    for point, yaws in found:
        for turn in yaws:
            assert turn is not None
            assert region.contains(stand_at(body, np.append(point, body.bottom), turn - body.yaw))


def test_on_a_wide_flat_object_there_is_room_for_several_and_alone_one_stands_in_the_middle() -> None:
    wide = Body("wide", "box", np.array([0.08, 0.08, 0.03]), np.array([0.0, 0.2, HEIGHT + 0.03]), UPRIGHT)
    cans = [cylinder(name, -0.25, y, 0.035, 0.08) for name, y in zip("ab", (-0.3, -0.1), strict=True)]
    scene = table_scene(wide, *cans)
    goal = on("a", "wide") & on("b", "wide")
    place = place_of(scene, goal.placed[0])
    alone, _ = next(locations_in(scene, cans[0], place, (), (), anywhere))
    assert np.allclose(alone, (0.0, 0.2))
    others = of_same_area(scene, goal, "a", ("a", "b"))
    assert [one.name for one in others] == ["b"]
    point, _ = next(locations_in(scene, cans[0], place, ("b",), others, anywhere))
    there = scene.with_body(cans[0].at([*point, wide.top + 0.04]))
    beside_it, _ = next(locations_in(there, cans[1], place_of(there, goal.placed[1]), (), (), anywhere))
    assert np.linalg.norm(point - beside_it) > 0.07
    assert in_the_way(there, cans[1], place, ()) == ()
    # On one that is no wider than needed, in the middle alone.
    narrow = replace(wide, half_extents=np.array([0.05, 0.05, 0.03]))
    assert place_of(scene.with_body(narrow), goal.placed[0]).area is None


@pytest.mark.parametrize(
    ("goal", "words"),
    [
        (Goal((At("a", -0.2, 0.2, z=HEIGHT + 0.6),)), r"no support at the height .*table_top \(0.75 m\)"),
        (Goal((At("a", -0.2, 0.2, z=HEIGHT - 0.3),)), r"no support at the height"),
        (at("a", (0.0, 0.3), 0.005), "overlaps pillar"),
        (inside("a", "slit"), "larger than its place, slit"),
        (at("a", (0.0, 0.0), 0.004) & at("b", (0.05, 0.0), 0.004), "overlap at their poses"),
        # Within the tolerances there may be room.
        (at("a", (0.0, 0.0), 0.006) & at("b", (0.05, 0.0), 0.006), ""),
        (at("a", (0.0, 0.35), 0.02), ""),
        (Goal((At("a", -0.2, 0.2, z=HEIGHT + 0.09),)), ""),
        # It may stand on the other one.
        (Goal((At("a", -0.2, 0.2, z=HEIGHT + 0.24),)), ""),
    ],
)
def test_a_place_at_which_nothing_can_be_is_refused_by_its_name(goal: Goal, words: str) -> None:
    pillar = StaticObstacle("pillar", np.array([0.0, 0.3, HEIGHT + 0.1]), np.array([0.03, 0.03, 0.1]))
    scene = table_scene(cylinder("a", -0.2, 0.0), cylinder("b", -0.2, -0.3))
    slit = Region("slit", "table_top", (0.1, -0.2), (0.02, 0.1))
    scene = replace(scene, static_obstacles=(*scene.static_obstacles, pillar), regions=(slit,))
    names, why = without_room(scene, goal, goal_names(goal))
    assert bool(names) == bool(words)
    assert re.search(words or "^$", why)


def test_what_does_not_fit_into_the_mouth_of_a_mug_stands_on_its_rim() -> None:
    """An apple 2 mm wider than the mouth, and a carton whose corners do not fit, were to go inside."""
    below = mug("mug", (0.0, 0.0, HEIGHT))
    hollow = hollow_of(table_scene(below), "mug")
    assert hollow is not None
    half = hollow.width / 2
    apples = [cylinder("a", -0.2, 0.2, half + wider, 0.08) for wider in (-0.002, 0.0015)]
    for body, is_inside in zip(
        (*apples, box("a", -0.2, 0.2, (half - 0.001, half - 0.001))), (True, False, False), strict=True
    ):
        place = place_of(table_scene(below, body), on("a", "mug").placed[0])
        assert (place.hollow is not None) == is_inside


@pytest.mark.parametrize("seed", range(3))
def test_what_fits_into_a_mouth_in_some_yaw_is_placed_once_for_each_way_it_rests(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For each of 36 yaws a bowl of 40 pieces was built again: three quarters of the planning of LIBERO's tasks."""
    below, rng = mug("mug", (0.0, 0.0, HEIGHT)), np.random.default_rng(seed)
    hollow = hollow_of(table_scene(below), "mug")
    assert hollow is not None
    sizes = hollow.width / 2 * rng.uniform((0.2, 0.8), (0.9, 1.1), (20, 2))
    carried = [Body.of_pieces("a", [Solid("one", (0.0, 0.0, 0.0), (x, y, 0.04))], (-0.2, 0.2, 1.0)) for x, y in sizes]
    middle, turns = np.append(hollow.area.centre, hollow.floor), np.arange(36) * np.pi / 18
    slow = [
        any(
            (distances_to_polygon(footprint(stand_at(body, middle, turn)), hollow.mouth) == 0.0).all() for turn in turns
        )
        for body in carried
    ]
    placed: list[Body] = []
    monkeypatch.setattr(goal_places, "stand_at", lambda *given: placed.append(stand_at(*given)) or placed[-1])
    found = [place_of(table_scene(below, body), on("a", "mug").placed[0]).hollow is not None for body in carried]
    assert found == slow
    assert True in found
    assert False in found
    assert len(placed) == len(carried)


def goal_names(goal: Goal) -> list[str]:
    return [fact.object for fact in goal.placed]


def test_what_is_fixed_about_a_place_is_named() -> None:
    lid = StaticObstacle("lid", np.array([0.0, 0.1, HEIGHT + 0.2]), np.array([0.1, 0.1, 0.005]))
    wall = StaticObstacle("screen", np.array([0.1, 0.1, HEIGHT + 0.1]), np.array([0.005, 0.1, 0.1]))
    scene = table_scene(cylinder("a", -0.2, -0.3))
    scene = replace(scene, static_obstacles=(*scene.static_obstacles, lid, wall))
    assert fixed_about(scene, Place(scene.support, location=np.array([0.0, 0.1]))) == ("lid", "screen")
    assert fixed_about(scene, Place(scene.support, location=np.array([-0.2, -0.3]))) == ()


def test_poses_that_overlap_leave_each_other_what_their_tolerances_allow() -> None:
    scene = table_scene(cylinder("a", -0.2, 0.0, 0.035), cylinder("b", -0.2, -0.3, 0.035))
    goal = at("a", (0.0, 0.0)) & at("b", (0.0, 0.04))
    (kept,) = reserved_regions(scene, goal, "a")
    points = np.array([(0.0, -0.016), (0.0, 0.0)])
    assert kept.touches_disc(points, 0.036).tolist() == [False, True]
    assert reserved_regions(scene, at("a", (0.0, 0.0)) & at("b", (0.0, 0.08)), "a") == ()


@pytest.mark.parametrize("yaw", [0.0, 0.5])
def test_what_leaves_no_room_in_a_region_must_go_first(yaw: float) -> None:
    """The middle of a can may be 51 mm from that of the other one, at a corner, and needs 54 mm."""
    body, fact = cylinder("object_00", 0.2, -0.3, 0.035), inside("object_00", "mat").placed[0]
    other = cylinder("object_01", 0.0, 0.2, 0.019)
    for half, found in ((0.069, ("object_01",)), (0.072, ())):
        scene = replace(table_scene(body, other), regions=(Region("mat", "table_top", (0.0, 0.2), (half, half), yaw),))
        assert must_go_first(scene, body, fact) == found


@pytest.mark.parametrize("shape", ["cylinder", "box"])
def test_beside_what_lies_aslant_there_is_room(shape: str) -> None:
    """It counted as the box about it along the table's sides, so that the bound of a goal beside it was too high."""
    half, lies_along_y = np.array([0.03, 0.03, 0.1]), (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)
    along_y = Body("object_01", "box" if shape == "box" else "cylinder", half, np.zeros(3), np.array(lies_along_y))
    aslant = stand_at(along_y, np.array((0.0, 0.2, HEIGHT)), np.pi / 4)
    body, fact = cylinder("object_00", 0.2, -0.3, 0.03), inside("object_00", "mat").placed[0]
    for side, found in ((1.0, ()), (-1.0, ("object_01",))):
        region = Region("mat", "table_top", (0.07 * side, 0.2 + 0.07), (0.031, 0.031))
        assert must_go_first(replace(table_scene(body, aslant), regions=(region,)), body, fact) == found


@pytest.mark.parametrize("seed", [0, 2, 3])
def test_room_for_others_is_what_is_found_by_putting_them_there_one_by_one(seed: int) -> None:
    """Of upright cylinders, each at the first point that is free, the largest first."""
    rng, area, gap = np.random.default_rng(seed), Region("tray", "table_top", (0.0, 0.0), (0.115, 0.115)), 0.012
    grid = np.stack(np.meshgrid(np.linspace(-0.115, 0.115, 16), np.linspace(-0.115, 0.115, 16)), axis=-1).reshape(-1, 2)
    bodies = [cylinder(f"object_{k}", *rng.uniform(-0.1, 0.1, 2), rng.uniform(0.02, 0.045)) for k in range(6)]
    body, staying, others = bodies[0], bodies[1:3], sorted(bodies[3:], key=lambda one: -one.radius)

    def is_left(point: Array) -> bool:
        standing = [*staying, body.at([*point, body.position[2]])]
        for other in others:
            inside = (np.abs(grid) <= np.array(area.half_extents) - other.radius).all(axis=1)
            away = np.min([distances(grid, one) for one in standing], axis=0)
            free = grid[inside & (away - other.radius >= gap)]
            if not len(free):
                return False
            standing.append(other.at([*free[0], other.position[2]]))
        return True

    room = RoomForOthers(grid, area, staying, others, gap)
    expected = [is_left(point) for point in grid]
    assert [room.is_left(body, point, None) for point in grid] == expected
    assert 0 < sum(expected) < len(grid)


def test_outlines_of_pieces_are_computed_once_however_many_locations_are_tried(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    points = np.random.default_rng(0).uniform(-0.2, 0.2, (50, 2))
    cups = [mug("cup").at((x, 0.0, 0.5)) for x in (0.0, 0.1, 0.2)]
    cups = [replace(one, pieces=cups[0].pieces) for one in cups]
    slow = [np.min([distances_to_polygon(points, piece.outline) for piece in one.placed], axis=0) for one in cups]
    hulls: list[int] = []
    monkeypatch.setattr(solid, "ConvexHull", lambda corners: hulls.append(len(corners)) or ConvexHull(corners))
    np.testing.assert_allclose([distances(points, one) for one in cups], slow, atol=1e-12)
    assert 0 < len(hulls) <= len(cups[0].pieces)
