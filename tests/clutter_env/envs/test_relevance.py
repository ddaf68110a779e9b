"""The order of relevance: the target first, the others by distance, fixed for an episode; old ids stay as they are."""

from __future__ import annotations

import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from clutter_env.envs.relevance import RelevantRetrieveEnv, relevance_order, relevant_rows
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.errors import ConfigError, StateError
from clutter_env.provenance import environment_digest
from clutter_env.task import Task

ENV_ID = "clutter_env/Retrieve-o5-v0"


def rows_of(env, observation):
    layout = env.observation_layout["objects"]
    return layout, observation["objects"].reshape(-1, layout.size)


def test_the_target_comes_first_and_the_others_by_their_distance() -> None:
    assert relevance_order([(0, 0), (3, 0), (1, 1), (2.9, 0)], 1) == (1, 3, 2, 0)
    assert relevance_order([(1, 0, 5), (0, 0, 0), (-1, 0, 9)], 1) == (1, 0, 2)  # equally far: as they are numbered


@pytest.mark.parametrize("seed", range(3))
def test_rows_are_those_of_the_slots_in_another_order_and_relative(seed: int) -> None:
    old, new = gym.make(ENV_ID).unwrapped, gym.make(ENV_ID, object_order="relevance").unwrapped
    assert type(old) is RetrieveEnv
    before, _ = old.reset(seed=seed)
    after, info = new.reset(seed=seed)
    assert new.observation_space.contains(after)
    layout, rows = rows_of(new, after)
    known, slots = rows_of(old, before)
    assert rows[0, layout["is_target"]] == 1
    assert new.object_names[new.object_order[0]] == info["target"]
    place, target, tcp = known["position"], slots[old.target_slot], before["tcp"][:3]
    assert np.array_equal(rows[0, place], target[place])
    for row, slot in zip(rows, new.object_order, strict=True):
        same = [name for name in known if name != "position"]
        assert all(np.array_equal(row[layout[name]], slots[slot, known[name]]) for name in same)
        assert np.allclose(row[layout["from_tcp"]], slots[slot, place] - tcp, atol=1e-6)
    others = rows[1:, place]
    assert np.allclose(others, slots[list(new.object_order[1:]), place] - target[place], atol=1e-6)
    distances = np.hypot(*others[:, :2].T)
    assert (np.diff(distances) > -1e-6).all()


def test_rows_do_not_swap_within_an_episode_nor_with_who_looks_at_them() -> None:
    """The order follows from the first state alone: from no policy, and from nothing that moves later."""
    env = gym.make(ENV_ID, object_order="relevance", control_mode="ee").unwrapped
    env.reset(seed=4)
    order, sizes = env.object_order, None
    env.action_space.seed(0)
    for _ in range(60):
        observation, *_ = env.step(env.action_space.sample())
        layout, rows = rows_of(env, observation)
        now = rows[:, layout["half_extents"]]
        sizes = now if sizes is None else sizes
        assert np.array_equal(now, sizes)
    assert env.object_order == order


def test_whole_episodes_are_rearranged_as_single_observations_are() -> None:
    old = gym.make(ENV_ID).unwrapped
    new = gym.make(ENV_ID, object_order="relevance").unwrapped
    seen = [old.reset(seed=2)[0]]
    wanted = [new.reset(seed=2)[0]["objects"]]
    for action in np.random.default_rng(0).uniform(-1, 1, (20, 12)):
        seen.append(old.step(action)[0])
        wanted.append(new.step(action)[0]["objects"])
    objects, tcp = (np.stack([entry[name] for entry in seen]) for name in ("objects", "tcp"))
    assert np.array_equal(relevant_rows(objects, tcp, new.object_order, old.observation_layout["objects"]), wanted)


def test_it_has_a_digest_of_its_own_and_the_old_one_stays() -> None:
    old, new = environment_digest(gym.make(ENV_ID)), environment_digest(gym.make(ENV_ID, object_order="relevance"))
    assert old == environment_digest(gym.make(ENV_ID, object_order="slots"))
    assert old["task"] == "RetrieveEnv"
    assert new["task"] == "RelevantRetrieveEnv"
    assert new["task's code"] != old["task's code"]
    assert {name for name in old if old[name] != new[name]} == {"task", "task's code"}


def test_states_and_pickles_keep_the_order() -> None:
    task = Task(ENV_ID, {"object_order": "relevance"})
    env, other = task.make().unwrapped, task.make().unwrapped
    env.reset(seed=3)
    for action in np.random.default_rng(0).uniform(-1, 1, (5, 12)):
        observation, *_ = env.step(action)
    restored, _ = other.reset(options={"state": env.save_state()})
    copied = pickle.loads(pickle.dumps(env))
    assert isinstance(copied, RelevantRetrieveEnv)
    for found in (restored, copied._observe()):
        assert all(np.array_equal(found[name], observation[name]) for name in observation)
    assert other.object_order == copied.object_order == env.object_order
    with pytest.raises(StateError, match="task"):
        gym.make(ENV_ID).unwrapped.restore_state(env.save_state())


def test_checkers_are_silent_and_wrong_orders_are_refused() -> None:
    check_env(gym.make(ENV_ID, object_order="relevance").unwrapped, skip_render_check=True)
    with pytest.raises(ConfigError, match="relevance"):
        gym.make(ENV_ID, object_order="nearest")


def test_scenes_with_fewer_objects_have_empty_rows_at_the_end() -> None:
    env = gym.make(ENV_ID, object_order="relevance").unwrapped
    cylinder = {"shape": "cylinder", "radius": 0.03, "height": 0.15}
    objects = [{**cylinder, "position": (0.0, y)} for y in (-0.2, 0.1, 0.0)]
    observation, _ = env.reset(seed=0, options={"objects": objects, "target": "object_02"})
    _, rows = rows_of(env, observation)
    assert env.object_order == (2, 1, 0)
    assert not rows[3:].any()
    assert rows[:3].any(axis=1).all()
