"""`Rearrange`: goals of the tasks, their judgement by geometry, options, reward, saved states."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import pytest

import clutter_env  # noqa: F401 - registers the environments
from clutter_env.envs.rearrange import GOAL_ROW, RearrangeEnv
from clutter_env.envs.rearrange_tasks import STACK, TASKS
from clutter_env.envs.reward import DISCOUNT, MOST
from clutter_env.envs.success import HOLD_STEPS
from clutter_env.errors import ConfigError, OptionError, StateError
from clutter_env.scene.layout import OBJECT_GAP, TABLE_HEIGHT
from planners import Planner, Scene, goals
from planners.goals import At, Region

REST = np.zeros(12, np.float32)
REST[-1] = 1.0
BOXES = [
    {"shape": "box", "depth": 0.05, "width": 0.05, "height": 0.06, "position": (0.0, y)} for y in (-0.3, -0.1, 0.1, 0.3)
]


def put(env: RearrangeEnv, name: str, x: float, y: float, level: float) -> None:
    """An object stands at x, y [m] on a face at a level [m], as if by magic."""
    slot, scene = env.world.names.index(name), env.world.scene
    assert scene is not None
    place = env.data.joint(f"{name}_joint")
    place.qpos[:3] = x, y, level + scene.standing_extents[slot, 2]
    place.qpos[3:], place.qvel[:] = (1, 0, 0, 0), 0
    mujoco.mj_forward(env.model, env.data)


def put_where_wanted(env: RearrangeEnv) -> None:
    """All objects of the goal stand where they should, those in one area side by side; the others lie on the floor."""
    for name in set(env.world.names) - set(env._goal_monitor.named):
        put(env, name, 2.0, 0.2 * env.world.names.index(name), 0.0)
    taken: dict[tuple[float, ...], int] = {}
    tops: dict[int, tuple[float, float, float]] = {}
    for fact in env.goal.placed:
        slot = env.world.names.index(fact.object)
        place = env._goal_monitor.places[slot]
        (x, y, level), (half_x, half_y) = place.centre, place.half_extents
        if place.below >= 0:
            x, y, level = tops[place.below]
        elif half_x > 0.1:  # a tray or a table: rows of cells of 0.09 m
            cell = taken[tuple(place.centre)] = taken.get(tuple(place.centre), -1) + 1
            columns = int(2 * half_y / 0.09)
            x += -half_x + 0.05 + 0.09 * (cell // columns)
            y += -half_y + 0.05 + 0.09 * (cell % columns)
        put(env, fact.object, x, y, level)
        tops[slot] = x, y, level + 2 * float(env.world.scene.standing_extents[slot, 2])


def idle(env: RearrangeEnv, steps: int) -> list[Any]:
    """What the last step gives of so many in which the robot rests."""
    for _ in range(steps):
        result = env.step(REST)
    return list(result)


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("objects", [4, 12])
def test_a_goal_is_a_function_of_the_seed_and_can_be_reached(task: str, objects: int) -> None:
    env, other = (RearrangeEnv(num_objects=objects, task=task, success="lifted") for _ in range(2))
    other.reset(seed=77)
    for seed in range(3):
        _, info = env.reset(seed=seed)
        observation, again = other.reset(seed=seed)
        assert info == again
        assert (info["goal"], info["target"]) == (env.goal.to_pddl(), "")
        assert observation in env.observation_space
        assert info["unmet"] > 0
        assert not env.data.ncon or task == "stack"
        put_where_wanted(env)
        observation, reward, terminated, _, info = idle(env, HOLD_STEPS)
        assert (info["unmet"], info["is_success"], info["lifted"], terminated, reward) == (0, True, True, True, 1.0)
        assert info["num_disturbed"] > 0, "nothing may travel but in the air, in the gripper"
        rows = observation["goals"].reshape(objects, -1)
        assert np.array_equal(rows[:, GOAL_ROW["met"]], rows[:, GOAL_ROW["has_goal"]])


def test_clean_success_needs_more_than_the_goal() -> None:
    env = RearrangeEnv(num_objects=4)
    env.reset(seed=0)
    put_where_wanted(env)
    *_, terminated, _, info = idle(env, HOLD_STEPS + 5)
    assert (info["lifted"], info["is_success"], terminated) == (True, False, False)


def test_objects_that_change_places_keep_apart() -> None:
    env = RearrangeEnv(num_objects=20, task="swap")
    for seed in range(10):
        env.reset(seed=seed)
        scene, after = env.world.scene, env.world.scene.positions.copy()
        for fact in env.goal.placed:
            after[env.world.names.index(fact.object)] = fact.x, fact.y
        gaps = np.linalg.norm(after[:, None] - after, axis=-1) + np.eye(20)
        assert (gaps - scene.half_extents[:, 0] - scene.half_extents[:, :1] > OBJECT_GAP - 1e-9).all()
        assert 2 <= len(env.goal.placed) <= 6


@pytest.mark.parametrize("shapes", ["box", "cylinder"])
def test_a_stack_of_three_stands_at_the_start_and_stays(shapes: str) -> None:
    env = RearrangeEnv(num_objects=8, task="stack", shapes=shapes)
    for seed in range(3):
        env.reset(seed=seed)
        before = env.measurements.poses.copy()
        assert sorted(env.world.scene.levels > 0) == [False] * (8 - STACK + 1) + [True] * (STACK - 1)
        env.data.qvel[env.world.index.object_dof] = 1e-3  # wakes them
        mujoco.mj_wakeup(env.model, env.data) if hasattr(mujoco, "mj_wakeup") else None
        info = idle(env, 40)[-1]
        assert np.abs(env.measurements.poses - before).max() < 0.002
        assert info["num_fallen"] == info["num_disturbed"] == 0


@pytest.mark.parametrize("seed", range(4))
def test_household_goals_are_judged_by_the_shapes_that_the_planner_has(seed: int) -> None:
    """A jar of 38 mm radius was judged as a box, whose corners stuck out of its place; a pan was to stand in 12 cm."""
    env = gym.make("clutter_env/Rearrange-o8-v0", task="set", object_set="household").unwrapped
    env.reset(seed=seed)
    read = Scene.from_mujoco(env.model, env.data, env.robot, regions=env.regions)
    judged = env._goal_monitor._start
    for one, other in zip(judged.objects, read.objects, strict=True):
        assert (one.name, one.shape) == (other.name, other.shape)
        for mine, its in zip(one.placed, other.placed, strict=True):
            assert mine.shape == its.shape
            np.testing.assert_allclose(mine.corners, its.corners, atol=1e-9)
    planner = Planner(env.robot)
    assert planner.lower_bound(read, env.goal).picks is not None, "the goal is impossible"
    wide = [body.name for body in judged.objects if min(body.half_extents[:2]) > 0.06]
    assert not {fact.object for fact in env.goal.placed}.intersection(wide)


def test_what_is_stacked_holds_only_while_it_stands_on_it() -> None:
    env = RearrangeEnv(num_objects=4, task="stack", success="lifted")
    goal = goals.on("object_01", "object_00") & goals.on("object_02", "object_01")
    env.reset(seed=0, options={"objects": BOXES, "goal": goal})
    put(env, "object_01", 0.0, -0.3, TABLE_HEIGHT + 0.06)
    assert idle(env, 2)[-1]["unmet"] == 1
    put(env, "object_02", 0.0, -0.3, TABLE_HEIGHT + 0.12)
    assert idle(env, HOLD_STEPS)[-1]["is_success"]
    put(env, "object_01", 0.2, 0.3, TABLE_HEIGHT)
    assert idle(env, 1)[-1]["unmet"] == 2


def test_goals_of_the_users_own() -> None:
    env = RearrangeEnv(num_objects=4, task="set")
    regions = [Region("left", "table_top", (0.0, 0.2), (0.1, 0.1), 0.5)]
    text = (
        "(and (inside object_00 left) (at object_01 (x 0.2) (y 0.0)) (before object_00 object_01) (holding object_02))"
    )
    observation, info = env.reset(seed=0, options={"objects": BOXES[:3], "goal": text, "regions": regions})
    assert goals.Goal.from_pddl(info["goal"]) == goals.Goal.from_pddl(text)
    assert env.regions == tuple(regions)
    rows = observation["goals"].reshape(4, -1)
    assert rows[:, GOAL_ROW["has_goal"]].ravel().tolist() == [1, 1, 1, 0]
    assert rows[:, GOAL_ROW["kind"]].argmax(axis=1)[:3].tolist() == [0, 1, 3]
    assert rows[0, GOAL_ROW["centre"]] == pytest.approx([0.0, 0.2, TABLE_HEIGHT])
    assert rows[0, GOAL_ROW["heading"]] == pytest.approx([np.sin(0.5), np.cos(0.5)])
    assert info["unmet"] == 3, "the order is kept as long as nothing has been moved"
    put(env, "object_00", 0.0, 0.2, TABLE_HEIGHT)
    assert idle(env, 1)[-1]["unmet"] == 2
    env._goal_monitor.moved += ["object_01", "object_00"]
    put(env, "object_01", 0.2, 0.0, TABLE_HEIGHT)
    assert idle(env, 1)[-1]["unmet"] == 2, "the first object was moved last"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"target": "object_00"}, "unknown option 'target'; known options: objects, state, base, task, goal, regions"),
        ({"task": "tidy"}, "valid values: 'sort', 'set', 'swap', 'stack', 'fetch'"),
        ({"task": "sort"}, "needs a support whose name begins with 'tray_', as layout 'trays' has"),
        ({"task": "swap", "goal": "object_00"}, "without option 'task'"),
        ({"goal": "(on object_00 tray_red)"}, "regions: none; supports: table_top"),
        ({"goal": "(at object_00 (x 50) (y 50))"}, r"no support under .* supports: table_top, counter_left"),
        ({"goal": "(over object_00 object_01)"}, "valid are holding"),
        ({"goal": "(inside object_00 left)", "regions": [{"name": "left"}]}, "Region"),
        ({"goal": "(inside object_00 left)", "regions": [Region("left", "moon", (0, 0), (1, 1))]}, "no support"),
        ({"task": "stack", "objects": BOXES[:2]}, "needs 3 objects; there are 2"),
    ],
)
def test_wrong_options_are_refused_and_change_nothing(options: dict[str, Any], said: str) -> None:
    env = RearrangeEnv(num_objects=4, task="set")
    env.reset(seed=0)
    state = env.save_state()
    with pytest.raises(OptionError, match=said):
        env.reset(options=options)
    assert env.save_state() == state


@pytest.mark.parametrize(
    ("keywords", "said"),
    [
        ({"task": "sort", "layout": "paper"}, "needs a support whose name begins with 'tray_'"),
        ({"task": "fetch", "layout": "trays"}, "needs a support whose name begins with 'second_table'"),
        ({"task": "stack", "num_objects": 2}, "an integer of at least 3"),
        ({"task": "tidy"}, "valid values: 'sort'"),
        ({"obstructed": True}, "obstructed"),
    ],
)
def test_wrong_keywords_are_refused(keywords: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        RearrangeEnv(**keywords)


def test_another_task_of_the_same_layout_is_an_option() -> None:
    env = RearrangeEnv(num_objects=4, task="sort")
    env.reset(seed=0, options={"task": "swap"})
    assert all(type(fact).__name__ == "At" for fact in env.goal.facts)


def test_an_object_on_the_floor_ends_the_episode_one_on_the_lower_table_does_not() -> None:
    env = RearrangeEnv(num_objects=4, task="fetch", reward_mode="dense")
    env.reset(seed=0)
    first, second = env.goal.facts
    put(env, first.object, 0.2, 3.0, TABLE_HEIGHT - 0.15)
    _, _, terminated, _, info = idle(env, 3)
    assert (info["unmet"], info["num_fallen"], terminated) == (1, 0, False)
    put(env, second.object, -1.5, 2.0, 0.0)
    _, reward, terminated, _, info = idle(env, 1)
    assert (terminated, info["num_fallen"]) == (True, 1)
    assert reward < -200


def test_what_is_carried_below_the_table_top_is_not_lost() -> None:
    env = RearrangeEnv(num_objects=4)
    env.reset(seed=0)
    below = replace(env.measurements, is_off=np.arange(4) == 1)
    assert not env._goal_monitor.is_lost(below)
    assert env._goal_monitor.is_lost(replace(below, is_fallen=np.arange(4) == 1))


def test_the_potential_rises_with_every_fact_and_returns_what_it_gave() -> None:
    env = RearrangeEnv(num_objects=4, reward_mode="dense", success="lifted")
    env.reset(seed=0)
    potentials = [env._potential]
    for fact in env.goal.placed[:3]:
        x, y, level = env._goal_monitor.places[env.world.names.index(fact.object)].centre
        put(env, fact.object, x, y + 0.08 * len(potentials) - 0.16, level)
        before = env._potential
        _, reward, *_ = idle(env, 1)
        assert reward == pytest.approx(DISCOUNT * env._potential - before - 10)  # 10: it did not travel in the gripper
        potentials.append(env._potential)
    assert (np.diff(potentials) > 0).all()
    assert min(potentials) >= 0
    assert max(potentials) < MOST
    put_where_wanted(env)
    *_, info = idle(env, HOLD_STEPS)
    assert info["is_success"]
    assert env._potential == 0


@pytest.mark.parametrize("task", ["set", "swap", "stack"])
def test_saved_states_go_on_bit_for_bit(task: str) -> None:
    env, other = (RearrangeEnv(num_objects=4, task=task, success="lifted", reward_mode="dense") for _ in range(2))
    env.reset(seed=3)
    put_where_wanted(env)
    idle(env, 6)
    state = env.save_state()
    other.reset(seed=1, options={"state": state})
    assert other.save_state() == state
    assert (other.goal, other.regions) == (env.goal, env.regions)
    for _ in range(HOLD_STEPS):
        mine, theirs = env.step(REST), other.step(REST)
        assert mine[1:] == theirs[1:]
        assert all(np.array_equal(mine[0][name], theirs[0][name]) for name in mine[0])
    assert mine[-1]["is_success"]


@pytest.mark.parametrize(
    "change",
    [
        {"goal": "(on object_00 moon)"},
        {"goal": "nonsense("},
        {"facts": [True]},
        {"moved": ["object_99"]},
        {"steps_met": -1},
        {"regions": [{"name": "place_00"}]},
    ],
    ids=str,
)
def test_forged_goals_are_refused(change: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    env = RearrangeEnv(num_objects=4, task="set")
    env.reset(seed=0)
    honest = env._memory()
    json.dumps(honest)
    monkeypatch.setattr(env, "_memory", lambda: {**honest, **change})
    forged = env.save_state()
    before = env.observe_world(-1, 0, 0)["objects"]
    with pytest.raises(StateError):
        env.restore_state(forged)
    assert np.array_equal(before, env.observe_world(-1, 0, 0)["objects"])


def test_a_state_of_another_environment_is_refused() -> None:
    env = RearrangeEnv(num_objects=4, task="set")
    env.reset(seed=0)
    retrieve = gym.make("clutter_env/Retrieve-o5-v0").unwrapped
    retrieve.reset(seed=0)
    with pytest.raises(StateError, match="task"):
        env.restore_state(retrieve.save_state())


def test_objects_that_change_places_between_boards_come_to_stand_where_the_other_one_stood() -> None:
    env = RearrangeEnv(num_objects=6, task="swap", layout="two_boards")
    has_changed = False
    for seed in range(95, 99):
        env.reset(seed=seed)
        scene = Scene.from_mujoco(env.model, env.data, env.robot)
        for fact in env.goal.placed:
            assert isinstance(fact, At)
            (other,) = (
                one for one in scene.objects if np.hypot(*(one.position[:2] - (fact.x, fact.y))) < 1e-3
                and fact.z is not None and abs(one.bottom - (fact.z - scene.body(fact.object).half_extents[2])) < 0.01
            )  # fmt: skip
            has_changed |= scene.support_under(other) != scene.support_under(scene.body(fact.object))
    assert has_changed
