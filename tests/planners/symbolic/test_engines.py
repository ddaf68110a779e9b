"""Every engine's plans are judged by an independent validator, and the engines agree."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from planners.symbolic import engines
from planners.symbolic.astar import AStar, LowerBound
from planners.symbolic.engines import (
    EngineFailedError,
    MissingEngineError,
    UnknownEngineError,
    checked_answer,
    default_engine,
    task_planner,
    why_unsolvable,
)
from planners.symbolic.problem import NoPlan, TaskPlan, TaskProblem, domain_text
from planners.symbolic.transitions import apply_action, grasp_references, placement_references
from tests.planners.symbolic.plan_validator import fault
from tests.planners.symbolic.problems import names, obstruction_problem, random_problem

TIME_LIMIT = 20.0  # [s], far above what any of these problems needs

NEEDS = {
    "astar": "planners",
    "kairos": "kairos",
    "fast-downward": "up_fast_downward",
    "fast-downward:ff": "up_fast_downward",
    "up:fast-downward": "up_fast_downward",
}
INSTALLED = [name for name, module in NEEDS.items() if find_spec(module) is not None]
FAST = [name for name in INSTALLED if name in ("astar", "kairos")]


def verdict(name: str, problem: TaskProblem) -> int | tuple[str, tuple[str, ...]]:
    """Length of the validated plan, or reason and evidence."""
    problem, planner = problem.pruned(), task_planner(name)
    result = checked_answer(problem, planner.plan(problem, TIME_LIMIT), planner)
    assert result.engine == name
    if isinstance(result, NoPlan):
        return result.reason, result.evidence
    assert fault(domain_text(), problem.text(), result.actions) == ""
    return len(result.actions)


def test_fast_engines_agree_on_random_obstruction_graphs() -> None:
    rng = np.random.default_rng(0)
    solved = 0
    for _ in range(80):
        problem = random_problem(rng)
        verdicts = {verdict(name, problem) for name in FAST}
        assert len(verdicts) == 1, verdicts
        solved += isinstance(verdicts.pop(), int)
    assert 20 < solved < 75


@pytest.mark.parametrize("name", [name for name in INSTALLED if name not in FAST])
def test_processes_agree_with_our_own_search(name: str) -> None:
    rng = np.random.default_rng(1)
    for _ in range(4):
        problem = random_problem(rng)
        assert verdict(name, problem) == verdict("astar", problem)
    cycle = obstruction_problem("object_00", {"object_00": {"object_01"}, "object_01": {"object_02", "object_00"}})
    assert verdict(name, cycle) == verdict("astar", cycle)


@pytest.mark.parametrize("name", FAST)
@pytest.mark.parametrize("count", [0, 1, 3, 6, 10])
def test_k_obstacles_take_4k_plus_2_actions(name: str, count: int) -> None:
    target, *others = names(count + 1)
    star = obstruction_problem(target, {target: set(others)}, objects=names(40))
    assert verdict(name, star) == 4 * count + 2
    chain = obstruction_problem(target, {a: {b} for a, b in zip([target, *others], others, strict=False)})
    assert verdict(name, chain) == 4 * count + 2


@pytest.mark.parametrize("name", FAST)
def test_objects_that_obstruct_each_other_are_proved_cyclic(name: str) -> None:
    blockers = {"a": {"b"}, "b": {"c", "e"}, "c": {"d"}, "d": {"c"}}
    assert verdict(name, obstruction_problem("a", blockers)) == ("cyclic", ("c", "d"))


@pytest.mark.parametrize("name", FAST)
def test_other_grasps_resolve_a_cycle(name: str) -> None:
    problem = obstruction_problem("a", {"a": {"b"}, "b": {"a"}})
    assert verdict(name, problem) == ("cyclic", ("a", "b"))
    base, arm, path = "robot_gp_b_2", "arm_gp_b_2", "arm_mp_b_2"
    other = {("isGrasp", arm, "b", "b_init_loc"), ("isMotion", path, base, arm), ("isBaseMotion", "robot_mp_b_2", base)}
    assert verdict(name, TaskProblem(problem.state.changed(add=other), "a")) == 6


@pytest.mark.parametrize("name", FAST)
def test_causes_other_than_cycles(name: str) -> None:
    problem = obstruction_problem("a", {"a": {"b"}})
    offers = problem.state.find("isClearanceLocation", None, "b", None)
    assert verdict(name, TaskProblem(problem.state.changed(remove=offers), "a")) == ("no location", ("b",))
    grasps = problem.state.find("isGrasp", "arm_gp_b", "b", None)
    assert verdict(name, TaskProblem(problem.state.changed(remove=grasps), "a")) == ("no grasp", ("b",))
    holding = obstruction_problem("a", {}, objects=["c"], held="b", held_obstructs="a")
    in_the_way = {("obstructs", "c", "arm_mp_table_loc_b", "b")}
    assert verdict(name, TaskProblem(holding.state.changed(add=in_the_way), "a")) == ("no location", ("b",))
    assert verdict(name, holding) == 4


@pytest.mark.parametrize("name", FAST)
def test_a_base_pose_that_serves_two_steps_saves_a_drive(name: str) -> None:
    problem = obstruction_problem("a", {"a": {"b"}})
    shared = ("isMotion", placement_references("table_loc_b").arm_trajectory, "robot_gp_b", "arm_pdp_table_loc_b")
    also = ("isMotion", grasp_references("a").arm_trajectory, "robot_gp_b", "arm_gp_a")
    assert verdict(name, problem) == 6
    assert verdict(name, TaskProblem(problem.state.changed(add={shared, also}), "a")) == 4


@pytest.mark.parametrize("name", FAST)
def test_nothing_to_do_when_the_target_is_held(name: str) -> None:
    assert verdict(name, obstruction_problem("a", {}, held="a")) == 0


def test_lower_bound_never_exceeds_what_is_left_of_a_shortest_plan() -> None:
    rng = np.random.default_rng(2)
    for _ in range(40):
        problem = random_problem(rng)
        plan = AStar().plan(problem)
        bound = LowerBound(problem)
        if isinstance(plan, NoPlan):
            continue
        state = problem.state
        for done, action in enumerate(plan.actions):
            assert bound(state) <= len(plan.actions) - done
            state = apply_action(state, action)
        assert bound(state) == 0


def test_unsolvable_problems_have_a_cause() -> None:
    rng = np.random.default_rng(3)
    for _ in range(60):
        problem = random_problem(rng)
        assert isinstance(AStar().plan(problem), NoPlan) == (why_unsolvable(problem) is not None)


def test_running_out_of_time_is_no_proof() -> None:
    problem = obstruction_problem("object_00", {"object_00": set(names(9)[1:])})
    assert AStar().plan(problem, 0.0) == NoPlan("gave up")


def test_engines_are_chosen_by_name() -> None:
    with pytest.raises(UnknownEngineError, match=r"kairos.*astar.*fast-downward"):
        task_planner("metric-ff")
    assert task_planner().name == default_engine()


@pytest.mark.parametrize("name", ["kairos", "fast-downward", "fast-downward:ff", "up:tamer"])
def test_a_missing_engine_says_how_to_install_it(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engines, "find_spec", lambda _: None)
    with pytest.raises(MissingEngineError, match="pip install"):
        task_planner(name)
    assert default_engine() == "astar"


STUB = """
import sys
search, answers = sys.argv[1], {"let(hff,ff(),ehc": EHC, "let(hff,ff(),eager_greedy": GREEDY}
print(search, file=open("LOG", "a"))
print(next(answer for begin, answer in answers.items() if search.startswith(begin)))
"""
"""A program in place of Fast Downward: it logs its search and answers with a status of unified-planning or a plan."""


LOG_MESSAGE = SimpleNamespace(message="killed by signal 9\n")


def fake_unified_planning(program: Path) -> SimpleNamespace:
    """As much of unified-planning as `UnifiedPlanning` uses, with an engine that is a program."""

    class Engine:
        def __init__(self, name: str, params: dict[str, str]) -> None:
            assert name == "fast-downward"
            self.search = params["fast_downward_search_config"]

        def __enter__(self) -> Engine:
            return self

        def __exit__(self, *_: object) -> None: ...

        def solve(self, _: object, timeout: float) -> SimpleNamespace:
            command = [sys.executable, str(program), self.search]
            answer = subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=True).stdout.strip()
            if not answer.startswith("("):
                return SimpleNamespace(plan=None, status=SimpleNamespace(name=answer), log_messages=[LOG_MESSAGE])
            words = [line.strip("()").split() for line in answer.splitlines()]
            steps = [SimpleNamespace(action=SimpleNamespace(name=w[0]), actual_parameters=w[1:]) for w in words]
            return SimpleNamespace(plan=SimpleNamespace(actions=steps))

    plans = {"fast-downward": True, "grounder": False}
    kinds = {name: SimpleNamespace(is_oneshot_planner=lambda name=name: plans[name]) for name in plans}
    environment = SimpleNamespace(factory=SimpleNamespace(engines=list(plans), engine=kinds.get))
    reader = SimpleNamespace(parse_problem_string=lambda domain, problem: (domain, problem))
    return SimpleNamespace(get_environment=lambda: environment, OneshotPlanner=Engine, PDDLReader=lambda: reader)


@pytest.mark.parametrize(
    ("ehc", "greedy", "answer", "searches"),
    [
        ("PLAN", "INTERNAL_ERROR", 2, 1),
        ("UNSOLVABLE_INCOMPLETELY", "PLAN", 2, 2),
        ("UNSOLVABLE_INCOMPLETELY", "UNSOLVABLE_INCOMPLETELY", "gave up", 2),
        ("UNSOLVABLE_PROVEN", "PLAN", "unsolvable", 1),
    ],
)
def test_ff_climbs_hills_and_then_searches_along_all_actions(
    ehc: str, greedy: str, answer: int | str, searches: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, log, program = obstruction_problem("a", {}).pruned(), tmp_path / "log", tmp_path / "downward.py"
    expected = AStar().plan(problem)
    assert isinstance(expected, TaskPlan)
    plan = "\n".join(f"({' '.join((a.name, *a.args)).lower()})" for a in expected.actions)
    text = STUB.replace("LOG", str(log))
    for word, status in (("EHC", ehc), ("GREEDY", greedy)):
        text = text.replace(word, repr(plan if status == "PLAN" else status))
    program.write_text(text)
    fake = fake_unified_planning(program)
    monkeypatch.setattr(engines, "_require", lambda *_: fake)
    monkeypatch.setattr("importlib.import_module", lambda _: fake)
    found = task_planner("fast-downward:ff").plan(problem, TIME_LIMIT)
    assert (found.reason if isinstance(found, NoPlan) else len(found.actions)) == answer
    assert not isinstance(found, TaskPlan) or found.actions == expected.actions
    assert len(log.read_text().splitlines()) == searches


def test_an_engine_that_breaks_down_or_does_not_plan_is_named_with_its_words(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Engines that raise ended in their own traceback; those that do not plan, in an assertion without a word."""
    program = tmp_path / "engine.py"
    fake, problem = fake_unified_planning(program), obstruction_problem("a", {})
    monkeypatch.setattr(engines, "_require", lambda *_: fake)
    monkeypatch.setattr("importlib.import_module", lambda _: fake)
    with pytest.raises(MissingEngineError, match="'grounder' here that plans; it has: fast-downward;"):
        task_planner("up:grounder")
    for text, words in (
        ("raise OSError", "fast-downward:ff: CalledProcessError: "),
        ("print('MEMOUT')", "MEMOUT: killed"),
    ):
        program.write_text(text)
        with pytest.raises(EngineFailedError, match=words):
            task_planner("fast-downward:ff").plan(problem, TIME_LIMIT)


def test_ff_stops_at_its_time_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    fake = fake_unified_planning(Path("nothing that could run"))
    monkeypatch.setattr(engines, "_require", lambda *_: fake)
    monkeypatch.setattr("importlib.import_module", lambda _: fake)
    problem = obstruction_problem("a", {})
    assert task_planner("fast-downward:ff").plan(problem, 0.0) == NoPlan("gave up")


@pytest.mark.slow
@pytest.mark.skipif(find_spec("unified_planning") is None, reason="needs unified-planning")
def test_an_engine_unknown_to_unified_planning_is_named() -> None:
    with pytest.raises(MissingEngineError, match="no engine 'nobody'"):
        task_planner("up:nobody")


def test_validator_rejects_a_plan_with_a_step_missing() -> None:
    problem = obstruction_problem("a", {"a": {"b"}})
    plan = AStar().plan(problem)
    assert isinstance(plan, TaskPlan)
    for left_out in range(len(plan.actions)):
        assert fault(domain_text(), problem.text(), plan.actions[:left_out] + plan.actions[left_out + 1 :]) != ""
