"""Policies on suites: the protocol, the episodes, the results file."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clutter_env.cli.main import main
from clutter_env.errors import LearningError, SuiteError
from clutter_env.evaluation.evaluate import Evaluation, evaluate
from clutter_env.evaluation.results import results
from clutter_env.evaluation.score import Score, play_scene
from clutter_env.learning.comparison.strata import by_stratum
from clutter_env.policies.registry import env_keywords, load_policy, policy_grasps
from clutter_env.suites import Floor, suite

POLICY = """
import numpy as np

class Patient:
    env_keywords = {"control_mode": "ee"}

    def reset(self, env, info):
        self.left, self.size = 7, env.action_space.shape

    @property
    def done(self):
        return not self.left

    def act(self, observation):
        self.left -= 1
        return np.zeros(self.size, np.float32)

class Broken(Patient):
    def act(self, observation):
        raise ZeroDivisionError("by design")

class Mute:
    def reset(self, env, info):
        pass

class Greedy(Patient):
    env_keywords = {"obstructed": False}

class Handy(Patient):
    grasps = "left-handed"
"""


class Idle:
    """Never moves."""

    def reset(self, env: Any, _: Any) -> None:
        self.size = env.action_space.shape

    def act(self, _: Any) -> Any:
        return np.zeros(self.size, np.float32)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "my_policies.py").write_text(POLICY)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def score(seed: int, clean: bool, lifted: bool) -> Score:
    return Score(seed, clean, lifted, 10, 0.5, 0, 0, 0, 0, 0, "" if clean else "time limit", 1.0)


def test_the_command_writes_one_results_file_the_same_twice(folder: Path) -> None:
    words = ["evaluate", "--policy", "my_policies:Patient", "--scenes", "2", "--workers", "1"]
    main([*words, "--json", "one.json"])
    main([*words, "--json", "other.json"])
    one, other = (json.loads((folder / name).read_text()) for name in ("one.json", "other.json"))
    times = one.pop("wall_s"), other.pop("wall_s")
    assert all(len(entry) == 2 and min(entry) > 0 for entry in times)
    assert one == other
    assert one["suite_sha256"] == suite("side-15-v1").digest
    assert [entry["steps"] for entry in one["episodes"]] == [7, 7]
    assert {entry["failure"] for entry in one["episodes"]} == {"gave up"}
    assert one["summary"]["clean"]["successes"] == one["summary"]["lifted"]["successes"] == 0


@pytest.mark.usefixtures("folder")
def test_a_policy_that_raises_loses_the_episode() -> None:
    found = evaluate(Evaluation("side-15-v1", "my_policies:Broken", scenes=1))
    assert found["episodes"][0]["failure"] == "ZeroDivisionError: by design"


def test_an_episode_ends_with_its_time() -> None:
    scene = replace(suite("side-15-v1").test[0], max_steps=5)
    played = play_scene(scene, scene.make(), Idle())
    assert (played.steps, played.failure, played.clean, played.lifted) == (5, "time limit", False, False)
    assert played.sim_s == pytest.approx(0.25)


def test_random_actions_are_a_function_of_seed_and_scene() -> None:
    scene = replace(suite("side-15-v1").test[0], max_steps=40)
    one, other = (play_scene(scene, scene.make(), load_policy("random", seed=3)) for _ in range(2))
    assert replace(one, wall_s=other.wall_s) == other


def test_results_count_both_kinds_of_success_by_floor() -> None:
    evaluation = Evaluation("side-15-v1", "lookahead")
    scenes = suite("side-15-v1").test
    scores = [score(scene.seed, clean=index % 2 == 0, lifted=index % 3 != 1) for index, scene in enumerate(scenes)]
    found = results(evaluation, scores)
    assert found["summary"]["clean"]["successes"] == 50
    assert found["summary"]["lifted"]["successes"] == 67
    by_floor = {name: rates["episodes"] for name, rates in found["summary"]["by_floor"].items()}
    assert by_floor == {"1": 84, "2": 13, "3 or more": 3}
    assert (found["grasps"], found["episodes"][0]["floor"]) == ("side", scenes[0].floor_side.count)
    changed = results(evaluation, [*scores[:-1], replace(scores[-1], lifted=not scores[-1].lifted)])
    assert changed["digest"] != found["digest"]
    slower = results(evaluation, [replace(one, wall_s=9.0) for one in scores])
    assert slower["digest"] == found["digest"]


def test_scenes_are_sorted_by_floor() -> None:
    floors = [Floor(7, True), Floor(1, True), Floor(None, True, "unreachable"), Floor(2, False), Floor(1, True)]
    assert by_stratum("abcde", floors) == {"1": ["b", "e"], "3 or more": ["a"], "none": ["c"], "unproved": ["d"]}


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("flying", "give module:Class, the directory of a training run, or one of lookahead"),
        ("no_such_module:Policy", "cannot be imported"),
        ("my_policies:Absent", "cannot be imported"),
        ("my_policies:Mute", "has no method 'act'"),
    ],
)
@pytest.mark.usefixtures("folder")
def test_a_policy_that_cannot_play_is_refused(name: str, message: str) -> None:
    with pytest.raises(LearningError, match=message):
        load_policy(name, 0)


def test_results_are_broken_down_by_the_floor_of_the_policy_s_grasps() -> None:
    assert policy_grasps(Idle()) == "all"
    assert policy_grasps(load_policy("lookahead", 0)) == "side"
    assert policy_grasps(load_policy("lookahead-all", 0)) == "all"
    assert policy_grasps(load_policy("greedy", 0)) == "side"
    every = results(Evaluation("side-15-v1", "lookahead-all"), [score(0, True, True)])
    assert every["episodes"][0]["floor"] == suite("side-15-v1").test[0].floor("all").count


@pytest.mark.usefixtures("folder")
def test_a_policy_uses_grasps_for_which_there_are_floors() -> None:
    with pytest.raises(LearningError, match="grasps='left-handed' are not valid; it may have side, all"):
        policy_grasps(load_policy("my_policies:Handy", 0))


@pytest.mark.usefixtures("folder")
def test_a_policy_may_not_change_the_scenes() -> None:
    with pytest.raises(LearningError, match="may not choose 'obstructed'; it may choose control_mode"):
        env_keywords(load_policy("my_policies:Greedy", 0))


def test_scenes_and_splits_that_do_not_exist_are_refused() -> None:
    with pytest.raises(LearningError, match="from 1 to 100"):
        evaluate(Evaluation("side-15-v1", "random", scenes=101))
    with pytest.raises(SuiteError, match="splits: test, validation"):
        evaluate(Evaluation("side-15-v1", "random", split="train"))
