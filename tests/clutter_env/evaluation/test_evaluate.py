"""`evaluate(policy, scenes)`: the protocol, episodes, crashes, the results file."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import pytest

from clutter_env.cli.main import main
from clutter_env.errors import LearningError, SuiteError
from clutter_env.evaluation.evaluate import ResultRecords, _Job, _keys, evaluate, lower_bounds
from clutter_env.evaluation.scenes import SceneSet, SeededScene, find_floor, scene_for
from clutter_env.evaluation.score import PolicyCrashed, Score, play_scene
from clutter_env.evaluation.tables import results, summarise
from clutter_env.evaluation.verify import verify
from clutter_env.policies.protocol import PolicyError, begin_episode
from clutter_env.policies.registry import load_policy
from clutter_env.provenance import provenance
from clutter_env.reporting.files import write_json
from clutter_env.seeds import HELD_OUT, held_out_seeds
from clutter_env.suites import suite
from clutter_env.task import Task
from clutter_env.training.run import Run
from tests.clutter_env.evaluation.evaluations import evaluation, score

POLICY = """
import numpy as np

class Patient:
    env_keywords = {"control_mode": "ee"}

    def reset(self, info):
        self.left = 7

    @property
    def done(self):
        return not self.left

    def act(self, observation):
        self.left -= 1
        return np.zeros(10, np.float32)

class Broken(Patient):
    def act(self, observation):
        raise ZeroDivisionError("by design")

class Old(Patient):
    def reset(self, env, info):
        self.left = 7
"""
TWO = SceneSet("side-15-v3", count=2)
REACH = SceneSet(env_id="clutter_env/Reach-v0", count=2)
O15 = SceneSet(env_id="clutter_env/Retrieve-o15-v0", obstructed=True, count=2)


class Idle:
    """Never moves."""

    env_keywords = {"control_mode": "ee"}  # noqa: RUF012  as users write it

    def reset(self, info: Any) -> None:
        pass

    def act(self, _: Any) -> Any:
        return np.zeros(10, np.float32)


class Broken(Idle):
    """Fails in its second episode."""

    episodes = 0

    def reset(self, _: Any) -> None:
        self.episodes += 1

    def act(self, observation: Any) -> Any:
        if self.episodes == 2:
            raise ZeroDivisionError("by design")
        return super().act(observation)


@pytest.fixture(scope="module")
def reach() -> gym.Env:
    return Task("clutter_env/Reach-v0").make()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "my_policies.py").write_text(POLICY)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    return tmp_path


def test_the_command_writes_one_results_file(folder: Path) -> None:
    main(["evaluate", "--policy", "my_policies:Patient", "--scenes", "2", "--workers", "1", "--json", "one.json"])
    one = json.loads((folder / "one.json").read_text())
    assert one["suite_sha256"] == suite("side-15-v3").digest
    assert [(entry["steps"], entry["failure"]) for entry in one["episodes"]] == [(7, "gave up")] * 2
    assert one["summary"]["clean"]["mean"] == one["crashes"] == 0
    assert one["summary"]["failures"] == {"gave up": 2}
    assert one["provenance"]["environment"] == one["environment"]
    assert one["track"] == "observations"
    assert list(one["weights"]) == ["my_policies.py"]


@pytest.mark.usefixtures("folder")
def test_an_exception_of_a_policy_ends_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["evaluate", "--policy", "my_policies:Broken", "--scenes", "1", "--workers", "1"])
    assert ended.value.code == 1
    said = capsys.readouterr().err
    assert re.search(r"Broken on scene 0 of side-15-v3 \(seed \d+\); --count-crashes", said)
    assert re.search(r'(?s)my_policies\.py", line \d+, in act.*by design', said)


@pytest.mark.usefixtures("folder")
def test_the_command_says_how_many_exceptions_were_counted(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made = evaluation([score(0, 1), Score.of_crash(1, "by design")], lower_bounds(TWO, "side"), TWO)
    monkeypatch.setattr("clutter_env.evaluation.evaluate.evaluate", lambda *_, **__: made)
    main(["evaluate", "--policy", "ngr", "--scenes", "2", "--count-crashes"])
    assert "1 episodes, counted as failures, ended with an exception" in capsys.readouterr().out


def test_exceptions_in_this_process_are_raised_or_counted() -> None:
    found = evaluate(Broken(), REACH, count_crashes=True)
    assert [score.failure for score in found.scores] == ["time limit", "crashed: ZeroDivisionError: by design"]
    with pytest.raises(ZeroDivisionError) as raised:
        evaluate(Broken(), REACH)
    assert "scene 1 of reach (seed " in raised.value.__notes__[0]


@pytest.mark.parametrize("action", [np.zeros(3), None, np.full(10, np.nan)], ids=["short", "none", "nan"])
def test_a_wrong_action_is_that_of_a_class_in_a_file(action: Any, reach: gym.Env) -> None:
    """The message was one line about the environment, without a word on whose action it was."""

    class Wrong(Idle):
        def act(self, _: Any) -> Any:
            return action

    with pytest.raises(PolicyCrashed, match=r"Wrong in .*test_evaluate\.py returned no valid action"):
        play_scene(0, reach, Wrong())


def test_a_full_disk_does_not_lose_the_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    made = evaluation([score(0, None), score(1, 1)], lower_bounds(TWO, "side"), TWO)
    monkeypatch.setattr("clutter_env.evaluation.evaluate.evaluate", lambda *_, **__: made)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(SystemExit, match="No space left"):
        main(["evaluate", "--policy", "ngr", "--scenes", "2"])
    assert "ngr solved 1 of 2 scenes of side-15-v3 cleanly." in capsys.readouterr().out
    assert not list(tmp_path.glob("outputs/evaluate/*"))


def test_scores_in_a_file_are_not_made_again(tmp_path: Path) -> None:
    path = tmp_path / "results.jsonl"
    first = evaluate(Idle(), REACH, records=ResultRecords(path))
    content = path.read_text()
    path.write_text(content + '{"key": "cut o')
    assert evaluate(Idle(), REACH, records=ResultRecords(path)).scores == first.scores
    assert path.read_text() == content
    broken = Broken()
    broken.episodes = 1
    evaluate(broken, REACH, records=ResultRecords(path), count_crashes=True)
    assert path.read_text().count('"Broken') <= path.read_text().count("Broken") < 3, "crashes are not kept"


def test_a_run_whose_networks_have_changed_is_played_again(tmp_path: Path) -> None:
    """Its number of steps is written when it begins: scores of its first checkpoint stood for the last one's."""
    Run(Task(REACH.env_id), "sac", tmp_path).write_record()
    keys = []
    for networks in (b"first", b"last"):
        (tmp_path / "model.pt").write_bytes(networks)
        keys.append(_keys(_Job(str(tmp_path), REACH), {"environment": {}}))
    assert len({*keys[0], *keys[1]}) == 2 * len(REACH.scenes)


def test_files_of_something_else_and_of_another_version_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "results.jsonl"
    ResultRecords(path)
    older = path.read_text().replace(f'"version": "{provenance()["version"]}', '"version": "0.1.9')
    for content in ("nothing\n", "[]\n", '{"a": 1}\n{"b": 2}\n', '{"versions": {}}\n', older):
        path.write_text(content)
        with pytest.raises(LearningError, match=r"results\.jsonl") as refused:
            ResultRecords(path)
    refused.match(r"recorded with version 0\.1\.9")


def test_playing_measures_what_happened() -> None:
    env = Task("clutter_env/Pick-v0").make()
    first, seed = held_out_seeds(2)
    assert first == HELD_OUT
    good = play_scene(SeededScene("clutter_env/Pick-v0", {}, seed), env, load_policy("pick", 0))
    idle = play_scene(seed, env, Idle(), max_steps=30)
    assert (good.clean, good.failure) == (True, "")
    assert (idle.steps, idle.moved, idle.failure) == (30, 0, "time limit")
    assert idle.sim_s == pytest.approx(1.5)
    first, second = suite("side-15-v3").test[:2]
    played = play_scene(replace(second, max_steps=5), first.make(control_mode="ee"), Idle())
    assert (played.steps, played.failure, played.clean, played.lifted) == (5, "time limit", False, False)


def test_the_direct_approach_lifts_without_success_and_is_counted_apart() -> None:
    scenes = SceneSet(env_id="clutter_env/Retrieve-o15-v0", count=2, first_seed=610_006)
    scores = evaluate("direct-approach", scenes).scores
    assert [score.lifted for score in scores] == [False, True]
    assert not any(score.clean for score in scores)
    assert all(score.failure == ("not clean" if score.lifted else "gave up") for score in scores)
    assert scores[1].steps < 100, "an episode is over when the target is lifted"


def test_random_actions_are_a_function_of_seed_and_scene(reach: gym.Env) -> None:
    def actions(seed: int, scene_seed: int) -> np.ndarray:
        policy = load_policy("random", seed)
        observation, info = reach.reset(seed=scene_seed)
        begin_episode(policy, info, reach)
        return np.array([policy.act(observation) for _ in range(3)])

    assert np.array_equal(actions(3, 0), actions(3, 0))
    assert not np.array_equal(actions(3, 0), actions(4, 0))
    assert not np.array_equal(actions(3, 0), actions(3, 1))


def test_results_count_both_kinds_of_success_by_lower_bound_and_have_a_digest() -> None:
    scenes = SceneSet("side-15-v3")
    scores = [
        score(scene.seed, 0 if k % 2 == 0 else None, is_lifted=k % 3 != 1) for k, scene in enumerate(scenes.scenes)
    ]
    floors = lower_bounds(scenes, "side")
    made = evaluation(scores, floors, scenes)
    found = results(made)
    lifted = np.mean([one.lifted for one in scores])
    assert (found["summary"]["clean"].mean, found["summary"]["lifted"].mean) == (0.50, lifted)
    assert sum(rate.scenes for rate in found["summary"]["by_floor"].values()) == len(scores)
    slower = evaluation([replace(one, wall_s=9.0) for one in scores], floors, scenes)
    assert results(slower)["digest"] == found["digest"]
    for changed in (
        evaluation([*scores[:-1], replace(scores[-1], lifted=not scores[-1].lifted)], floors, scenes),
        replace(made, traits=replace(made.traits, track="observations")),
        replace(made, weights={"policy.pt": "0"}),
        replace(made, provenance={"environment": {"reward": "x"}}),
    ):
        assert results(changed)["digest"] != found["digest"]
    floor = find_floor(O15.scenes[0], "side")
    assert floor.is_proved
    assert floor.count, "the target is obstructed"


def test_sets_of_scenes_have_names_and_know_their_kind() -> None:
    assert (O15.name, O15.family, O15.num_objects) == ("o15 obstructed", "retrieve", 15)
    shelf = SceneSet("shelf-10-v4", "validation", count=3)
    assert (shelf.name, shelf.num_objects, len(shelf.scenes)) == ("shelf-10-v4 (validation)", 10, 3)
    with pytest.raises(LearningError, match="name one of them"):
        SceneSet()
    with pytest.raises(LearningError, match="from 1 to 100"):
        SceneSet("shelf-10-v4", count=101)
    with pytest.raises(SuiteError, match="splits: test, validation"):
        SceneSet("side-15-v3", "train")


def test_skills_play_the_scenes_of_suites_and_environments() -> None:
    for scene in (suite("shelf-10-v4").test[0], O15.scenes[0]):
        played, plain = scene_for(scene, True, "none"), scene.make()
        env = played.make()
        _, info = played.reset(env)
        scene.reset(plain)
        assert info["target"] == plain.unwrapped.world.names[plain.unwrapped.target_slot]
        assert np.array_equal(env.unwrapped.physics_env.data.qpos, plain.unwrapped.data.qpos)
    with pytest.raises(LearningError, match="no skills"):
        scene_for(REACH.scenes[0], True, "oracle")
    with pytest.raises(LearningError, match="feasibility='none' is for scenes of Retrieve"):
        evaluate("random-skills", SceneSet(env_id="clutter_env/Skill-o5-v0", count=1), feasibility="none")


@pytest.mark.usefixtures("folder")
def test_a_policy_is_refused_before_anything_is_played() -> None:
    with pytest.raises(PolicyError, match="lookahead"):
        evaluate("nobody", REACH)
    with pytest.raises(PolicyError, match=r"reset\(env, info\), as in version 0\.1"):
        evaluate("my_policies:Old", REACH)
    with pytest.raises(PolicyError, match=r"armpick cannot play side-15-v3 \(retrieve\); it plays armpick"):
        evaluate("armpick", TWO)


def test_a_policy_may_not_choose_the_cameras_on_which_scenes_depend() -> None:
    class Above(Idle):
        env_keywords = {"cameras": ("top",)}  # noqa: RUF012  as users write it

    with pytest.raises(PolicyError, match="in Search the scenes depend on the cameras"):
        evaluate(Above(), SceneSet(env_id="clutter_env/Search-o10-v0", count=1))


def test_suites_of_rearrange_have_lower_bounds_and_are_confirmed(tmp_path: Path) -> None:
    class GivesUp(Idle):
        done, failure = True, "no idea"

    found = evaluate(GivesUp(), SceneSet("stack-8-v3", count=2))
    assert found.floors == lower_bounds(found.scenes, found.traits.grasps)
    row = summarise("nobody", [found])
    assert sum(rate.scenes for rate in row.by_floor.values()) == 2
    assert np.isnan(row.moved_per_floor.mean)
    assert [one.failure for one in found.scores] == ["no idea"] * 2
    file = tmp_path / "results.json"
    write_json(file, results(found))
    assert not verify(file).differences


def test_a_goal_that_a_policy_gives_itself_is_not_scored() -> None:
    class ChangesTheGoal(Idle):
        is_privileged, done, failure = True, True, "that is all"
        infos: ClassVar[list[dict[str, Any]]] = []

        def reset(self, info: dict[str, Any], env: Any) -> None:
            inner = env.unwrapped
            inner.reset(seed=0, options={"goal": "(clear counter_left)"})
            self.infos += [info, *(inner.step(np.zeros(10, np.float32))[-1] for _ in range(12))]

    policy = ChangesTheGoal()
    found = evaluate(policy, SceneSet("stack-8-v3", count=1))
    assert [policy.infos[k]["is_success"] for k in (0, -1)] == [False, True], "in its own environment"
    assert [(one.clean, one.lifted) for one in found.scores] == [(False, False)]


def test_sets_of_scenes_of_rearrange_have_names() -> None:
    assert SceneSet(env_id="clutter_env/Rearrange-o4-v0", task="swap", count=1).name == "swap-o4"
