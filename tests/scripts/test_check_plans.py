"""The replay of plans finds what penetrates, whatever the planner says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from assets.robots import FETCH
from clutter_env.envs.rearrange import RearrangeEnv
from clutter_env.envs.retrieve import RetrieveEnv
from planners import Scene, Solution, solve
from planners.motion.arm import tcp_pose
from planners.motion.trajectory import Phase, Trajectory
from planners.scene import Body, RobotState
from planners.tamp.solution import BoundAction
from scripts.check_plans import TOLERANCE, Arguments, PlanReplay, end_problem, main

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def planned() -> tuple[Scene, Solution]:
    env = RetrieveEnv(num_objects=15, obstructed=True)
    _, info = env.reset(seed=400_000)
    scene = Scene.from_mujoco(env.model, env.data, env.robot)
    plan = solve(scene, info["target"], grasps="side")
    env.close()
    assert isinstance(plan, Solution)
    assert plan.clearances
    return scene, plan


def with_pin(scene: Scene, position: np.ndarray) -> Scene:
    """The scene with one more object, of which the planner knew nothing: a thin cylinder."""
    pin = Body("pin", "cylinder", np.array([0.005, 0.005, 0.01]), position, UPRIGHT)
    return replace(scene, objects=(*scene.objects, pin))


def test_a_plan_penetrates_nothing(planned: tuple[Scene, Solution]) -> None:
    scene, plan = planned
    assert PlanReplay(scene).deepest_contact(plan.actions).depth < TOLERANCE


@pytest.mark.slow
def test_a_finger_does_not_graze_between_the_steps_of_the_planner() -> None:
    """In this cabinet a finger came 1.012 mm into the object that it was about to grasp."""
    env = RetrieveEnv(num_objects=16, layout="cabinet")
    _, info = env.reset(seed=400_004)
    scene = Scene.from_mujoco(env.model, env.data, env.robot)
    plan = solve(scene, info["target"], grasps="all")
    env.close()
    assert isinstance(plan, Solution)
    assert PlanReplay(scene).deepest_contact(plan.actions).depth < TOLERANCE


def test_an_object_in_the_way_of_the_gripper_is_found(planned: tuple[Scene, Solution]) -> None:
    scene, plan = planned
    trajectory = plan.actions[-1].trajectory
    approach = next(phase for phase in trajectory.phases if phase.name == "approach")
    sample = trajectory.sample(approach.start)
    T_world_tcp = tcp_pose(FETCH, RobotState(sample.base, sample.q, sample.finger_position))
    found = PlanReplay(with_pin(scene, (T_world_tcp @ [-0.06, 0.0, 0.0, 1.0])[:3])).deepest_contact(plan.actions)
    assert found.depth > 0.005
    assert "pin" in found.geoms


def test_fingers_that_press_on_an_object_are_beside_it(planned: tuple[Scene, Solution]) -> None:
    """Their command is to close, but the object is between them."""
    scene, plan = planned
    last = plan.actions[-1].trajectory
    phase, end = last.phases[-1], last.states[-1]
    assert phase.touched is not None
    assert end[-1] == 0.0
    state = RobotState(end[:3], end[3:-1], 0.0)
    beside = scene.body(phase.held).half_width + FETCH.finger_thickness + 0.002
    pinned = with_pin(scene, (tcp_pose(FETCH, state) @ [0.0, beside, 0.0, 1.0])[:3])
    holding = pinned.with_state(state).with_held(phase.touched)
    still = Trajectory(
        last.times[:2], *(np.stack([x, x]) for x in (end[:3], end[3:-1])), np.zeros(2), (phase._replace(start=0.0),)
    )
    found = PlanReplay(holding).deepest_contact([BoundAction("wait", (), still, holding)])
    assert 0.001 < found.depth < 0.01
    assert "pin" in found.geoms
    assert any("finger" in geom for geom in found.geoms)


def test_what_is_held_goes_with_the_gripper_and_stays_where_it_is_put(planned: tuple[Scene, Solution]) -> None:
    """The pin stands inside the place where the cleared object is put down."""
    scene, plan = planned
    put = next(action for action in plan.actions if action.is_put_down)
    assert put.released is not None
    found = PlanReplay(with_pin(scene, put.released.position)).deepest_contact(plan.actions)
    assert set(found.geoms) == {"pin", put.target}
    replay = PlanReplay(scene)
    replay.deepest_contact(plan.actions)
    assert np.abs(replay.position(put.target) - put.released.position).max() < 1e-6


def test_the_robot_may_not_penetrate_itself(planned: tuple[Scene, Solution]) -> None:
    scene, _ = planned
    inside = np.array(FETCH.home)
    inside[[1, 2, 4]] = 0.0, 1.5, 2.2
    rows = np.vstack([FETCH.home, inside])
    far = np.tile([-3.0, 0.0, 0.0], (2, 1))
    trajectory = Trajectory(np.array([0.0, 1.0]), far, rows, np.zeros(2), (Phase("fold", 0.0),))
    found = PlanReplay(scene).deepest_contact([BoundAction("MoveBase", (), trajectory, scene)])
    assert found.depth > 0.01
    assert found.phase == "fold"
    assert not set(found.geoms) & {"floor", *scene.names}


def test_the_command_counts_plans(capsys: pytest.CaptureFixture[str]) -> None:
    main(Arguments(objects=2, plans=1))
    assert "retrieval, paper, fetch, 2 objects, side: 1 plans" in capsys.readouterr().out


@pytest.fixture(scope="module")
def swapped() -> tuple[RearrangeEnv, Solution]:
    env = RearrangeEnv(num_objects=2, task="swap")
    env.reset(seed=821_000)
    plan = solve(Scene.from_mujoco(env.model, env.data, env.robot, regions=env.regions), env.goal)
    assert isinstance(plan, Solution)
    return env, plan


@pytest.mark.parametrize("left_out", [0, 1, 4])
def test_a_plan_that_ends_too_early_does_not_reach_its_goal(
    swapped: tuple[RearrangeEnv, Solution], left_out: int
) -> None:
    env, plan = swapped
    env.reset(seed=821_000)
    replay = PlanReplay(Scene.from_mujoco(env.model, env.data, env.robot))
    replay.deepest_contact(plan.actions[: len(plan.actions) - left_out])
    assert bool(end_problem(env, plan, replay)) == bool(left_out)


def test_what_a_plan_lets_float_falls_and_what_moves_by_itself_is_noticed(planned: tuple[Scene, Solution]) -> None:
    scene, plan = planned
    env = RetrieveEnv(num_objects=15, obstructed=True)
    env.reset(seed=400_000)
    other = next(body for body in scene.objects if body.name not in (plan.target, *plan.clearances))
    replay = PlanReplay(scene.with_body(other.at(other.position + [0.0, 0.0, 0.05])))
    assert replay.farthest_from(scene) == pytest.approx(0.05)
    assert "is raised by 0 mm" in end_problem(env, plan, replay)
    replay.deepest_contact(plan.actions)
    assert f"{other.name} slides or falls" in end_problem(env, plan, replay)
