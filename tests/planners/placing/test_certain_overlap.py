"""The proof that objects overlap, beside linear programs that look for a point in both."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog

from planners.goals import at, inside
from planners.placing.certain_overlap import Ends, overlaps_everywhere
from planners.placing.goal_places import must_go_first
from planners.placing.locations import stand_at
from planners.regions import Region, footprint
from planners.scene import Body
from planners.scene.solid import Solid
from tests.planners.scenes import HEIGHT, cylinder, table_scene


def mug(name: str, x: float, y: float, radius: float = 0.04) -> Body:
    """A bottom, a wall of eight boxes and a handle, which puts its centre beside that of the bottom."""
    turns = np.arange(8) * np.pi / 4
    wall = [
        Solid(f"wall {k}", (radius * np.cos(a), radius * np.sin(a), 0.05), (0.003, 0.017, 0.05), "box", _about_z(a))
        for k, a in enumerate(turns)
    ]
    bottom = Solid("bottom", (0.0, 0.0, 0.004), (radius, radius, 0.004), "cylinder")
    handle = Solid("handle", (radius + 0.02, 0.0, 0.05), (0.02, 0.006, 0.03))
    return _standing(Body.of_pieces(name, [bottom, *wall, handle]), x, y)


def arch(name: str, x: float, y: float) -> Body:
    """Two pillars and a slab on top. A low object may stand between them."""
    pillars = [Solid(f"pillar {k}", (0.0, side, 0.05), (0.02, 0.01, 0.05)) for k, side in enumerate((-0.08, 0.08))]
    return _standing(Body.of_pieces(name, [*pillars, Solid("slab", (0.0, 0.0, 0.11), (0.02, 0.09, 0.01))]), x, y)


def _about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([(c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)])


def _standing(body: Body, x: float, y: float) -> Body:
    return stand_at(body, np.array([x, y, HEIGHT]))


def have_common_point(one: Body, other: Body) -> bool:
    """Whether some piece of each has a point in common, by a linear program for each pair."""
    for a, b in itertools.product(one.placed, other.placed):
        (normals, away), (more, farther) = a.planes, b.planes
        found = linprog(np.zeros(3), np.vstack((normals, more)), np.hstack((away, farther)), bounds=(None, None))
        if found.status == 0:
            return True
    return False


KINDS = {"mug": mug, "arch": arch, "can": cylinder}


@pytest.mark.parametrize(("moving", "standing"), [*itertools.product(KINDS, KINDS)])
def test_what_is_proved_to_overlap_does(moving: str, standing: str) -> None:
    """At a pose: wherever within the tolerance it stands and however it is turned."""
    rng, tolerance = np.random.default_rng(0), 0.02
    proved = 0
    for _ in range(12):
        other = KINDS[standing]("b", 0.0, 0.0)
        other = stand_at(other, other.foot, rng.uniform(-np.pi, np.pi))
        body, point = KINDS[moving]("a", 0.5, 0.5), rng.uniform(-0.06, 0.06, 2)
        if not overlaps_everywhere(body, Ends(HEIGHT, point=(point[0], point[1]), tolerance=tolerance), other):
            continue
        proved += 1
        for turn, direction in rng.uniform(-np.pi, np.pi, (8, 2)):
            away = tolerance * np.array((np.cos(direction), np.sin(direction)))
            assert have_common_point(stand_at(body, np.array([*(point + away), HEIGHT]), turn), other)
    assert proved or "arch" in (moving, standing)


@pytest.mark.parametrize("standing", ["mug", "can"])
def test_what_is_proved_to_overlap_in_a_region_does(standing: str) -> None:
    """Wherever its outline lies in the region."""
    rng, region = np.random.default_rng(1), Region("mat", "table_top", (0.0, 0.0), (0.062, 0.058), 0.3)
    proved = 0
    for _ in range(20):
        x, y = rng.uniform(-0.09, 0.09, 2)
        other, body = KINDS[standing]("b", x, y), mug("a", 0.5, 0.5)
        if not overlaps_everywhere(body, Ends(HEIGHT, region), other):
            continue
        proved += 1
        for turn in rng.uniform(-np.pi, np.pi, 12):
            there = stand_at(body, np.array([0.0, 0.0, HEIGHT]), turn)
            low, high = (extreme(region.local(footprint(there)), axis=0) for extreme in (np.min, np.max))
            first, last = -np.array(region.half_extents) - low, np.array(region.half_extents) - high
            if (first > last).any():
                continue
            local = rng.uniform(first, last)
            c, s = np.cos(region.yaw), np.sin(region.yaw)
            there = stand_at(there, np.array([*(np.array([[c, -s], [s, c]]) @ local), HEIGHT]))
            assert region.contains(there)
            assert have_common_point(there, other)
    assert proved


def test_a_low_object_may_stand_in_an_arch() -> None:
    over = arch("b", 0.0, 0.0)
    for height, is_in_the_way in ((0.08, False), (0.14, True)):
        can = cylinder("a", 0.5, 0.5, 0.03, height)
        assert overlaps_everywhere(can, Ends(HEIGHT), over) == is_in_the_way


def test_an_object_of_pieces_at_the_place_of_another_one_must_go_first() -> None:
    """Nothing was proved of these, so that a swap of two had a lower bound of two picks."""
    one, other, third = mug("a", -0.2, 0.0), mug("b", 0.0, 0.2), cylinder("c", 0.0, -0.2)
    scene = table_scene(one, other, third)
    assert must_go_first(scene, one, at("a", (0.0, 0.2)).placed[0]) == ("b",)
    assert must_go_first(scene, third, at("c", (-0.2, 0.0)).placed[0]) == ("a",)
    assert must_go_first(scene, one, at("a", (0.0, -0.2)).placed[0]) == ("c",)
    assert must_go_first(scene, one, at("a", (0.1, 0.0)).placed[0]) == ()
    narrow = replace(scene, regions=(Region("mat", "table_top", (0.0, 0.2), (0.06, 0.06)),))
    assert must_go_first(narrow, one, inside("a", "mat").placed[0]) == ("b",)
    wide = replace(scene, regions=(Region("mat", "table_top", (0.0, 0.2), (0.15, 0.15)),))
    assert must_go_first(wide, one, inside("a", "mat").placed[0]) == ()
