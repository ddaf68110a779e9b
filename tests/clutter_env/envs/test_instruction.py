"""Instructions: the sentence of every environment's goal, in observation and info, and nothing else changed."""

from __future__ import annotations

import pickle
from contextlib import closing
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import clutter_env
from clutter_env.envs.goal import GoalEnv
from clutter_env.envs.instruction import LONGEST, NAME, SIGNS, sentence
from clutter_env.errors import ConfigError, OptionError
from clutter_env.evaluation.evaluate import evaluate
from clutter_env.evaluation.scenes import SceneSet
from clutter_env.policies.protocol import FREE_KEYWORDS
from clutter_env.provenance import environment_digest
from planners import goals

IDS = (
    "Retrieve-o5-v0",
    "Reach-v0",
    "Pick-v0",
    "ArmReach-v0",
    "ArmPick-v0",
    "ArmRetrieve-o3-v0",
    "Open-v0",
    "Rearrange-o4-v0",
    "Skill-o5-v0",
)
SAID = {
    "Retrieve-o5-v0": "Pick up the object 0",
    "Reach-v0": "Move the gripper to (",
    "Pick-v0": "Bring the object 00 to (",
    "ArmReach-v0": "Move the gripper to (",
    "ArmPick-v0": "Bring the object 00 to (",
    "ArmRetrieve-o3-v0": "Pick up the object 0",
    "Open-v0": "Open the drawer.",
    "Rearrange-o4-v0": "Put the object 00 on the ",
    "Skill-o5-v0": "Pick up the object 0",
}


def made(name: str, **keywords: Any) -> gym.Env[Any, Any]:
    return gym.make(f"clutter_env/{name}", **keywords)


@pytest.mark.parametrize("name", IDS)
def test_the_sentence_is_in_observation_and_info_and_nothing_else_has_changed(name: str) -> None:
    with closing(made(name)) as plain, closing(made(name, instruction=True)) as env:
        assert isinstance(env.observation_space, gym.spaces.Dict)
        text = env.observation_space[NAME]
        assert isinstance(text, gym.spaces.Text)
        env.action_space.seed(0)
        told, info = env.reset(seed=3)
        seen, plain_info = plain.reset(seed=3)
        assert told[NAME].startswith(SAID[name])
        for step in range(3):
            assert env.observation_space.contains(told)
            assert told.pop(NAME) == info.pop(NAME) == sentence(env)
            wanted = seen if isinstance(seen, dict) else {"observation": seen}
            assert told.keys() == wanted.keys()
            assert all(np.array_equal(told[part], wanted[part]) for part in wanted), step
            assert info.keys() == plain_info.keys()
            action = env.action_space.sample()
            told, *scores, info = env.step(action)
            seen, *plain_scores, plain_info = plain.step(action)
            assert scores == plain_scores
        assert env.unwrapped.metadata == plain.unwrapped.metadata
        assert isinstance(env.unwrapped, type(plain.unwrapped))


@pytest.mark.parametrize("name", IDS)
def test_the_checker_of_gymnasium_accepts_it(name: str) -> None:
    with closing(made(name, instruction=True)) as env:
        check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize("name", ["Retrieve-o5-v0", "Open-v0", "Rearrange-o4-v0", "Skill-o5-v0"])
def test_the_sentence_is_read_again_as_the_goal(name: str) -> None:
    with closing(made(name, instruction=True)) as env:
        _, info = env.reset(seed=1)
        inner = env.unwrapped
        wanted = getattr(inner, "goal", None) or goals.holding(info["target"])
        assert goals.from_sentence(info[NAME]) == wanted


@pytest.mark.parametrize(("mode", "keywords"), [("sync", {}), ("async", {"shared_memory": False})])
def test_vector_environments_tell_each_its_own(mode: str, keywords: dict[str, Any]) -> None:
    """Gymnasium reads text from shared memory once, before the first reset."""
    chosen = {"vectorization_mode": mode, "vector_kwargs": keywords}
    envs = gym.make_vec("clutter_env/Retrieve-o5-v0", num_envs=2, instruction=True, **chosen)
    with closing(envs):
        told, info = envs.reset(seed=[0, 1])
        assert len(set(told[NAME])) == 2, "seeds with two targets"
        assert list(told[NAME]) == list(info[NAME])
        stepped, *_ = envs.step(envs.action_space.sample())
        assert tuple(stepped[NAME]) == tuple(told[NAME])


@pytest.mark.parametrize("name", ["Pick-v0", "Rearrange-o4-v0", "Skill-o5-v0", "Retrieve-o5-v0"])
def test_a_pickle_and_a_saved_state_keep_the_sentence(name: str) -> None:
    with closing(made(name, instruction=True)) as env, closing(made(name)) as plain:
        env.reset(seed=0)
        again = pickle.loads(pickle.dumps(env.unwrapped))
        assert type(again) is type(env.unwrapped)
        assert again.step(env.action_space.sample())[0][NAME] == sentence(env)
        if name != "Skill-o5-v0":
            other = made(name, instruction=True)
            other.reset(seed=5)
            other.unwrapped.restore_state(env.unwrapped.save_state())
            assert other.step(np.zeros(env.action_space.shape, np.float32))[0][NAME] == sentence(env)
            plain.reset(seed=1)
            plain.unwrapped.restore_state(env.unwrapped.save_state())


def test_without_it_every_id_is_what_it_was() -> None:
    for name in IDS:
        with closing(made(name)) as env, closing(made(name, instruction=True)) as told:
            assert "Instructed" not in [kind.__name__ for kind in type(env.unwrapped).__mro__]
            digest, other = environment_digest(env), environment_digest(told)
            assert {part for part in digest if digest[part] != other[part]} == {"task's code"}


def test_wrong_values_and_goals_without_words_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"instruction='yes' is not valid; .*False, True"):
        made("Reach-v0", instruction="yes")
    with pytest.raises(ConfigError, match="object_order"):
        made("Retrieve-o5-v0", instruction=True, object_order="any")
    with closing(made("Rearrange-o4-v0", instruction=True)) as env:
        name = "länger"
        region = goals.Region(name, "table_top", (0.0, 0.0), (0.1, 0.1))
        with pytest.raises(OptionError, match="other ones"):
            env.reset(seed=0, options={"goal": goals.inside("object_00", name), "regions": [region]})
    assert 60 * len("put the object 00 at (0.123456789012345, 0.123456789012345, 0.123456789012345) m and ") < LONGEST
    assert '"' in SIGNS


def test_every_id_can_be_told_and_a_policy_may_ask_for_it() -> None:
    ids = [name for name in gym.registry if name.startswith("clutter_env/")]
    assert {name.rpartition("/")[2].partition("-")[0] for name in ids} == {
        name.partition("-")[0] for name in (*IDS, "Search-o5-v0")
    }
    assert NAME in FREE_KEYWORDS
    assert clutter_env.OBJECT_COUNTS

    class Reads:
        env_keywords = {"instruction": True}  # noqa: RUF012  as of any policy

        def reset(self, info: dict[str, Any]) -> None:
            self.said, self.done = info[NAME], False

        def act(self, observation: dict[str, Any]) -> Any:
            assert observation[NAME] == self.said
            self.done = True
            return np.zeros(4, np.float32)

    found = evaluate(Reads(), SceneSet(env_id="clutter_env/ArmReach-v0", count=1))
    assert len(found.scores) == 1


@pytest.mark.usefixtures("needs_gl")
def test_a_search_is_told_too() -> None:
    with closing(made("Search-o5-v0", instruction=True, image_size=64)) as env:
        told, info = env.reset(seed=0)
        assert told[NAME] == f"Pick up the {info['target'].replace('_', ' ')}."
        assert env.observation_space.contains(told)


def test_render_modes_are_known_before_an_environment_is_made() -> None:
    assert (
        GoalEnv.metadata["render_fps"]
        == gym.envs.registration.load_env_creator(str(gym.spec("clutter_env/Reach-v0").entry_point)).metadata[
            "render_fps"
        ]
    )
