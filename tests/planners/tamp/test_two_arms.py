"""PR2 with both arms: grasps, floors and plans of either arm, an obstacle held aside, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import clutter_env  # noqa: F401  registers the environments
from assets.robots import FETCH, PR2, InvalidRobot
from planners import ArmsError, ExpertConfig, ExpertError, Planner, Solution, TampExpert, execute, goals
from planners.clearing.moves import MoveMaker
from planners.collision.hit_kernels import place_along
from planners.collision.world import CollisionWorld
from planners.drawing.page.page import plan_recording
from planners.goals import Goal
from planners.grasping.candidates import GraspCandidates
from planners.motion.arm import tcp_pose
from planners.motion.contact_free import merge_phases
from planners.motion.mujoco_check import MujocoCollisionChecker
from planners.motion.trajectory import CONTROL_STEP
from planners.scene import HeldObject, RobotState, Scene
from planners.tamp import motion_layer
from planners.workspace import Workspace
from tests.planners.plans import assert_free, play
from tests.planners.scenes import random_scene

BOTH = PR2.with_all_arms()


def scene_of(seed: int) -> tuple[Scene, str]:
    """A scene of 15 objects with PR2 and its two arms, and the target."""
    env = gym.make("clutter_env/Retrieve-o15-v0", robot="pr2").unwrapped
    _, info = env.reset(seed=seed)
    return Scene.from_mujoco(env.model, env.data, BOTH), info["target"]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scene_of(1)[0]


def held_by(scene: Scene, arm: str, T_tcp_object: np.ndarray | None = None) -> Scene:
    """The scene with the first object in the gripper of an arm, at home."""
    return scene.using(arm).with_held(HeldObject(scene.names[0], np.eye(4) if T_tcp_object is None else T_tcp_object))


def test_only_a_robot_with_several_arms_can_act_with_all() -> None:
    assert PR2.acting_arms == ("right",)
    assert BOTH.acting_arms == ("right", "left")
    assert BOTH.using("left").acting_arms == ("left", "right")
    with pytest.raises(InvalidRobot, match="several arms; fetch has one"):
        FETCH.with_all_arms()
    with pytest.raises(InvalidRobot, match="'left', 'right'"):
        BOTH.using("middle")


def test_what_does_not_fit_the_arms_is_refused_by_name() -> None:
    with pytest.raises(ArmsError, match="one arm; valid value: hold_aside=False"):
        Planner(FETCH, hold_aside=True)
    with pytest.raises(ArmsError, match="with_all_arms"):
        Planner(PR2, hold_aside=True)
    with pytest.raises(ArmsError, match="valid values: False, True"):
        Planner(BOTH, hold_aside="left")  # type: ignore[arg-type]  # on purpose
    with pytest.raises(ArmsError, match=r"canonical plans .* 'right', 'left'"):
        Planner(BOTH, canonical=True)
    with pytest.raises(ExpertError, match="True, False or None"):
        ExpertConfig(hold_aside="left")  # type: ignore[arg-type]  # on purpose
    env = gym.make("clutter_env/Retrieve-o5-v0")
    with pytest.raises(ArmsError, match="'fetch' does not"):
        TampExpert(env, config=ExpertConfig(hold_aside=True))


def test_an_object_held_aside_moves_to_the_other_gripper_and_back(scene: Scene) -> None:
    loaded = held_by(scene, "right")
    aside = loaded.using("left")
    assert aside.held is None
    assert aside.held_names == loaded.held_names == scene.names[:1]
    back = aside.holding(scene.names[0])
    assert back is not None
    assert back.robot.arm_name == "right"
    assert back.held is not None
    assert np.array_equal(back.held.T_tcp_object, loaded.held.T_tcp_object)
    assert aside.holding(scene.names[1]) is None


def test_an_object_held_aside_is_part_of_the_robot(scene: Scene) -> None:
    """It is where the other gripper is at home, it meets what stands there, and its own place is free."""
    loaded = held_by(scene, "right", np.array([[0, 1, 0, 0.02], [-1, 0, 0, 0.01], [0, 0, 1, 0.03], [0, 0, 0, 1.0]]))
    aside, name = loaded.using("left"), scene.names[0]
    world, empty = CollisionWorld.from_scene(aside), CollisionWorld.from_scene(scene.using("left"))
    base, home = np.array([-3.0, 0.4, 0.8]), np.array(aside.robot.home)
    position, rotation = place_along(world.query(0.05), np.append(base, home)[None])
    at_home = RobotState(base, np.array(loaded.robot.home), 0.0)
    pose = tcp_pose(loaded.robot, at_home) @ loaded.held.T_tcp_object  # type: ignore[union-attr]  # held_by fills it
    row = len(empty.robot.link)
    assert len(world.robot.link) == row + 1
    assert np.allclose(position[0, row], pose[:3, 3], atol=1e-9)
    assert np.allclose(rotation[0, row], pose[:3, :3], atol=1e-9)
    assert not world.hits(base, home, opening=0.05)
    other = scene.body(scene.names[1])
    below = pose[:3, 3] - (0.0, 0.0, scene.body(name).half_extents[2] + other.half_extents[2] - 0.005)
    standing = other.at(below, (1.0, 0.0, 0.0, 0.0))
    assert world.with_body(standing).hits(base, home, opening=0.05) >> 1 & 1
    assert not world.active() >> np.uint64(scene.index(name)) & np.uint64(1)


def test_mujoco_sees_the_object_held_aside(scene: Scene) -> None:
    """Where the kernel finds the arm against the object in the other gripper, MuJoCo finds it too."""
    aside = held_by(scene, "right").using("left")
    world, checker = CollisionWorld.from_scene(aside, padding=0.0), MujocoCollisionChecker(aside)
    base, rng = np.array([-3.0, 0.0, 0.0]), np.random.default_rng(0)
    home, checked = np.array(aside.robot.home), {False: 0, True: 0}
    for _ in range(60):
        q = home.copy()
        q[1:4] += rng.uniform((-1.2, -0.3, -0.8), (0.1, 0.3, 0.8))
        is_hit = bool(world.hits(base, q, 0.05))
        depth = checker.deepest_penetration(_Pose(np.concatenate((base, q))[None])).penetration
        if depth > 0.002 or not is_hit:
            assert is_hit == (depth > 0.0)
            checked[is_hit] += 1
    assert min(checked.values()) >= 5


class _Pose:
    """One configuration as a motion, nothing in the active gripper."""

    opening, held, ignore = 0.05, None, 0

    def __init__(self, configurations: np.ndarray) -> None:
        self.configurations = configurations


def test_both_arms_offer_grasps_fewest_blockers_first(scene: Scene) -> None:
    together = Workspace.of(scene.robot, scene, grasps="side").grasps()
    by_arm = {arm: GraspCandidates({arm: together.arms[arm]}) for arm in BOTH.acting_arms}
    for name in scene.names[:5]:
        found = together.for_object(scene, name)
        assert {grasp.key for grasp in found} == {
            grasp.key for arm, source in by_arm.items() for grasp in source.for_object(scene.using(arm), name)
        }
        counts = [grasp.blockers.bit_count() for grasp in found]
        assert counts == sorted(counts)
        for grasp in found:
            world = CollisionWorld.from_scene(scene.using(grasp.arm))
            assert world.hits(grasp.base, grasp.q, grasp.opening, ignore=scene.mask([name])) == grasp.blockers
    assert {grasp.arm for name in scene.names for grasp in together.for_object(scene, name)} == {"left", "right"}
    banned = together.for_object(scene, scene.names[0])[0]
    together.ban(scene, banned)
    assert banned.key not in {grasp.key for grasp in together.for_object(scene, scene.names[0])}


@pytest.mark.slow
def test_two_arms_never_have_a_higher_lower_bound_than_one() -> None:
    scene, target = scene_of(100_003)
    two = Planner(BOTH, grasps="side").clearance_floor(scene, target).count
    for arm in BOTH.acting_arms:
        alone = replace(scene.using(arm), robot=PR2.using(arm))
        one = Planner(PR2.using(arm), grasps="side").clearance_floor(alone, target).count
        assert two is not None
        assert one is None or two <= one


@pytest.mark.slow
def test_a_plan_of_two_arms_is_saved_and_drawn(tmp_path: Path) -> None:
    scene, target = scene_of(100_016)
    plan = Planner(BOTH, grasps="side", hold_aside=True).solve(scene, target)
    assert isinstance(plan, Solution)
    assert plan.actions[-1].scene.aside
    plan.save(tmp_path / "plan.npz")
    assert Solution.load(tmp_path / "plan.npz") == plan
    plan.to_html(tmp_path / "plan.html")
    frames, last = plan_recording(plan).frames, plan.actions[-1]
    (one,) = last.scene.aside
    arm = last.scene.using(one.arm)
    expected = tcp_pose(arm.robot, RobotState(last.trajectory.base[-1], arm.state.q, 0.0)) @ one.held.T_tcp_object
    column = -7 * (len(scene.names) - scene.index(one.held.name))
    assert np.allclose(frames[-1].qpos[column : column + 3], expected[:3, 3], atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("strategy", ["ngr", "dogar", "srivastava"])
def test_greedy_strategies_plan_with_two_arms(strategy: str) -> None:
    scene, target = scene_of(100_016)
    plan = Planner(BOTH, grasps="side", hold_aside=True).solve(scene, target, strategy)
    assert isinstance(plan, Solution)
    assert plan.clearances, "they do not plan ahead, so nothing is held aside"


@pytest.mark.slow
@pytest.mark.parametrize("hold_aside", [False, True])
def test_plans_of_two_arms_are_free_of_penetration_in_mujoco(hold_aside: bool) -> None:
    arms = set()
    for seed in (100_000, 100_016):
        scene, target = scene_of(seed)
        found = Planner(BOTH, grasps="side", hold_aside=hold_aside).solve(scene, target)
        assert isinstance(found, Solution), found
        arms |= {action.scene.robot.arm_name for action in found.actions}
        assert_free(found)
        assert_continuous(found)
        assert_turns_slowly(found)
        last = found.actions[-1]
        assert last.target == target
        assert hold_aside or not last.scene.aside
    assert arms == {"left", "right"}


def sort_scene(seed: int) -> tuple[Scene, Goal]:
    """Eight objects to sort with PR2 and its two arms, and the goal."""
    env = gym.make("clutter_env/Rearrange-o8-v0", task="sort", robot=BOTH).unwrapped
    env.reset(seed=seed)
    return Scene.from_mujoco(env.model, env.data, BOTH, regions=env.regions), env.goal


@pytest.mark.slow
def test_the_same_moves_take_less_time_if_motions_are_merged_thoroughly(monkeypatch: pytest.MonkeyPatch) -> None:
    """The moves are those that are chosen without a comparison by time, so that only the motions differ."""
    scene, goal = sort_scene(200_000)
    monkeypatch.setattr(MoveMaker, "put", lambda self, *arguments: next(self._puts(*arguments), None))
    thorough = Planner(BOTH).solve(scene, goal)
    monkeypatch.setattr(motion_layer, "merge_phases", lambda *arguments: merge_phases(*arguments[:4]))
    plain = Planner(BOTH).solve(scene, goal)
    assert isinstance(thorough, Solution)
    assert isinstance(plain, Solution)
    assert [str(action) for action in thorough.actions] == [str(action) for action in plain.actions]
    assert thorough.duration < 0.85 * plain.duration
    assert_free(thorough)
    assert_continuous(thorough)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [200_000, 200_004])
def test_objects_that_change_places_are_picked_once_in_physics(seed: int) -> None:
    """One of them stays in a hand while the other hand moves the others; nothing is put aside."""
    env = gym.make("clutter_env/Rearrange-o4-v0", task="swap", robot=BOTH)
    env.reset(seed=seed)
    expert = TampExpert(env)
    expert.reset()
    solution = expert.solution
    assert isinstance(solution, Solution), solution
    assert solution.bound is not None
    assert solution.bound.proved
    assert solution.picks == solution.bound.picks == len(solution.goal.placed)
    assert max(len(action.scene.held_names) for action in solution.actions) == 2
    assert_free(solution)
    assert_continuous(solution)
    assert_turns_slowly(solution)
    assert play(env, expert)["is_success"], expert.report
    assert expert.report.deviations == ()


def assert_turns_slowly(plan: Solution) -> None:
    """While an idle arm holds an object, the base turns no faster than a loaded robot may."""
    for action in plan.actions:
        if action.scene.aside:
            rates = np.abs(np.diff(action.trajectory.base[:, 2])) / CONTROL_STEP
            assert rates.max(initial=0.0) <= BOTH.max_loaded_yaw_rate, action


def assert_continuous(plan: Solution) -> None:
    """Base and each arm begin where they were left; idle arms rest at home."""
    base, left_at = plan.actions[0].trajectory.base[0], {}
    for action in plan.actions:
        robot, trajectory = action.scene.robot, action.trajectory
        assert np.allclose(trajectory.base[0], base, atol=1e-9)
        start = left_at.get(robot.arm_name, np.array(robot.home))
        assert np.allclose(trajectory.q[0], start, atol=1e-9)
        base, left_at[robot.arm_name] = trajectory.base[-1], trajectory.q[-1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hold_aside", "seed", "cleared", "arms"),
    [(False, 100_000, 2, {"left"}), (True, 100_016, 0, {"left", "right"})],
)
def test_an_episode_in_which_the_other_arm_acts_succeeds(
    hold_aside: bool, seed: int, cleared: int, arms: set[str]
) -> None:
    env = gym.make("clutter_env/Retrieve-o15-v0", robot=BOTH)
    _, info = env.reset(seed=seed)
    expert = TampExpert(env, grasps="side", config=ExpertConfig(with_floor=False, hold_aside=hold_aside))
    expert.reset(info["target"])
    solution = expert.solution
    assert isinstance(solution, Solution)
    assert len(solution.clearances) == cleared
    assert {action.scene.robot.arm_name for action in solution.actions if action.name != "MoveBase"} == arms
    if len(arms) > 1:
        with pytest.raises(ExpertError, match="several arms"):
            execute(solution, env.unwrapped.model, env.unwrapped.data)
    assert play(env, expert)["is_success"], expert.report
    held = env.unwrapped.measurements.grip.held
    assert sum(slot >= 0 for slot in held) == 1 + hold_aside


def exchanging(objects: int, seed: int, both: bool, one: str, other: str) -> tuple[Scene, goals.Goal]:
    """Two objects of a random scene that are to change places, exactly, for a PR2 with one arm or with both."""
    drawn, robot = random_scene(objects, seed), BOTH if both else PR2
    state = RobotState(drawn.state.base, np.array(robot.home), robot.max_finger_position)
    scene = replace(drawn, robot=robot, state=state, supports=("table_top", "counter_left", "counter_right"))
    ends = ((one, scene.body(other)), (other, scene.body(one)))
    return scene, goals.and_(*(goals.at(name, end.position[:2], 0.005) for name, end in ends))


@pytest.mark.parametrize(
    ("objects", "seed", "both", "picks"),
    [(5, 61005, True, 2), pytest.param(3, 61017, False, 4, marks=pytest.mark.slow)],
)
def test_no_hand_can_release_is_not_said_of_what_a_plan_releases(
    objects: int, seed: int, both: bool, picks: int
) -> None:
    """None of the few base poses for the place was free. A plan released the object from where it had taken it."""
    one, other = ("object_04", "object_02") if both else ("object_02", "object_01")
    scene, goal = exchanging(objects, seed, both, one, other)
    goal = goal if both else goal & goals.holding("object_00")
    planner = Planner(scene.robot, grasps="side")
    bound, plan = planner.lower_bound(scene, goal), planner.solve(scene, goal)
    assert isinstance(plan, Solution)
    assert plan.picks == picks
    assert bound.picks is not None
    assert bound.least <= picks


@pytest.mark.parametrize(
    ("objects", "seed", "both", "one", "other", "picks"),
    [
        (4, 61009, False, "object_00", "object_02", 3),
        (4, 61015, False, "object_00", "object_02", 3),
        (4, 61018, True, "object_02", "object_03", 2),
    ],
)
def test_what_many_base_poses_can_put_down_is_not_refused(
    objects: int, seed: int, both: bool, one: str, other: str, picks: int
) -> None:
    """From the few base poses that plans begin with, no hand releases one of the two objects at its place."""
    scene, goal = exchanging(objects, seed, both, one, other)
    planner = Planner(scene.robot, grasps="side")
    plan, bound = planner.solve(scene, goal), planner.lower_bound(scene, goal)
    assert isinstance(plan, Solution)
    assert plan.end is not None
    assert not goal.unmet(plan.end, scene)
    assert plan.picks == bound.picks == picks
