"""No success of Rearrange is given for what no robot should do; each script is played in physics, with "ee" actions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from clutter_env.envs.rearrange import RearrangeEnv
from clutter_env.scene.layout import TABLE_HEIGHT
from planners import goals
from planners.goals import Goal, Region
from tests.clutter_env.envs.cheats import LOW, RADIUS, TIP, Cheat, cylinder
from tests.clutter_env.envs.side_grasp import CLOSED, OPEN

ONE, TWO = "object_00", "object_01"
FIRST, SECOND = 0, 1
Y = -0.12
OBJECTS = (cylinder(-0.24, Y), cylinder(-0.24, 0.12), cylinder(-0.24, 0.36))
INSIDE = goals.inside(ONE, "place")
PLACE = Region("place", "table_top", (-0.24, 0.0), (0.045, 0.045))


def begin(goal: Goal, *objects: dict[str, Any], regions: tuple[Region, ...] = (PLACE,), **keywords: Any) -> Cheat:
    """A robot before three cylinders, or other objects, with a goal for them."""
    env = RearrangeEnv(num_objects=4, control_mode="ee", **{"task": "set", **keywords})
    return Cheat(env, objects or OBJECTS, {"goal": goal, "regions": list(regions)})


def carry(cheat: Cheat, slot: int, y: float, fall: float = 0.0, raised: float = 0.05) -> None:
    """Take an object, carry it to another y [m], and let go of it so high [m] above where it would stand."""
    cheat.grasp(slot)
    bottom = cheat.env.world.lowest_point(cheat.env.measurements, slot)
    cheat.reach(cheat.point + (0, 0, raised))
    cheat.reach((cheat.point[0], y, cheat.point[2]))
    cheat.reach(cheat.point - (0, 0, raised - 0.001 - fall))
    assert bottom == pytest.approx(TABLE_HEIGHT, abs=0.002)
    cheat.leave()


def push(cheat: Cheat, slot: int, far: float) -> None:
    """Push an object so far [m] along the table with the side of a closed gripper, and draw back."""
    there = cheat.at(slot, LOW) - (0.0, RADIUS + 0.05, 0.0)
    cheat.before(there)
    cheat.grip(0.0)
    cheat.reach(there)
    start = cheat.env.measurements.poses[slot, 1]
    while cheat.env.measurements.poses[slot, 1] < start + far:
        cheat.point = cheat.point + (0, 0.001, 0)
        cheat.step()
    cheat.reach(cheat.point - (0, 0.02, 0))
    cheat.reach(cheat.point - (0.14, 0, 0))


def turn(cheat: Cheat, angle: float) -> None:
    """Roll the gripper about its approach by an angle [rad]."""
    for _ in range(60):
        cheat.roll += angle / 60
        cheat.step()
    cheat.wait(0.4)


# Each plays a cheat, and returns what the environment says at its end.


def push_into_the_place(cheat: Cheat) -> None:
    """It is pushed 12 cm along the table."""
    push(cheat, FIRST, 0.12)


def nudge_into_the_place(cheat: Cheat) -> None:
    """It is pushed 3.5 cm, less than makes an object count as disturbed."""
    push(cheat, FIRST, 0.035)


def lift_by_millimetres_then_nudge(cheat: Cheat) -> None:
    """It is lifted by 4 mm and set down again, then pushed 3.5 cm."""
    cheat.grasp(FIRST)
    cheat.reach(cheat.point + (0, 0, 0.004))
    cheat.reach(cheat.point - (0, 0, 0.004))
    cheat.leave()
    push(cheat, FIRST, 0.035)


def drag_into_the_place(cheat: Cheat) -> None:
    """It is gripped, and dragged 12 cm along the table."""
    cheat.drag(FIRST, 0.12)


def shove_with_what_is_held(cheat: Cheat) -> None:
    """Another object, carried, shoves it 12 cm along the table."""
    cheat.grasp(SECOND)
    cheat.reach(cheat.point + (0, 0, 0.004))
    cheat.reach((cheat.point[0], Y - 0.12 + 2 * RADIUS, cheat.point[2]), speed=0.06)
    cheat.reach(cheat.point + (0, 0.1, 0))
    cheat.reach(cheat.point - (0, 0, 0.004))
    cheat.leave()


def throw_into_the_place(cheat: Cheat) -> None:
    """It is swung, and released in the swing."""
    cheat.throw(FIRST, 0.02, closed=4, steps=7)


def drop_into_the_place(cheat: Cheat) -> None:
    """It is let go of 12 cm above the table."""
    carry(cheat, FIRST, 0.0, fall=0.12, raised=0.13)


def keep_it_in_the_grip(cheat: Cheat) -> None:
    """It is where it should be, and never let go of."""
    cheat.grasp(FIRST)
    cheat.reach(cheat.point + (0, 0, 0.05))
    cheat.reach((cheat.point[0], 0.0, cheat.point[2]))
    cheat.reach(cheat.point - (0, 0, 0.05))


def lean_on_it(cheat: Cheat) -> None:
    """It is put down, and the gripper stays around it, too slack to count as a grip."""
    keep_it_in_the_grip(cheat)
    cheat.grip(2 * RADIUS - 0.0002)


def let_go_for_moments(cheat: Cheat) -> None:
    """It is let go of for 0.3 s at a time."""
    keep_it_in_the_grip(cheat)
    for _ in range(6):
        cheat.width = OPEN
        cheat.wait(0.3)
        cheat.width = CLOSED
        cheat.wait(0.3)


def put_it_there_upside_down(cheat: Cheat) -> None:
    """It is turned over in the gripper."""
    cheat.grasp(FIRST)
    cheat.reach(cheat.point + (0, 0, 0.12))
    cheat.reach((cheat.point[0], 0.0, cheat.point[2]))
    turn(cheat, np.pi)
    under = cheat.env.world.lowest_point(cheat.env.measurements, FIRST) - TABLE_HEIGHT
    cheat.reach(cheat.point - (0, 0, under - 0.001))
    cheat.leave()


def lean_it_on_another(cheat: Cheat) -> None:
    """It is put down aslant, so that it leans on the next object."""
    cheat.grasp(FIRST)
    cheat.reach(cheat.point + (0, 0, 0.08))
    cheat.reach((cheat.point[0], 0.0, cheat.point[2]))
    turn(cheat, -0.3)
    under = cheat.env.world.lowest_point(cheat.env.measurements, FIRST) - TABLE_HEIGHT
    cheat.reach(cheat.point - (0, 0, under - 0.001))
    cheat.leave()


def put_it_half_over_the_edge(cheat: Cheat) -> None:
    """Its centre alone is in the place."""
    carry(cheat, FIRST, -0.035)


def put_another_one_there(cheat: Cheat) -> None:
    """The wrong object is put there."""
    carry(cheat, SECOND, 0.0)


def grip_what_is_in_the_way(cheat: Cheat) -> None:
    """It is gripped where it stands: objects in a hand stand nowhere."""
    cheat.grasp(FIRST)


@dataclass(frozen=True)
class Case:
    """A cheat, the goal that it is for, and whether the goal is reached, whatever else has happened."""

    play: Callable[[Cheat], None]
    goal: Goal = INSIDE
    is_reached: bool = False
    place: float = 0.0

    def __str__(self) -> str:
        return f"{self.play.__name__}, {self.goal}"


FAST = (
    Case(nudge_into_the_place, INSIDE, is_reached=True, place=Y + 0.035),
    Case(lift_by_millimetres_then_nudge, INSIDE, is_reached=True, place=Y + 0.035),
    Case(nudge_into_the_place, goals.clear("place"), is_reached=True, place=Y - 0.06),
    Case(grip_what_is_in_the_way, goals.clear("place"), place=Y),
    Case(lean_on_it),
)
SLOW = (
    Case(push_into_the_place, is_reached=True),
    Case(drag_into_the_place, is_reached=True),
    Case(shove_with_what_is_held, is_reached=True, place=Y - 0.12),
    Case(throw_into_the_place),
    Case(drop_into_the_place, is_reached=True),
    Case(keep_it_in_the_grip),
    Case(let_go_for_moments),
    Case(put_it_there_upside_down),
    Case(lean_it_on_another),
    Case(put_it_half_over_the_edge),
    Case(put_another_one_there),
)


@pytest.mark.parametrize("case", [*FAST, *(pytest.param(one, marks=pytest.mark.slow) for one in SLOW)], ids=str)
def test_a_cheat_has_no_success(case: Case) -> None:
    cheat = begin(case.goal, regions=(replace(PLACE, centre=(-0.24, case.place)),))
    case.play(cheat)
    cheat.wait(1.0)
    assert not any(step[4]["is_success"] for step in cheat.record)
    assert any(step[4]["lifted"] for step in cheat.record) == case.is_reached


def test_what_is_carried_to_its_place_and_put_down_is_a_success() -> None:
    cheat = begin(INSIDE)
    carry(cheat, FIRST, 0.0)
    cheat.wait(1.0)
    info = cheat.info
    assert (info["is_success"], info["unmet"], info["num_disturbed"]) == (True, 0, 0)


def test_what_is_held_stands_on_nothing() -> None:
    cheat = begin(goals.holding(ONE), cylinder(-0.24, Y), {**cylinder(-0.24, 0.12), "height": 0.11})
    cheat.grasp(FIRST)
    cheat.reach(cheat.point + (0, 0, 0.13))
    cheat.reach((cheat.point[0], 0.12, cheat.point[2]))
    cheat.reach(cheat.point - (0, 0, 0.0205))
    cheat.wait(1.0)
    assert not cheat.info["lifted"]
    cheat.reach(cheat.point + (0, 0, 0.02))
    cheat.wait(1.0)
    assert cheat.info["lifted"]


@pytest.mark.slow
def test_a_drag_in_the_grip_is_a_move_before_which_another_one_should_have_come() -> None:
    place = replace(PLACE, centre=(-0.24, 0.12 + 0.04))
    goal = goals.inside(TWO, "place") & goals.at(ONE, (-0.24, -0.2)) & goals.before(ONE, TWO)
    cheat = begin(goal, regions=(place,))
    cheat.drag(SECOND, 0.04)
    carry(cheat, FIRST, -0.2)
    cheat.wait(1.0)
    assert not cheat.info["is_success"]


def test_what_the_goal_names_but_need_not_move_is_not_shoved_about() -> None:
    """Three objects, in their places from the start, were shoved by 4 cm each: their paths counted nothing."""
    places = {1: -0.1, 2: 0.1, 3: 0.3}
    objects = (cylinder(-0.24, -0.3), *(cylinder(-0.24, y) for y in places.values()))
    regions = tuple(Region(f"place_{slot}", "table_top", (-0.22, y), (0.09, 0.06)) for slot, y in places.items())
    stays = [goals.inside(f"object_{slot:02d}", f"place_{slot}") for slot in places]
    cheat = begin(goals.and_(*stays, goals.at(ONE, (-0.24, -0.42))), *objects, regions=regions)
    for slot in places:
        there = cheat.at(slot, LOW)
        cheat.before(there)
        cheat.grip(CLOSED)
        cheat.reach(there + (0.04 - TIP - RADIUS, 0, 0), speed=0.03)
        cheat.leave()
    carry(cheat, FIRST, -0.42)
    cheat.wait(1.0)
    assert cheat.info["lifted"]
    assert cheat.info["total_path"] > 0.1
    assert not cheat.info["is_success"]
