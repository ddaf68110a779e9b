"""Hollows found from convex pieces."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planners.goals import Goal, GoalError, inside, on
from planners.hollows import hollow_names, hollow_of, hollow_of_body
from planners.scene import Body, Solid
from tests.planners.containers import box_walls, container_world, round_walls
from tests.planners.pieces import bottle, bottle_with_shoulder, bowl, cut_in_two, mug
from tests.planners.scenes import HEIGHT, table_scene

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def test_a_mug_is_hollow_between_its_walls_and_not_at_its_handle() -> None:
    found = hollow_of_body(mug(position=(0.3, 0.1, 0.5)))
    assert found is not None
    assert (found.floor, found.rim) == (pytest.approx(0.506), pytest.approx(0.6))
    assert found.width == pytest.approx(0.068, abs=0.003)
    assert found.area.centre == (pytest.approx(0.3, abs=0.002), pytest.approx(0.1, abs=0.002))


@pytest.mark.parametrize("slope", [0.0, 0.05])
def test_a_bowl_is_as_wide_as_it_is_below_its_rim(slope: float) -> None:
    found = hollow_of_body(bowl(slope=slope))
    assert found is not None
    assert (found.floor, found.rim) == (pytest.approx(0.008), pytest.approx(0.07))
    assert found.width == pytest.approx(2 * (0.065 + slope) * math.cos(math.pi / 12), abs=0.012)


@pytest.mark.parametrize(
    "body",
    [
        bottle(),
        bottle_with_shoulder((0.0, 0.0, 0.0)),
        cut_in_two(Body("box", "box", np.array((0.05, 0.05, 0.05)), np.zeros(3), UPRIGHT)),
        Body.of_pieces("ring", bowl().pieces[1:]),
        Body("can", "cylinder", np.array((0.05, 0.05, 0.05)), np.zeros(3), UPRIGHT),
        bowl().at((0, 0, 0), (0.0, 1.0, 0.0, 0.0)),
    ],
)
def test_what_holds_no_water_is_not_hollow(body: Body) -> None:
    assert hollow_of_body(body) is None


@pytest.mark.parametrize("free", [True, False])
@pytest.mark.parametrize("yaw", [0.0, 0.5, -1.2])
def test_a_box_is_hollow_however_it_is_turned(free: bool, yaw: float) -> None:
    scene = container_world(box_walls(0.2, 0.12, 0.07), free=free, yaw=yaw).scene()
    assert hollow_names(scene) == ("basket",)
    found = hollow_of(scene, "basket")
    assert found is not None
    assert sorted(found.area.half_extents) == pytest.approx([0.06, 0.1], abs=0.002)
    assert found.depth == pytest.approx(0.07, abs=0.002)
    assert math.remainder(found.area.yaw - yaw, math.pi / 2) == pytest.approx(0.0, abs=1e-6)
    assert found.width == pytest.approx(0.12, abs=0.004)


def test_the_larger_of_two_rooms_counts() -> None:
    wall = '<geom type="box" size="0.004 0.1 0.03" pos="0.04 0 0.038"/>'
    found = hollow_of(container_world(box_walls(0.2, 0.2, 0.07) + wall, free=True).scene(), "basket")
    assert found is not None
    assert np.ptp(found.base[:, 0]) == pytest.approx(0.136, abs=0.004), "the floor of the larger room"


def test_slats_with_gaps_of_a_few_millimetres_hold_things() -> None:
    slats = "".join(
        f'<geom type="box" size="0.1 0.012 0.004" pos="0 {y:.3f} 0.004"/>' for y in np.arange(-0.09, 0.1, 0.03)
    )
    walls = box_walls(0.2, 0.2, 0.07).split("/>", 1)[1]
    found = hollow_of(container_world(slats + walls, free=True).scene(), "basket")
    assert found is not None
    assert found.depth == pytest.approx(0.07, abs=0.002)


def test_an_object_is_inside_on_the_floor_on_others_and_leaning_but_not_on_the_rim() -> None:
    thing = Body("thing", "box", np.array((0.02, 0.02, 0.02)), np.array((-0.2, -0.2, HEIGHT + 0.02)), UPRIGHT)
    scene, goal = table_scene(thing, bowl(position=(0.0, 0.2, HEIGHT))), inside("thing", "bowl")
    assert not goal.holds(scene)

    def there(x: float, y: float, z: float, quaternion: tuple[float, ...] = (1, 0, 0, 0)) -> bool:
        return goal.holds(scene.with_body(thing.at((x, y, HEIGHT + z), quaternion)))

    assert there(0.0, 0.2, 0.028)
    assert there(0.02, 0.21, 0.05), "on others"
    assert there(0.0, 0.2, 0.04, (math.cos(0.3), math.sin(0.3), 0, 0)), "leaning"
    assert not there(0.06, 0.2, 0.09), "on the rim"
    assert not there(0.1, 0.2, 0.02), "beside it"
    tall = Body("thing", "cylinder", np.array((0.02, 0.02, 0.1)), np.array((0.0, 0.2, HEIGHT + 0.108)), UPRIGHT)
    assert goal.holds(scene.with_body(tall)), "it stands on the floor, higher than the rim"


def test_what_stands_on_a_thin_floor_is_in_the_tray_and_not_on_the_table() -> None:
    sheet = Solid("sheet", np.array((0.0, 0.0, 0.0015)), np.array((0.1, 0.1, 0.0015)))
    walls = [
        Solid(f"{x} {y}", np.array((x, y, 0.02)), np.array((0.003 + 0.1 * (x == 0), 0.003 + 0.1 * (y == 0), 0.02)))
        for x, y in ((0.1, 0.0), (-0.1, 0.0), (0.0, 0.1), (0.0, -0.1))
    ]
    tray = Body.of_pieces("tray", [sheet, *walls], (0.0, 0.2, HEIGHT))
    thing = Body("thing", "box", np.array((0.02, 0.02, 0.02)), np.array((0.0, 0.2, HEIGHT + 0.023)), UPRIGHT)
    scene = table_scene(thing, tray)
    assert inside("thing", "tray").holds(scene)
    assert on("thing", "tray").holds(scene)
    assert not on("thing", "table_top").holds(scene)


def test_names_of_what_is_hollow_may_stand_in_goals_and_no_others() -> None:
    scene = container_world(box_walls(0.2, 0.2, 0.07), free=False).scene()
    for text in ("(inside thing basket)", "(on thing basket)", "(inside thing BASKET)"):
        Goal.from_pddl(text, scene).check(scene)
    with pytest.raises(
        GoalError, match=r"the goal names 'thing', which is not hollow, seen from above; .* hollow: basket"
    ):
        inside("thing", "thing").check(scene)
    with pytest.raises(GoalError, match="hollow: basket"):
        inside("thing", "table").check(scene)


def test_round_walls_have_a_round_mouth() -> None:
    found = hollow_of(container_world(round_walls(0.07, 0.06, 0.3), free=True).scene(), "basket")
    assert found is not None
    assert found.base.max() - found.base.min() < 2
    assert 0.13 < found.width < 0.19
