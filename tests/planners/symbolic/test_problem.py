"""The symbolic state, its updates, and the problem text, against an independent reading of the PDDL domain."""

from __future__ import annotations

import numpy as np
import pytest

from planners.symbolic.problem import (
    GroundAction,
    SymbolError,
    SymbolicState,
    TaskProblem,
    domain_text,
    format_plan,
)
from planners.symbolic.transitions import (
    GraspObstructed,
    InapplicableActionError,
    applicable_actions,
    apply_action,
    grasp_references,
    initial_state,
    placement_references,
    unmet_preconditions,
    update_from_action,
    update_from_error,
)
from tests.planners.symbolic.plan_validator import Judge
from tests.planners.symbolic.problems import names, obstruction_problem, random_problem

CUP, JAR, CAN = "object_01", "object_36", "object_07"
GRIPPER = "robot_gripper"


def drive(state: SymbolicState, pose: str) -> SymbolicState:
    trajectory = state.find("isBaseMotion", None, pose)[0][1]
    return update_from_action(state, GroundAction("MoveBase", (state.robot_at, pose, trajectory)))


def pick_up(state: SymbolicState, name: str) -> SymbolicState:
    base, arm, _, path = grasp_references(name)
    location = state.find("objectAt", name, None)[0][2]
    action = GroundAction("PickUp", (name, GRIPPER, base, arm, path, location))
    return update_from_action(drive(state, base), action)


def clear_away(state: SymbolicState, name: str, target: str, location: str) -> SymbolicState:
    base, arm, _, path = placement_references(location)
    action = GroundAction("PutDownForClearance", (name, target, GRIPPER, base, arm, path, location))
    return update_from_action(drive(state, base), action)


def test_effects_and_applicability_match_the_pddl_domain_on_random_walks() -> None:
    rng = np.random.default_rng(0)
    for _ in range(30):
        problem = random_problem(rng)
        state, judge = problem.state, Judge(domain_text(), problem.text())
        assert judge.facts == set(state.facts)
        for _ in range(12):
            actions = list(applicable_actions(state))
            action = actions[int(rng.integers(len(actions)))]
            state = apply_action(state, action)
            assert judge.apply(action.name, action.args) == ""
            assert judge.facts == set(state.facts)


def test_inapplicable_actions_are_refused_by_both() -> None:
    rng = np.random.default_rng(1)
    for _ in range(8):
        problem = random_problem(rng)
        possible = set(applicable_actions(problem.state))
        later = problem.state
        for _ in range(6):
            actions = list(applicable_actions(later))
            later = apply_action(later, actions[int(rng.integers(len(actions)))])
            for action in set(applicable_actions(later)) - possible:
                assert unmet_preconditions(problem.state, action)
                assert Judge(domain_text(), problem.text()).apply(action.name, action.args) != ""
                with pytest.raises(InapplicableActionError, match=action.name):
                    apply_action(problem.state, action)


def test_pruning_keeps_what_the_target_waits_for_and_nothing_else() -> None:
    blockers = {CUP: {JAR}, JAR: {CAN}, "object_20": {"object_21"}}
    problem = obstruction_problem(CUP, blockers, objects=names(40))
    pruned = problem.pruned()
    assert pruned.relevant_objects() == {CUP, JAR, CAN}
    assert {fact[1] for fact in pruned.state.find("objectAt", None, None)} == {CUP, JAR, CAN}
    assert pruned.state.facts <= problem.state.facts
    assert pruned.pruned() == pruned
    assert len(pruned.text()) < len(problem.text()) / 4


def test_obstructed_grasp_teaches_obstacle_obstructs_and_clearance_location() -> None:
    state = initial_state([CUP, JAR])
    learnt = update_from_error(state, GraspObstructed(CUP, frozenset({JAR}))).facts - state.facts
    assert {
        ("obstacle", JAR),
        ("obstructs", JAR, "arm_mp_object_01", CUP),
        ("isClearanceLocation", "table_loc_36", JAR, CUP),
    } <= learnt


def test_rebinding_a_grasp_forgets_what_obstructed_the_old_one() -> None:
    state = initial_state([CUP, JAR, CAN])
    first = update_from_error(state, GraspObstructed(CUP, frozenset({JAR})))
    second = update_from_error(first, GraspObstructed(CUP, frozenset({CAN})))
    assert second.blockers() == {CUP: {"arm_mp_object_01": {CAN}}}
    assert second.find("obstacle", None) == [("obstacle", CAN)]
    assert not second.find("isClearanceLocation", None, JAR, None)
    assert update_from_error(second, GraspObstructed(CUP, frozenset())).blockers() == {}


def test_an_obstacle_of_two_objects_is_still_one_when_one_grasp_is_rebound() -> None:
    state = initial_state([CUP, JAR, CAN])
    for blocked in (CUP, JAR):
        state = update_from_error(state, GraspObstructed(blocked, frozenset({CAN})))
    state = update_from_error(state, GraspObstructed(JAR, frozenset()))
    assert state.find("obstacle", None) == [("obstacle", CAN)]
    assert state.find("isClearanceLocation", None, CAN, None) == [("isClearanceLocation", "table_loc_07", CAN, CUP)]


def test_clearing_twice_uses_a_new_location_and_the_same_grasp_references() -> None:
    state = obstruction_problem(CUP, {CUP: {JAR}}).state
    state = clear_away(pick_up(state, JAR), JAR, CUP, "table_loc_36")
    assert not state.find("obstacle", None)
    assert state.find("isGrasp", None, JAR, None) == [("isGrasp", "arm_gp_object_36", JAR, "table_loc_36")]
    state = update_from_error(state, GraspObstructed(CUP, frozenset({JAR})))
    assert state.find("isClearanceLocation", None, JAR, CUP)[0][1] == "table_loc_36_2"
    state = clear_away(pick_up(state, JAR), JAR, CUP, "table_loc_36_2")
    assert TaskProblem(pick_up(state, CUP), CUP).is_solved


def test_moving_an_object_forgets_what_obstructed_its_grasp_and_what_it_obstructed() -> None:
    state = obstruction_problem(CUP, {CUP: {JAR}}).state
    state = pick_up(state, JAR)
    assert not state.blockers()
    assert state.all_held == (JAR,)


def test_held_object_that_is_no_obstacle_has_a_placement() -> None:
    state = initial_state([CUP, JAR], {GRIPPER: JAR})
    assert state.all_held == (JAR,)
    assert state.find("isPlacementLocation", None, JAR) == [("isPlacementLocation", "table_loc_36", JAR)]


def test_plan_is_printed_as_in_figure_13() -> None:
    base, arm, drive_path, path = grasp_references(JAR)
    actions = [
        GroundAction("MoveBase", ("robot_init_loc", base, drive_path)),
        GroundAction("PickUp", (JAR, GRIPPER, base, arm, path, f"{JAR}_init_loc")),
    ]
    assert format_plan(actions).splitlines() == [
        "1 MOVEBASE_FETCH",
        "(ROBOT_INIT_LOC ROBOT_GP_OBJECT_36 ROBOT_MP_OBJECT_36)",
        "2 PICKUP_FETCH",
        "(OBJECT_36 ROBOT_GRIPPER ROBOT_GP_OBJECT_36 ARM_GP_OBJECT_36 ARM_MP_OBJECT_36 OBJECT_36_INIT_LOC)",
    ]
    assert (actions[1].object, actions[0].object) == (JAR, None)


def test_misuse_is_refused() -> None:
    with pytest.raises(SymbolError, match="no fact"):
        TaskProblem(SymbolicState(frozenset({("likes", CUP)})), CUP).text()
    with pytest.raises(InapplicableActionError, match="no action"):
        unmet_preconditions(initial_state([CUP]), GroundAction("Fly", ()))
