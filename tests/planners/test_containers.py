"""Objects put into containers: planned, and carried out in physics."""

from __future__ import annotations

import re

import pytest

import assets
from planners import Cause, Infeasible, Solution, execute, goals, lower_bound, solve, warmup
from planners.collision.world import CollisionWorld, objects_on
from planners.goals import Goal
from planners.grasping import grasp_poses
from planners.hollows import hollow_of
from planners.placing import why_not
from planners.placing.goal_places import place_of
from planners.scene import Body, HeldObject, Scene
from planners.tamp.state import Search
from planners.workspace import Workspace
from tests.planners.containers import CAN, LOW_CAN, TABLE, World, box_walls, container_world, round_walls
from tests.planners.opening.furniture import drawer_world

BASKET = box_walls(0.19, 0.19, 0.072)
SMALL = '<geom type="box" size=".02 .02 .03" mass=".1"/>'


def carried_out(world: World, goal: Goal) -> Solution:
    """The plan for a goal, after it has been carried out: the object then is inside."""
    start = world.scene()
    found = solve(start, goal, rng=0)
    assert isinstance(found, Solution), found
    assert found.end is not None
    assert goal.holds(found.end, start)
    assert execute(found, world.model, world.data).finished
    assert goal.holds(world.scene(), start)
    return found


@pytest.mark.parametrize("goal", [goals.inside("thing", "basket"), goals.on("thing", "basket")], ids=str)
def test_a_can_is_put_into_a_free_basket(goal: Goal) -> None:
    """It was refused: "what it is to stand on is hollow there: proved"."""
    assert carried_out(container_world(BASKET, free=True), goal).picks == 1


def test_a_can_is_put_into_a_box_that_does_not_move_and_is_no_support() -> None:
    carried_out(container_world(box_walls(0.16, 0.2, 0.1), free=False, yaw=0.4), goals.inside("thing", "basket"))


def test_a_box_is_put_into_a_bowl() -> None:
    bowl = round_walls(0.06, 0.05, 0.3)
    carried_out(container_world(bowl, free=True, object_=SMALL, half=0.03), goals.inside("thing", "basket"))


@pytest.mark.parametrize("free", [True, False])
def test_where_hand_and_walls_leave_no_room_the_object_falls_a_little(free: bool) -> None:
    """It was given up, though walls 28 mm nearer together, or 32 mm farther apart, were no obstacle."""
    world = container_world(box_walls(0.128, 0.128, 0.136, 0.007), free=free, object_=LOW_CAN, half=0.038)
    carried_out(world, goals.inside("thing", "basket"))
    assert world.scene().body("thing").is_upright


def test_something_flat_falls_farther_where_the_hand_stays_above_high_walls() -> None:
    """Cream cheese into LIBERO's basket was refused: it may fall 80 mm at most, and lies between fingers at its top."""
    flat = '<geom type="box" size=".04 .02 .009" mass=".05"/>'
    panda = assets.robot("panda_mobile")
    world = container_world(box_walls(0.125, 0.125, 0.15, 0.007), free=True, object_=flat, half=0.009, robot=panda)
    carried_out(world, goals.inside("thing", "basket"))


def test_a_declared_support_between_high_walls_is_fallen_onto_too() -> None:
    walls = box_walls(0.128, 0.128, 0.136, 0.007).replace("<geom", '<geom name="basket_floor"', 1)
    world = container_world(walls, free=False, object_=LOW_CAN, half=0.038, more_supports=("basket_floor",))
    carried_out(world, goals.on("thing", "basket_floor"))


def test_three_things_find_room_in_one_basket() -> None:
    more = "".join(
        f'<body name="{name}" pos="0.9 {y} {TABLE + 0.0501}"><freejoint/>{CAN}</body>'
        for name, y in (("second", -0.3), ("third", -0.1))
    )
    world = container_world(BASKET, free=True, more=more, movable=("thing", "second", "third"))
    whole = goals.and_(*(goals.inside(name, "basket") for name in world.movable[:3]))
    assert carried_out(world, whole).picks == 3


def test_two_things_that_fall_into_a_narrow_basket_leave_room_for_each_other() -> None:
    """The first of LIBERO's two cans fell into the middle of the basket, and the second found no room beside it."""
    second = f'<body name="second" pos="0.9 -0.1 {TABLE + 0.0381}"><freejoint/>{LOW_CAN}</body>'
    walls, names, panda = box_walls(0.13, 0.142, 0.12, 0.007), ("thing", "second"), assets.robot("panda_mobile")
    world = container_world(walls, free=True, object_=LOW_CAN, half=0.038, more=second, movable=names, robot=panda)
    both = goals.inside("thing", "basket") & goals.inside("second", "basket")
    assert carried_out(world, both).picks == 2


def test_what_is_in_a_basket_leaves_it_before_the_basket_is_moved_and_comes_back() -> None:
    world = container_world(round_walls(0.06, 0.05, 0.0), free=True, object_=SMALL, half=0.03)
    start = world.scene()
    hollow = hollow_of(start, "basket")
    assert hollow is not None
    thing = start.body("thing")
    within = start.with_body(thing.at((*hollow.area.centre, hollow.floor + 0.03)))
    assert objects_on(CollisionWorld.from_scene(within), "basket") == within.mask(["thing"])
    assert not objects_on(CollisionWorld.from_scene(start), "basket")
    goal = goals.inside("thing", "basket") & goals.at("basket", (0.95, -0.1))
    found = solve(within, goal, rng=0)
    assert isinstance(found, Solution)
    moves = [(action.name, action.target) for action in found.actions if action.name != "MoveBase"]
    assert [name for _, name in moves] == ["thing", "thing", "basket", "basket", "thing", "thing"]
    assert found.end is not None
    assert goal.holds(found.end, within)


def test_a_shut_drawer_is_opened_to_put_something_into_it_though_it_is_no_support() -> None:
    world = drawer_world()._replace(supports=("side_table",))
    start = world.scene()
    table = start.support_named("side_table")
    red = start.body("red")
    away = start.with_body(red.at((*table.position[:2] + (0.0, 0.1), table.top + red.half_extents[2])))
    goal = goals.inside("red", "drawer")
    assert not goal.holds(away)
    found = solve(away, goal, rng=0)
    assert isinstance(found, Solution), found
    assert [action.name for action in found.actions if action.name != "MoveBase"] == [
        "Open",
        "PickUp",
        "PutDownGeneral",
    ]
    assert found.end is not None
    assert goal.holds(found.end, away)


def test_what_is_larger_than_the_inside_is_refused_with_both_sizes() -> None:
    wide = '<geom type="box" size=".05 .03 .04" mass=".1"/>'
    found = solve(
        container_world(box_walls(0.09, 0.05, 0.06), free=True, object_=wide, half=0.04).scene(),
        goals.inside("thing", "basket"),
    )
    assert isinstance(found, Infeasible)
    assert "thing, however it is put down, is larger than the inside of basket, " in found.detail
    assert "mm: it measures 60 mm or more: proved" in found.detail


@pytest.mark.parametrize(
    ("walls", "shelf", "told"),
    [
        (
            (0.128, 0.25),
            0.0,
            r"between the walls of basket, 1\d\d mm apart and 2\d\d mm high, a hand that is \d+ mm wide",
        ),
        ((0.19, 0.1), 0.18, r"over the walls of basket, 100 mm high, and under board, 16\d mm above the floor"),
        ((0.19, 0.1), 0.2, r"over the walls of basket, 100 mm high, and under board, 18\d mm above the floor"),
        ((0.14, 0.14), 0.26, r"over the walls of basket, 140 mm high, and under board, 24\d mm above the floor"),
    ],
)
def test_a_refusal_names_walls_and_ceiling_and_the_hand(walls: tuple[float, float], shelf: float, told: str) -> None:
    """It said "given up", or that no base pose and arm configuration were found."""
    wide, high = walls
    board = f"""<body name="shelf" pos="1.0 0.15 {TABLE + shelf}">
      <geom name="board" type="box" size="0.2 0.2 0.01"/></body>"""
    world = container_world(
        box_walls(wide, wide, high), free=False, object_=LOW_CAN, half=0.038, more=board * (shelf > 0)
    )
    found = solve(world.scene(), goals.inside("thing", "basket"), rng=0)
    assert isinstance(found, Infeasible)
    assert re.search(told, found.detail), found.detail


def under_a_high_board() -> World:
    """A basket with a board 0.22 m above its floor. A hand has no room to go up by 190 mm, but to go out sideways."""
    board = f"""<body name="shelf" pos="1.0 0.15 {TABLE + 0.24}">
      <geom name="board" type="box" size="0.2 0.2 0.01"/></body>"""
    return container_world(box_walls(0.19, 0.19, 0.1), free=False, object_=LOW_CAN, half=0.038, more=board)


def test_a_board_under_which_a_hand_goes_out_sideways_is_no_reason() -> None:
    start, goal = under_a_high_board().scene(), goals.inside("thing", "basket")
    candidates = Workspace.of(start.robot, start).grasps()
    assert not why_not.why_not_put(candidates, start, "thing", place_of(start, goal.placed[0]))


@pytest.mark.slow
def test_a_container_under_a_board_is_filled_from_one_of_many_base_poses() -> None:
    """It was refused, since from the few base poses that plans begin with no arm configuration fills it."""
    carried_out(under_a_high_board(), goals.inside("thing", "basket"))


def test_how_far_a_hand_opens_is_worked_out_once_for_a_refusal(monkeypatch: pytest.MonkeyPatch) -> None:
    """It was for each height, wall and place: three minutes for LIBERO's bowl of 40 pieces in a cabinet of 26 walls."""
    asked: list[int] = []

    def opening_around(robot: assets.RobotSpec, body: Body, held: HeldObject) -> float:
        asked.append(id(held))
        return grasp_poses.opening_around(robot, body, held)

    monkeypatch.setattr(why_not, "opening_around", opening_around)
    world = container_world(box_walls(0.128, 0.128, 0.25), free=False, object_=LOW_CAN, half=0.038)
    start, goal = world.scene(), goals.inside("thing", "basket")
    candidates = Workspace.of(start.robot, start).grasps()
    assert why_not.why_not_put(candidates, start, "thing", place_of(start, goal.placed[0]))
    assert len(asked) == len(set(asked))


def test_a_container_into_which_no_hand_reaches_is_refused_before_anything_moves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The basket was moved about for 12 s of CPU time, since that might have helped. Later it was tried in each attempt
    whether a hand fits, and no bound knew of it."""
    tried, kept_out = list[Search](), Search.kept_out

    def counted(search: Search, scene: Scene) -> tuple[str, ...]:
        tried.append(search)
        return kept_out(search, scene)

    warmup()  # the first solve of a process has a search of its own
    monkeypatch.setattr(Search, "kept_out", counted)
    world = container_world(box_walls(0.128, 0.128, 0.25), free=True, object_=LOW_CAN, half=0.038)
    goal = goals.inside("thing", "basket")
    found, bound = solve(world.scene(), goal, rng=0), lower_bound(world.scene(), goal)
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.NO_CLEARANCE_LOCATION
    assert not found.stats.task_plans
    assert "between the walls of basket" in found.detail
    assert len(tried) == 1, "another attempt is in vain"
    assert bound.picks is None
    assert bound.proved
    assert (bound.cause, bound.objects) == (Cause.NO_CLEARANCE_LOCATION, ("thing",))


def test_what_a_held_object_may_be_taken_by_is_not_proved_from_how_it_is_held() -> None:
    """Held level, the can does not get between the walls. Put aside and taken from above, it does."""
    world = container_world(box_walls(0.2, 0.2, 0.16), free=False, object_=LOW_CAN, half=0.038)
    taken = solve(world.scene(), "thing", grasps="side", rng=0)
    assert isinstance(taken, Solution)
    assert taken.end is not None
    assert taken.end.held_names == ("thing",)
    bound = lower_bound(taken.end, goals.inside("thing", "basket"))
    assert bound.picks == 0


@pytest.mark.parametrize(("play", "told"), [(0.0015, "there are not 2 mm left on every side of thing"), (0.02, "")])
def test_what_itself_has_no_room_in_a_container_is_told_from_a_hand_that_has_none(play: float, told: str) -> None:
    wide = 2 * (0.03 + play)
    world = container_world(box_walls(wide, wide, 0.05), free=False)
    found = solve(world.scene(), goals.inside("thing", "basket"), rng=0)
    if told:
        assert isinstance(found, Infeasible)
        assert told in found.detail, found.detail
    else:
        assert isinstance(found, Solution)


@pytest.mark.parametrize("turned", [0.0, 0.37])
def test_a_box_that_fits_along_the_walls_alone_is_let_go_along_them(turned: float) -> None:
    """A hand at any of the 24 yaws that are tried elsewhere would touch the walls."""
    block = '<geom type="box" size=".03 .024 .06" mass=".1"/>'
    walls = box_walls(0.072, 0.06, 0.05)
    world = container_world(walls, free=False, yaw=turned, object_=block, half=0.06)
    carried_out(world, goals.inside("thing", "basket"))


def test_where_a_hand_fits_across_the_middle_alone_it_lets_go_there() -> None:
    """A hand as wide as the box fits in aslant, at the very middle, which was no point of the grid."""
    block = '<geom type="box" size=".025 .025 .043" mass=".1"/>'
    world = container_world(box_walls(0.102, 0.098, 0.137), free=True, yaw=-0.81, object_=block, half=0.043)
    carried_out(world, goals.inside("thing", "basket"))
