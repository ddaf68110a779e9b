"""The gripper as a parameter of the actions: whose grasp it is, and how many may hold something."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec

import pytest

from planners.symbolic.engines import task_planner
from planners.symbolic.problem import GRIPPER, TaskPlan, TaskProblem, domain_text
from planners.symbolic.transitions import (
    ArmStep,
    Moved,
    initial_state,
    reached_by,
    unmet_preconditions,
    update_from_action,
    with_moves,
)
from tests.planners.symbolic.problems import obstruction_problem

LEFT, RIGHT = "left_gripper", "right_gripper"
ENGINES = ["astar", *(["kairos"] if find_spec("kairos") else [])]


def problem(arms: dict[str, str], holds_aside: bool = False) -> TaskProblem:
    """The target "t" behind "o", each taken by the gripper that is named."""
    state = obstruction_problem("t", {"t": ["o"]}, grippers=(LEFT, RIGHT)).state
    for name, gripper in arms.items():
        state = reached_by(state, name, gripper)
    return TaskProblem(replace(state, holds_aside=holds_aside), "t")


def planned(engine: str, task: TaskProblem) -> list[tuple[str, str | None]]:
    """Names and grippers of the arm actions of a plan that is applicable and reaches the goal."""
    found = task_planner(engine).plan(task, 10.0)
    assert isinstance(found, TaskPlan), found
    state = task.state
    for action in found.actions:
        state = update_from_action(state, action)
    assert task.goal in state.facts
    return [(action.name, action.gripper) for action in found.actions if action.name != "MoveBase"]


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("obstacle", "target"), [(LEFT, RIGHT), (RIGHT, LEFT), (LEFT, LEFT)])
def test_each_object_is_taken_by_its_gripper_once_all_are_empty(engine: str, obstacle: str, target: str) -> None:
    actions = planned(engine, problem({"o": obstacle, "t": target}))
    assert actions == [("PickUp", obstacle), ("PutDownForClearance", obstacle), ("PickUp", target)]


@pytest.mark.parametrize("engine", ENGINES)
def test_an_obstacle_held_aside_is_not_put_down(engine: str) -> None:
    actions = planned(engine, problem({"o": LEFT, "t": RIGHT}, holds_aside=True))
    assert actions == [("PickUp", LEFT), ("PickUp", RIGHT)]


def test_a_full_gripper_forbids_picking_up_unless_objects_are_held_aside() -> None:
    task = problem({"o": LEFT, "t": RIGHT})
    plan = task_planner("astar").plan(task, 10.0)
    assert isinstance(plan, TaskPlan)
    drive, pick, *_, last = plan.actions
    state = update_from_action(update_from_action(task.state, drive), pick)
    assert ("empty", LEFT) in unmet_preconditions(state, last)
    assert ("empty", LEFT) not in unmet_preconditions(replace(state, holds_aside=True), last)


def test_a_grasp_of_the_other_arm_is_out_of_reach() -> None:
    task = problem({"o": LEFT, "t": RIGHT})
    plan = task_planner("astar").plan(task, 10.0)
    assert isinstance(plan, TaskPlan)
    drive, pick = plan.actions[:2]
    other = pick._replace(args=(pick.args[0], RIGHT, *pick.args[2:]))
    state = update_from_action(task.state, drive)
    assert unmet_preconditions(state, pick) == ()
    assert unmet_preconditions(state, other) == (("not", "outOfReach", RIGHT, pick.args[3]),)


def test_the_problem_of_a_robot_with_one_arm_names_one_gripper_and_no_reach() -> None:
    task = obstruction_problem("t", {"t": ["o"]})
    assert task.state.grippers == (GRIPPER,)
    assert "outOfReach" not in task.text()
    assert task.goal == ("graspedBy", "t", GRIPPER)


def test_the_two_domains_differ_in_one_precondition() -> None:
    usual, relaxed = domain_text().splitlines(), domain_text(holds_aside=True).splitlines()
    different = [(one, other) for one, other in zip(usual, relaxed, strict=True) if one != other]
    assert len(different) == 1
    assert "(forall (?any - gripper) (empty ?any))" in different[0][0]
    assert "(empty ?gripper)" in different[0][1]


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    "order", ["pick a, put a, pick b, put b", "pick a, pick b, put b, put a", "pick b, pick a, put b, put a"]
)
def test_picks_and_put_downs_come_in_the_order_of_the_steps(engine: str, order: str) -> None:
    """One gripper keeps an object while the other one moves another, if the steps say so."""
    steps = [ArmStep(word[-1], word.startswith("put")) for word in order.split(", ")]
    moves = [Moved(step.object, (), True) for step in steps if step.is_put_down]
    state, wanted = with_moves(initial_state("ab", grippers=(LEFT, RIGHT)), moves, steps)
    state = replace(reached_by(reached_by(state, "a", LEFT), "b", RIGHT), holds_aside=True)
    task = TaskProblem(state, "", wanted)
    found = task_planner(engine).plan(task.pruned(), 10.0)
    assert isinstance(found, TaskPlan), found
    made = [(action.object, action.name == "PutDownGeneral") for action in found.actions if action.object]
    assert made == [tuple(step) for step in steps]
    for action in found.actions:
        state = update_from_action(state, action)
    assert set(wanted) <= state.facts
