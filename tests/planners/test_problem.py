"""A problem that is kept: asked twice it answers the same, and in the scenes that follow it answers as a new one."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from assets.robots import FETCH
from planners import Cause, Infeasible, Planner, Problem, Scene, SceneError, Solution, StaticObstacle
from planners.clock import Deadline
from planners.collision.world import CollisionWorld
from planners.goals import GoalError, holding, on
from planners.motion.kept import KeptMotions
from planners.motion.path import WholeBodyPath, on_base
from planners.scene import UnknownObject
from planners.strategies import STRATEGIES
from planners.symbolic.engines import task_planner
from planners.tamp import attempts
from planners.tamp.algorithm1 import task_and_motion_plan
from planners.tamp.state import Search
from tests.planners.scenes import cylinder, random_scene, table_scene

PLANNER = Planner(FETCH, grasps="side")
SCENE = random_scene(25, 3)
TARGET = next(name for name in SCENE.names if (PLANNER.clearance_floor(SCENE, name).count or 0) > 1)


def moved(scene: Scene, name: str, x: float, y: float) -> Scene:
    body = scene.body(name)
    return scene.with_body(body.at(body.position + [x, y, 0.0]))


def shifted_scenes() -> list[Scene]:
    """The scene, one object in it 5 cm elsewhere, where nothing overlaps."""
    found = []
    for name in SCENE.names:
        for x, y in ((0.05, 0.0), (0.0, 0.05), (-0.05, 0.0), (0.0, -0.05)):
            scene = moved(SCENE, name, x, y)
            try:
                PLANNER.problem(scene, TARGET)
            except SceneError:
                continue
            found.append(scene)
            break
    return found


def same_motions(one: Solution, other: Solution) -> bool:
    return [action.name for action in one.actions] == [action.name for action in other.actions] and all(
        np.array_equal(a.trajectory.states, b.trajectory.states)
        for a, b in zip(one.actions, other.actions, strict=True)
    )


def test_a_problem_asked_twice_gives_the_same_plan_as_solve() -> None:
    problem = PLANNER.problem(SCENE, TARGET)
    plans = [PLANNER.solve_problem(problem), PLANNER.solve_problem(problem), PLANNER.solve(SCENE, TARGET)]
    first, second, fresh = plans
    assert isinstance(first, Solution)
    assert isinstance(second, Solution)
    assert isinstance(fresh, Solution)
    assert same_motions(first, second)
    assert same_motions(first, fresh)


def test_the_bound_is_asked_for_once_and_is_that_of_the_plan() -> None:
    problem = PLANNER.problem(SCENE, TARGET)
    bound = problem.lower_bound()
    assert problem.lower_bound() is bound
    assert bound == PLANNER.lower_bound(SCENE, TARGET)
    plan = PLANNER.solve_problem(problem)
    assert isinstance(plan, Solution)
    assert plan.bound == bound


@pytest.mark.parametrize("number", range(4))
def test_after_a_change_the_picks_are_those_of_a_new_problem(number: int) -> None:
    scenes = shifted_scenes()
    scene = scenes[number * len(scenes) // 4]
    problem = PLANNER.problem(SCENE, TARGET)
    PLANNER.solve_problem(problem)
    kept, fresh = PLANNER.solve_problem(problem.in_scene(scene)), PLANNER.solve(scene, TARGET)
    if isinstance(fresh, Infeasible):
        assert isinstance(kept, Infeasible)
        assert kept.cause == fresh.cause
    else:
        assert isinstance(kept, Solution)
        assert kept.picks == fresh.picks
        assert kept.bound is not None
        assert kept.bound.picks == (fresh.bound and fresh.bound.picks)


@pytest.mark.parametrize(
    ("seed", "target", "name", "x", "y"),
    [
        (3, "object_26", "object_18", 0.0395, 0.0404),
        (9, "object_18", "object_11", 0.009, 0.011),
        (35, "object_09", "object_26", -0.075, -0.0341),
        (38, "object_29", "object_31", -0.0494, -0.0689),
    ],
)
def test_a_grasp_not_worth_keeping_before_counts_where_the_better_one_is_blocked_now(
    seed: int, target: str, name: str, x: float, y: float
) -> None:
    scene = random_scene(35, seed)
    problem, changed = PLANNER.problem(scene, target), moved(scene, name, x, y)
    problem.lower_bound()
    kept, fresh = problem.in_scene(changed).lower_bound(), PLANNER.problem(changed, target).lower_bound()
    assert fresh.picks is not None
    assert (kept.picks, kept.least, kept.proved) == (fresh.picks, fresh.least, fresh.proved)


def test_paper_strategies_learn_nothing_from_a_problem_that_is_kept() -> None:
    problem = PLANNER.problem(SCENE, TARGET)
    PLANNER.solve_problem(problem)
    kept, fresh = PLANNER.solve_problem(problem, "ngr"), PLANNER.solve(SCENE, TARGET, "ngr")
    assert isinstance(kept, Solution)
    assert isinstance(fresh, Solution)
    assert same_motions(kept, fresh)


def test_another_table_another_robot_or_a_goal_that_means_nothing_is_refused() -> None:
    problem = PLANNER.problem(SCENE, TARGET)
    post = StaticObstacle("post", np.array([2.0, 0.0, 0.5]), np.array([0.05, 0.5, 0.5]))
    with pytest.raises(SceneError, match="new problem"):
        problem.in_scene(replace(SCENE, static_obstacles=(*SCENE.static_obstacles, post)))
    with pytest.raises(UnknownObject):
        problem.in_scene(replace(SCENE, objects=tuple(one for one in SCENE.objects if one.name != TARGET)))
    with pytest.raises(GoalError):
        PLANNER.problem(SCENE, on(TARGET, "nowhere"))
    with pytest.raises(SceneError, match="no Scene"):
        problem.in_scene("scene")  # type: ignore[arg-type]  # what a user may pass by mistake
    PLANNER.solve_problem(problem)


def test_a_motion_is_kept_unless_something_that_moved_comes_near_it() -> None:
    scene = table_scene(cylinder("object_00", 0.3, 0.4), cylinder("object_01", 0.3, -0.4))
    state = scene.state
    X = on_base([state.base, state.base + [0.0, 0.1, 0.0]], state.q)
    before = KeptMotions()
    before.keep("drive", "a motion", scene, [WholeBodyPath(X, 0.0)])
    assert before.find("drive", str, CollisionWorld.from_scene(scene)) is None, "a first solve uses nothing of its own"
    kept = before.for_next_scene()
    far, near = (
        moved(scene, "object_00", 0.0, 0.05),
        scene.with_body(scene.body("object_00").at([*state.base[:2], 0.2])),
    )
    assert kept.find("drive", str, CollisionWorld.from_scene(far)) == "a motion"
    assert kept.find("drive", str, CollisionWorld.from_scene(near)) is None
    assert kept.find("drive", int, CollisionWorld.from_scene(far)) is None
    assert kept.for_next_scene().find("drive", str, CollisionWorld.from_scene(far)) == "a motion", "what was used again"
    assert isinstance(PLANNER.problem(scene, "object_00"), Problem)


def test_what_has_sunk_into_furniture_that_is_no_support_is_taken_all_the_same() -> None:
    sunk = cylinder("can", 0.0, 0.0)
    x, y = sunk.position[:2]
    mat = StaticObstacle("mat", np.array((x, y, sunk.bottom - 0.007)), np.array((0.06, 0.06, 0.01)))
    scene = table_scene(sunk)
    found = PLANNER.solve(replace(scene, static_obstacles=(*scene.static_obstacles, mat)), "can")
    assert isinstance(found, Solution), found


CLOSER = [(20, 5, "object_05"), (15, 4, "object_11"), (15, 4, "object_01")]
"""Random scenes and targets that take fewer picks from base poses that are not among the first that are sampled."""


@pytest.mark.parametrize(("objects", "seed", "target"), CLOSER)
def test_a_plan_that_more_base_poses_make_shorter_is_found_and_the_bound_says_so(
    objects: int, seed: int, target: str
) -> None:
    scene = random_scene(objects, seed)
    problem = PLANNER.problem(scene, target)
    first, bound, plan = problem.first_bound(), problem.lower_bound(), PLANNER.solve_problem(problem)
    assert isinstance(plan, Solution)
    assert first.picks is not None
    assert bound.picks is not None
    assert bound.picks < first.picks, "else this scene shows nothing"
    assert plan.picks == bound.picks == PLANNER.lower_bound(scene, target).picks
    assert bound.picks == (PLANNER.clearance_floor(scene, target).count or 0) + 1
    assert plan.bound == bound


def test_an_object_in_the_hand_is_no_pick_that_ends_the_closer_look() -> None:
    # One pick for each object that must move: the one in the hand needs none, so another one may be left out.
    scene = random_scene(15, 4)
    objects = (*(one for one in scene.objects if one.name != "object_09"), cylinder("held", -0.25, 0.62))
    scene = replace(scene, objects=objects, supports=("table_top", "counter_left"))
    taken = PLANNER.solve(scene, "held")
    assert isinstance(taken, Solution)
    assert taken.end is not None
    goal = on("held", "counter_left") & holding("object_11")
    problem = PLANNER.problem(taken.end, goal)
    first, bound, plan = problem.first_bound(), problem.lower_bound(), PLANNER.solve_problem(problem)
    assert isinstance(plan, Solution)
    assert first.picks == 2, "else this scene shows nothing"
    assert plan.picks == bound.picks == 1


def test_looking_closely_never_makes_a_bound_higher_nor_a_plan_longer() -> None:
    for name in SCENE.names:
        problem = PLANNER.problem(SCENE, name)
        first, bound = problem.first_bound(), problem.lower_bound()
        assert first.picks is None or (bound.picks is not None and bound.picks <= first.picks)
        assert bound.picks is None or bound.least <= bound.picks


@pytest.mark.parametrize(("objects", "seed"), [(25, 3), (20, 5)])
def test_a_bound_that_only_looks_for_fewer_picks_is_that_of_all_grasps(objects: int, seed: int) -> None:
    scene = random_scene(objects, seed)
    for name in scene.names[:12]:
        problem = PLANNER.problem(scene, name)
        bound, every = problem.lower_bound(), PLANNER.problem(scene, name).closer.first_bound()
        assert (bound.picks, bound.least, bound.proved) == (every.picks, every.least, every.proved)


@dataclass(frozen=True)
class OverOnceAsked(Deadline):
    """A deadline that is over once the first attempt has ended."""

    ended: list[object] = field(default_factory=list)

    @property
    def is_over(self) -> bool:
        return bool(self.ended)


def late_answer(monkeypatch: pytest.MonkeyPatch, problem: Problem) -> Solution | Infeasible:
    """The answer if the time is up after the first attempt, before the closer look."""
    deadline = OverOnceAsked()

    def first_attempt(search: Search) -> Solution | Infeasible:
        found = task_and_motion_plan(search)
        deadline.ended.append(found)
        return found

    monkeypatch.setattr(attempts, "task_and_motion_plan", first_attempt)
    rng = np.random.default_rng(0)
    found = attempts.best_of_attempts(problem, STRATEGIES["lookahead"], task_planner(None), rng, deadline)
    assert len(deadline.ended) == 1
    return found


@pytest.mark.parametrize(("objects", "seed", "target"), CLOSER)
def test_a_bound_without_the_closer_look_for_want_of_time_is_not_said_to_be_proved(
    monkeypatch: pytest.MonkeyPatch, objects: int, seed: int, target: str
) -> None:
    scene = random_scene(objects, seed)
    bound = PLANNER.lower_bound(scene, target)
    plan = late_answer(monkeypatch, PLANNER.problem(scene, target))
    assert isinstance(plan, Solution)
    assert plan.bound is not None
    assert bound.picks is not None
    assert plan.picks > bound.picks, "else this scene shows nothing"
    assert plan.bound.least <= bound.picks
    assert not plan.bound.proved


def test_a_refusal_without_the_closer_look_for_want_of_time_is_the_time_limits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In this scene all grasps from the first base poses block each other. From others, one clearance is enough."""
    scene, target = random_scene(38, 2), "object_25"
    problem = PLANNER.problem(scene, target)
    assert problem.first_bound().cause is Cause.NO_SELF_CLEARABLE_SET, "else this scene shows nothing"
    plan = PLANNER.solve(scene, target)
    assert isinstance(plan, Solution)
    assert plan.picks == 2
    refusal = late_answer(monkeypatch, problem)
    assert isinstance(refusal, Infeasible)
    assert refusal.cause is Cause.TIME_LIMIT
    assert "no self-clearable set" in refusal.detail


def test_a_refusal_for_want_of_grasps_does_not_stand_beside_a_bound_that_has_some(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def no_motion_from_many(search: Search) -> Solution | Infeasible:
        found = task_and_motion_plan(search)
        return found if isinstance(found, Infeasible) else search.infeasible(Cause.MOTION, "none", ())

    monkeypatch.setattr(attempts, "task_and_motion_plan", no_motion_from_many)
    problem = PLANNER.problem(random_scene(38, 2), "object_25")
    refusal = PLANNER.solve_problem(problem)
    assert isinstance(refusal, Infeasible)
    assert problem.lower_bound().picks is not None
    assert refusal.cause is Cause.MOTION


def test_a_grasp_that_many_base_poses_find_but_no_motion_reaches_leaves_the_first_plan() -> None:
    # 20 objects, seed 5: the bound of object_03 is one pick, and no motion leads to that grasp.
    problem = PLANNER.problem(random_scene(20, 5), "object_03")
    first, bound, plan = problem.first_bound(), problem.lower_bound(), PLANNER.solve_problem(problem)
    assert isinstance(plan, Solution)
    assert (bound.picks, plan.picks) == (1, first.picks)
    assert plan.bound is not None
    assert plan.bound.least == 1


def test_canonical_plans_are_those_of_the_first_base_poses() -> None:
    planner = replace(PLANNER, canonical=True)
    plans = [planner.solve(random_scene(20, 5), "object_05", rng=seed) for seed in (0, 1)]
    assert isinstance(plans[0], Solution)
    assert isinstance(plans[1], Solution)
    assert same_motions(plans[0], plans[1])
    assert plans[0].bound is not None
    assert plans[0].bound.least <= plans[0].picks


@pytest.mark.parametrize("strategy", ["ngr", "dogar", "srivastava"])
def test_strategies_of_the_papers_look_closely_where_they_find_no_grasps(strategy: str) -> None:
    plan = PLANNER.solve(random_scene(38, 2), "object_25", strategy)
    assert isinstance(plan, Solution)
    assert plan.bound is None
