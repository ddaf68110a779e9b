"""Open-v0, and the layouts that open: what is clean, what is not, and that it is all a function of the seed."""

from __future__ import annotations

import pickle
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import pytest

import clutter_env
from clutter_env.envs.goal import ReachEnv
from clutter_env.envs.opening import OpenEnv
from clutter_env.envs.rearrange import RearrangeEnv
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.envs.reward import MOST
from clutter_env.envs.success import HOLD_STEPS, OPENED_SHARE
from clutter_env.errors import ConfigError, OptionError
from clutter_env.scene.layout import LAYOUTS, Layout, openings_of
from clutter_env.scene.opening import DAMPING_RANGE, FRICTION_RANGE
from planners import ExpertConfig, TampExpert
from tests.clutter_env.envs.opener import Opener, opener
from tests.clutter_env.envs.side_grasp import CLOSED, OPEN

OPENING = tuple(name for name, layout in LAYOUTS.items() if layout.opens in OpenEnv.opens)
ID = "clutter_env/Open-v0"


def put_open(env: Any, share: float) -> None:
    """Put what opens there, with what stands in it, everything awake."""
    world = env.world
    (shift,) = world.drawer_shifts or [0.0]
    inside = world.are_in_drawer(env.measurements)
    env.data.qpos[world.index.opening_qpos[0]] = share * world.opening.travel
    env.data.qpos[world.index.object_qpos].reshape(-1, 7)[inside, 0] += sum(world.drawer_shifts) - shift
    wake(env)


def wake(env: Any) -> None:
    """Wake everything, as setting a state does."""
    mujoco.mj_setState(env.model, env.data, env.data.qpos.copy(), mujoco.mjtState.mjSTATE_QPOS)
    mujoco.mj_forward(env.model, env.data)


def idle(env: Any, steps: int) -> dict:
    """The info after some steps in which the robot stands still."""
    for _ in range(steps):
        info = env.step(env._still_action())[4]
    return info


def free_of_the_way(layout: str, seed: int = 0) -> dict[str, Any]:
    """Options of a reset: in the way of a drawer stands nothing; none where nothing can."""
    if not LAYOUTS[layout].front:
        return {}
    env = OpenEnv(layout=layout, num_objects=4)
    env.reset(seed=seed)
    scene = env.world.scene
    rows = zip(scene.half_extents, scene.positions, scene.levels, strict=True)
    inside = [(half, place) for half, place, level in rows if level > 0]
    return {
        "objects": [
            {"radius": float(half[0]), "height": float(2 * half[2]), "position": tuple(place)} for half, place in inside
        ]
    }


@pytest.mark.parametrize("layout", OPENING)
def test_an_honest_pull_is_a_clean_success(layout: str) -> None:
    robot = Opener(OpenEnv(layout=layout, num_objects=4, control_mode="ee"), 0, **free_of_the_way(layout))
    info = robot.open_slowly()
    assert info["is_success"]
    assert info["num_opened"] == 1
    assert info["joint_positions"][f"{robot.opening.name}_joint"] > OPENED_SHARE * robot.opening.travel
    assert (info["num_disturbed"], info["num_fallen"]) == (0, 0)
    assert info["total_path"] < 0.01, "what stands in a drawer rides in it"
    assert info["furniture_force"] < 5.0
    robot.leave()
    assert robot.env.world.opened > OPENED_SHARE, "it stays where it was left"


@pytest.mark.parametrize("robot", ["pr2", "panda_mobile"])
@pytest.mark.parametrize("layout", ["drawer", "cupboard"])
def test_other_robots_open_by_the_handle_too(layout: str, robot: str) -> None:
    found = opener(layout, robot=robot)
    found.standoff = 0.7
    assert found.open_slowly()["is_success"]


def test_it_counts_as_open_after_half_a_second_at_four_fifths() -> None:
    env = OpenEnv(layout="cupboard")
    env.reset(seed=0)
    put_open(env, OPENED_SHARE - 0.05)
    assert not idle(env, 2 * HOLD_STEPS)["lifted"]
    put_open(env, OPENED_SHARE + 0.05)
    assert not idle(env, HOLD_STEPS - 1)["lifted"]
    info = idle(env, 1)
    assert info["lifted"]
    assert info["is_success"]


def test_a_drawer_that_is_flung_open_topples_what_is_inside_and_is_no_success() -> None:
    env = OpenEnv(layout="drawer", num_objects=4)
    env.reset(seed=0)
    wake(env)
    env.data.qvel[env.world.index.opening_dof] = 4.0
    info = idle(env, 40)
    assert info["lifted"]
    assert info["num_fallen"] + info["num_disturbed"] > 0
    assert not info["is_success"]


def test_a_drawer_that_shoves_what_is_in_its_way_disturbs_it() -> None:
    robot = opener("blocked_drawer")
    outside = [slot for slot, level in enumerate(robot.env.world.scene.levels) if level == 0]
    assert outside
    put_open(robot.env, 0.02)
    robot.env.data.qvel[robot.env.world.index.opening_dof] = 0.6
    before = robot.env.measurements.poses.copy()
    for _ in range(60):
        robot.env.data.qvel[robot.env.world.index.opening_dof] = 0.25
        robot.step()
    assert np.linalg.norm(robot.env.measurements.poses[outside, :2] - before[outside, :2], axis=1).max() > 0.05
    assert robot.info["num_disturbed"] + robot.info["num_fallen"] > 0
    assert not robot.info["is_success"]


def test_fingers_pull_at_the_handle_as_they_like_and_press_on_the_front() -> None:
    robot = opener("drawer")
    robot.take_handle()
    robot.pull()
    robot.drive_to(robot.base - (0.05, 0.0, 0.0), speed=0.1)  # beyond the end of its range
    assert robot.info["furniture_force"] == 0.0
    robot = opener("drawer")
    aside = robot.handle + (0.0, 0.2, 0.0)
    robot.drive_to(np.array([robot.base[0], aside[1], 0.0]))
    robot.drive_to(np.array([aside[0] - robot.standoff, aside[1], 0.0]))
    robot.width = CLOSED
    robot.reach(aside - (0.1, 0.0, 0.0))
    robot.reach(aside + (0.06, 0.0, 0.0))
    assert robot.info["furniture_force"] > 50.0
    assert not robot.env.is_gentle


def test_only_fingers_may_touch_a_handle() -> None:
    env = OpenEnv(layout="cupboard")
    env.reset(seed=0)
    model, reader = env.model, env.world._reader
    on_robot = [geom for geom in range(model.ngeom) if reader.is_robot(geom)]
    fingers = {model.geom(name).id for name in ("r_finger", "l_finger")}
    for part in ("door_handle", "door_post_0", "door_panel"):
        for geom in on_robot:
            is_free = geom in fingers and part != "door_panel"
            assert reader._sort([[geom, model.geom(part).id]]).presses_furniture != is_free


def test_a_door_that_is_knocked_open_is_pressed_on() -> None:
    """Ajar, it is in the way of the robot, which drives on at full speed."""
    env = OpenEnv(layout="cupboard")
    env.reset(seed=0)
    put_open(env, 0.5)
    q = env.data.qpos[env.world.index.drive_qpos].copy()
    q[:3] = -0.55, -1.3, np.pi / 2
    env.data.qpos[env.world.index.drive_qpos] = q
    env.world.controller.reset(env.data)
    wake(env)
    for _ in range(40):
        q[1] += 0.05
        info = env.step(env.joint_action(q, OPEN))[4]
    assert env.world.opened > OPENED_SHARE
    assert not env.is_gentle
    assert not info["is_success"]


@pytest.mark.parametrize("layout", OPENING)
def test_an_episode_follows_from_its_seed_and_goes_on_from_a_saved_state(layout: str) -> None:
    one, other = (OpenEnv(layout=layout, reward_mode="dense", control_mode="ee") for _ in range(2))
    other.reset(seed=5)
    idle(other, 3)
    records = []
    for env in (one, other):
        observation, info = env.reset(seed=2)
        assert observation in env.observation_space
        assert info["num_opened"] == 0
        put_open(env, 0.3)
        env.action_space.seed(0)
        records.append([env.step(env.action_space.sample()) for _ in range(8)])
    for mine, theirs in zip(*records, strict=True):
        assert all(np.array_equal(mine[0][name], theirs[0][name]) for name in mine[0])
        assert (mine[1], mine[4]) == (theirs[1], theirs[4])
    copy = pickle.loads(pickle.dumps(one))
    third = OpenEnv(layout=layout, reward_mode="dense", control_mode="ee")
    third.reset(options={"state": one.save_state()})
    action = one.action_space.sample()
    after = [env.step(action) for env in (one, third, copy)]
    for step in after[1:]:
        assert all(np.array_equal(step[0][name], after[0][0][name]) for name in step[0])
        assert (step[1], step[4]) == (after[0][1], after[0][4])
    assert third.save_state() == one.save_state()


@pytest.mark.parametrize("layout", OPENING)
def test_friction_and_damping_are_those_of_the_episode(layout: str) -> None:
    env = RetrieveEnv(layout=layout, num_objects=3)
    seen = set()
    for seed in range(6):
        env.reset(seed=seed)
        dof = env.world.index.opening_dof
        friction, damping = float(env.model.dof_frictionloss[dof][0]), float(env.model.dof_damping[dof][0])
        assert FRICTION_RANGE[0] <= friction <= FRICTION_RANGE[1]
        assert DAMPING_RANGE[0] <= damping <= DAMPING_RANGE[1]
        seen.add((friction, damping))
    assert len(seen) == 6


@pytest.mark.parametrize("layout", OPENING)
@pytest.mark.parametrize("robot", ["fetch", "pr2", "panda_mobile"])
def test_the_target_is_inside_and_the_robot_starts_clear_of_all(layout: str, robot: str) -> None:
    env = RetrieveEnv(layout=layout, num_objects=4, robot=robot)
    outside = 0
    for seed in range(12):
        env.reset(seed=seed)
        scene = env.world.scene
        assert env.data.ncon == 0
        if LAYOUTS[layout].opens == "drawer":
            inside = env.world.are_in_drawer(env.measurements)
            assert inside[scene.target]
            assert np.array_equal(inside, scene.levels > 0)
            outside += np.count_nonzero(~inside)
        top = np.array([env.world.lowest_point(env.measurements, slot) for slot in range(4)])
        assert np.allclose(top, 0.75 + scene.levels, atol=1e-5)
    assert (12 <= outside <= 24) == (layout == "blocked_drawer")


def test_what_is_taken_out_of_an_open_drawer_is_a_success_by_the_normal_rule() -> None:
    planners = pytest.importorskip("planners")
    env = RetrieveEnv(layout="drawer", num_objects=3)
    env.reset(seed=1)
    put_open(env, 0.97)
    idle(env, 10)
    expert = planners.TampExpert(env)
    expert.reset()
    while not expert.done:
        info = env.step(expert.act())[4]
    assert info["is_success"]
    assert info["num_opened"] == 1


def test_the_observation_says_where_joint_and_handle_are() -> None:
    env = gym.make(ID, layout="drawer")
    observation, _ = env.reset(seed=3)
    inner: Any = env.unwrapped
    place = inner.observation_layout["joints"]
    assert observation["joints"][place["position"]] == 0.0
    x, y, yaw = inner.data.qpos[inner.world.index.drive_qpos[:3]]
    dx, dy, z = inner.data.geom("drawer_handle").xpos - (x, y, 0.0)
    ahead, left = np.cos(yaw) * dx + np.sin(yaw) * dy, np.cos(yaw) * dy - np.sin(yaw) * dx
    assert observation["joints"][place["handle"]] == pytest.approx([ahead, left, z], abs=1e-5)
    put_open(inner, 0.5)
    idle(inner, 1)
    assert inner._observe()["joints"][place["opened"]] == pytest.approx(0.5, abs=1e-3)


def test_the_potential_rises_with_what_is_open_and_stays_in_its_bounds() -> None:
    env = OpenEnv(layout="fridge", reward_mode="dense")
    env.reset(seed=0)
    values = []
    for share in (0.0, 0.3, 0.6, 0.9):
        put_open(env, share)
        idle(env, 1)
        values.append(env._potential_now())
    assert values == sorted(values)
    assert values[0] >= 0.0
    assert values[-1] <= MOST
    retrieve = RetrieveEnv(layout="drawer", num_objects=3, reward_mode="dense")
    retrieve.reset(seed=0)
    shut = retrieve._potential_now()
    put_open(retrieve, 1.0)
    idle(retrieve, 1)
    assert retrieve._potential_now() > shut


def test_the_goal_is_that_of_the_planner() -> None:
    from planners import goals

    env = OpenEnv(layout="fridge")
    env.reset(seed=0)
    assert env.goal == goals.open_("door")


def test_what_does_not_open_and_what_cannot_be_done_is_refused() -> None:
    with pytest.raises(ConfigError, match="valid names: drawer, cupboard, fridge, blocked_drawer"):
        OpenEnv(layout="paper")
    with pytest.raises(ConfigError, match="obstructed"):
        OpenEnv(obstructed=True)
    with pytest.raises(ConfigError, match="base"):
        OpenEnv(base="fixed")
    with pytest.raises(ConfigError, match="shut at the start"):
        RetrieveEnv(num_objects=5, layout="drawer", obstructed=True)
    for make in (ReachEnv, lambda **words: RearrangeEnv(num_objects=4, task="swap", **words)):
        with pytest.raises(ConfigError, match="not one for this environment"):
            make(layout="drawer")
    with pytest.raises(OptionError, match="known options: objects, state"):
        OpenEnv().reset(options={"target": "object_00"})
    with pytest.raises(ConfigError, match="at most 0 fit"):
        RetrieveEnv(num_objects=1, layout="drawer", object_set="household")


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"opens": "lid"}, "opens='lid'"),
        ({"opens": "drawer", "board_height": 0.4}, "does not go with opens='drawer'"),
        ({"opens": "door_left"}, "needs a board_height"),
        ({"opens": "drawer", "front": 0.3}, "leaves less than"),
        ({"front": 0.3}, "needs opens='drawer'"),
        ({"opens": "drawer", "supports": ("table_top",)}, "chosen by the layout"),
        ({"board_height": 0.3, "third_board_height": 0.3}, "needs a second_board_height"),
    ],
)
def test_layouts_that_contradict_themselves_are_refused(fields: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Layout("own", depth=0.5, width=0.6, **fields)


def test_a_drawer_of_the_user_s_own_opens() -> None:
    own = Layout("own", depth=0.5, width=0.8, is_front_only=False, opens="drawer")
    robot = opener("drawer")
    mine = Opener(OpenEnv(layout=own, num_objects=3, control_mode="ee"))
    assert mine.open_slowly()["is_success"]
    assert openings_of(own) != openings_of(robot.env.layout)


def test_rearrange_works_behind_a_door() -> None:
    env = RearrangeEnv(num_objects=4, task="swap", layout="cupboard")
    _, info = env.reset(seed=0)
    assert info["num_opened"] == 0
    assert info["unmet"] > 0


@pytest.mark.slow
def test_the_expert_opens_the_door_behind_which_it_rearranges() -> None:
    env = RearrangeEnv(num_objects=4, task="swap", layout="cupboard")
    env.reset(seed=3)
    expert = TampExpert(env, config=ExpertConfig(planning_s=300.0))
    expert.reset()
    for _ in range(4000):
        *_, terminated, truncated, info = env.step(expert.act())
        if terminated or truncated or expert.done:
            break
    assert info["is_success"]
    assert info["num_opened"] == 1
    assert info["joint_positions"]["door_joint"] > 1.0


def test_the_environment_is_registered_with_its_time_limit() -> None:
    assert gym.spec(ID).max_episode_steps == clutter_env.OPEN_TIME_LIMIT


def test_of_several_drawers_each_takes_along_what_is_in_it() -> None:
    env = RetrieveEnv(num_objects=6, layout="drawers")
    env.reset(seed=0)
    world, before = env.world, env.measurements
    slots = [np.flatnonzero(world.are_in_drawer(before, number)) for number in range(3)]
    assert sorted(np.concatenate(slots).tolist()) == list(range(6))
    for number, shift in ((0, 0.2), (2, 0.1)):
        env.data.qpos[world.index.opening_qpos[number]] = shift
        env.data.qpos[world.index.object_qpos].reshape(-1, 7)[slots[number], 0] -= shift
    wake(env)
    env._monitor.update(world.measure())
    assert env._monitor.total_path == 0.0
    assert world.opened_shares == pytest.approx([0.2 / 0.3, 0.0, 0.1 / 0.3])
    for number, share in enumerate(world.opened_shares):
        assert world.opened_around(world.measure(), int(slots[number][0])) == share
