"""Strategies and task planners of the user's own, and what is said when they are none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from assets.robots import FETCH
from planners import STRATEGIES, Cause, GroundAction, Infeasible, NoPlan, Planner, Solution, Strategy, TaskPlan, solve
from planners.scene import Scene
from planners.strategies import StrategyError, UnknownStrategy
from planners.symbolic.astar import AStar
from planners.symbolic.engines import InvalidAnswerError, UnknownEngineError, without_detours
from planners.symbolic.problem import TaskProblem
from tests.planners.scenes import cylinder, table_scene


class ShortestPlans:
    """A task planner as a user would write it: no base class, no name."""

    def __init__(self) -> None:
        self.problems: list[TaskProblem] = []

    def plan(self, problem: TaskProblem, time_limit: float) -> TaskPlan | NoPlan:
        self.problems.append(problem)
        return AStar().plan(problem, time_limit)


class Answers:
    """A task planner that always returns the same."""

    name = "answers"

    def __init__(self, answer: object) -> None:
        self.answer = answer

    def plan(self, problem: TaskProblem, time_limit: float) -> object:
        assert problem.goal not in problem.state.facts
        assert time_limit > 0
        return self.answer


def free_object() -> Scene:
    return table_scene(cylinder("object_00", 0.0, 0.0))


def test_a_strategy_object_is_as_good_as_its_name() -> None:
    scene = free_object()
    by_name = solve(scene, "object_00", "dogar", np.random.default_rng(0))
    by_object = solve(scene, "object_00", STRATEGIES["dogar"], np.random.default_rng(0))
    own = solve(scene, "object_00", Strategy("mine", "greedy", "ngr", "random"), np.random.default_rng(0))
    for found in (by_name, by_object, own):
        assert isinstance(found, Solution)
    assert [str(action) for action in by_name.actions] == [str(action) for action in by_object.actions]  # type: ignore[union-attr]  # asserted above


@pytest.mark.parametrize("choice", ["magic", 3, None, Strategy])
def test_what_is_no_strategy_is_refused(choice: object) -> None:
    with pytest.raises(UnknownStrategy, match=r"lookahead, ngr, dogar, srivastava.*planners\.Strategy"):
        solve(free_object(), "object_00", choice)  # type: ignore[arg-type]  # misuse on purpose


def test_a_strategy_with_an_unknown_value_lists_the_valid_ones() -> None:
    with pytest.raises(StrategyError, match=r"mine.*region='everything'.*'none', 'ngr1', 'ngr'"):
        Strategy("mine", "greedy", "everything", "random")  # type: ignore[arg-type]  # misuse on purpose
    with pytest.raises(StrategyError, match="locations"):
        replace(STRATEGIES["ngr"], locations="nearest")  # type: ignore[arg-type]  # misuse on purpose
    for field, value in (("grasps", np.zeros(3)), ("name", None), ("plans_ahead", "no"), ("leaves_cleared", 1)):
        with pytest.raises(StrategyError, match=f"{field}=.* is not valid"):
            replace(STRATEGIES["ngr"], **{field: value})


def test_a_task_planner_object_plans() -> None:
    own = ShortestPlans()
    found = Planner(FETCH, engine=own).solve(free_object(), "object_00")
    assert isinstance(found, Solution)
    assert [action.name for action in found.actions] == ["MoveBase", "PickUp"]
    assert own.problems
    assert own.problems[0] == own.problems[0].pruned(), "objects that do not matter are left out before"


class HasNoPlan:
    name = "kairos"


class HasOtherArguments:
    def plan(self) -> None: ...


@pytest.mark.parametrize("engine", [3, HasNoPlan(), HasOtherArguments(), ShortestPlans, "metric-ff", ""])
def test_what_is_no_task_planner_is_refused_at_construction(engine: object) -> None:
    with pytest.raises(UnknownEngineError, match=r"plan\(problem, time_limit\)"):
        Planner(FETCH, engine=engine)  # type: ignore[arg-type]  # misuse on purpose


DRIVE = GroundAction("MoveBase", ("robot_init_loc", "robot_gp_object_00", "robot_mp_object_00"))


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (None, "must return a TaskPlan or a NoPlan"),
        (TaskPlan(()), r"ends without \(graspedBy object_00 robot_gripper\)"),
        (TaskPlan((DRIVE,)), r"ends without \(graspedBy object_00 robot_gripper\)"),
        (TaskPlan((GroundAction("Fly", ("object_00",)),)), "step 1.*no action of the domain"),
        (TaskPlan((GroundAction("PickUp", ("object_00", *"abcde")),)), "step 1.*not applicable"),
        (NoPlan("tired"), "valid reasons: cyclic"),  # type: ignore[arg-type]  # misuse on purpose
    ],
)
def test_an_answer_that_is_none_names_the_planner_and_the_step(answer: object, message: str) -> None:
    planner = Planner(FETCH, engine=Answers(answer))  # type: ignore[arg-type]  # misuse on purpose
    with pytest.raises(InvalidAnswerError, match=message):
        planner.solve(free_object(), "object_00", "ngr")


def test_a_refusal_of_a_task_planner_is_a_cause() -> None:
    found = Planner(FETCH, engine=Answers(NoPlan("gave up"))).solve(free_object(), "object_00", "ngr")  # type: ignore[arg-type]  # Answers is loosely typed
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.TIME_LIMIT
    assert found.detail.startswith("answers")


def test_base_motions_in_a_row_become_one() -> None:
    away = GroundAction("MoveBase", ("robot_init_loc", "elsewhere", "path_1"))
    on = GroundAction("MoveBase", ("elsewhere", "robot_gp_object_00", "robot_mp_object_00"))
    assert without_detours((away, on)) == (DRIVE,)
    assert without_detours((away, GroundAction("MoveBase", ("elsewhere", "robot_init_loc", "path_2")))) == ()
