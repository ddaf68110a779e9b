"""Policies that cheat in `evaluate`, and forged results files: neither has a success that it did not play."""

from __future__ import annotations

import base64
import json
import os
import random
import subprocess
import sys
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clutter_env.cli.main import main
from clutter_env.errors import ClutterEnvError, LearningError
from clutter_env.evaluation import verify as verifying
from clutter_env.evaluation.challenge import Challenge, draw, register
from clutter_env.evaluation.evaluate import Evaluation, evaluate
from clutter_env.evaluation.recording import Recording
from clutter_env.evaluation.scenes import SceneSet
from clutter_env.evaluation.suite_making import file_text, qualifying, rules_of
from clutter_env.evaluation.tables import results
from clutter_env.evaluation.verify import FRESH_SEEDS, Verification, fresh_scenes, verify
from clutter_env.reporting.files import write_json
from clutter_env.suites import content_digest, suite

REACH = SceneSet(env_id="clutter_env/Reach-v0", count=2)

CHEATS = '''
"""Cheats in turn, one an episode; the count is kept in a file, since some of them end the process."""
import gc, os
from pathlib import Path
import numpy as np

def overwrites_the_monitor(self):
    from clutter_env.envs.success import SuccessMonitor
    SuccessMonitor.lifted = SuccessMonitor.is_clean = True

def overwrites_the_score(self):
    from clutter_env.evaluation import policy_process, recording, score
    from dataclasses import replace
    of, won = recording.Recording.of, dict(clean=True, lifted=True, failure="")
    recording.Recording.of = lambda scene, env, played: of(scene, env, replace(played, **won))

def exchanges_multiprocessing(self):
    import loky, multiprocessing.connection, pickle
    multiprocessing.connection.Connection.send_bytes = pickle.dumps = lambda *_: b""

def forges_the_info(self):
    info = self.inner.info
    self.inner._info = lambda: {**info, "is_success": True, "lifted": True}

def writes_the_state(self):
    self.inner.data.qpos[self.inner.world.index.object_qpos].reshape(-1, 7)[:, 0] += 5.0
    self.inner._monitor.steps_held = 100

def writes_the_file_of_the_suite(self):
    from clutter_env import suites
    suites.SuiteScene.check = lambda *_: None
    self.env.reset(seed=1)

def forges_its_actions(self):
    self.inner._actions = [np.full(12, np.inf)]

def forges_their_number(self):
    self.inner._actions = [np.zeros(12)] * 100_000

def exchanges_the_scene(self):
    """One with the target alone, which it takes with a robot ten times as fast and more time."""
    from planners import TampExpert
    objects = [{"shape": "cylinder", "radius": 0.03, "height": 0.15, "position": (-0.1, 0.0)}]
    self.env.reset(options={"objects": objects, "target": "object_00", "obstructed": False})
    self.inner.world.controller.max_velocity[:] *= 10
    self.env._max_episode_steps = 10**9
    self.expert = TampExpert(self.env)
    self.expert.reset()

NAMES = [name for name, value in list(globals().items()) if callable(value) and "_" in name]

class Privileged:
    is_privileged = True

    def reset(self, info, env):
        self.env, self.inner, self.done, self.expert = env, env.unwrapped, False, None
        played = len(list(Path.cwd().glob("played-*")))
        Path(f"played-{played}").touch()
        globals()[NAMES[played]](self)

    def act(self, observation):
        if self.expert:
            return self.expert.act()
        self.done = True
        return np.zeros(12, np.float32)

class OfObservations:
    """Looks for the environment in its own process, in its parent's, and among the files that are open."""
    def reset(self, info):
        from clutter_env.envs.base import BaseEnv
        self.done = False
        assert not [one for one in gc.get_objects() if isinstance(one, BaseEnv)]
        assert not {"is_success", "lifted"} - set(info), "what everybody knows"
        assert not [name for name in info if "seed" in name]

    def check(self, public):
        assert not hasattr(public, "env")
        assert "seed" not in repr(vars(public))

    def act(self, observation):
        self.done = True
        opened = [file.readlink() for file in Path("/proc/self/fd").iterdir() if file.exists()]
        assert not [file for file in opened if str(file).startswith("socket")], opened
        return np.zeros(12, np.float32)
'''
NUM_CHEATS = 9


@pytest.fixture
def cheats(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "cheats.py").write_text(CHEATS)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_policy_that_cheats_has_no_success(cheats: Path) -> None:
    evaluation = evaluate("cheats:Privileged", SceneSet("side-15-v3", count=NUM_CHEATS), count_crashes=True)
    assert len(list(cheats.glob("played-*"))) == NUM_CHEATS
    assert not any(score.clean or score.lifted for score in evaluation.scores)
    assert [score.failure for score in evaluation.scores if "not finite" in score.failure], "a forged action is refused"


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="Linux")
@pytest.mark.usefixtures("cheats")
def test_a_policy_of_the_observations_track_finds_no_environment() -> None:
    (score,) = evaluate("cheats:OfObservations", SceneSet("side-15-v3", count=1)).scores
    assert (score.failure, score.clean) == ("gave up", False)


@pytest.fixture(scope="module")
def played() -> Evaluation:
    """Two successes."""
    evaluation = evaluate("reach", REACH)
    assert all(score.clean for score in evaluation.scores)
    return evaluation


@pytest.fixture
def file(played: Evaluation, tmp_path: Path) -> Path:
    write_json(tmp_path / "results.json", results(played))
    return tmp_path / "results.json"


@pytest.fixture
def in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    def run_here(function: Callable[[Any], Any], jobs: Iterator[Any], _: int) -> Iterator[Any]:
        return ((job, function(job)) for job in jobs)

    monkeypatch.setattr(verifying, "run_jobs", run_here)


def forge(file: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    """A forged file with the digest of its content."""
    content = json.loads(file.read_text())
    change(content)
    left_out = ("format", "provenance", "digest", "summary", "crashes", "recordings")
    content["digest"] = content_digest({name: value for name, value in content.items() if name not in left_out})
    file.write_text(json.dumps(content))
    return file


def test_a_results_file_is_confirmed_by_its_recorded_actions(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["verify", str(file), "--workers", "1", "--json", str(file.with_name("found.json"))])
    assert "confirmed: 2 clean successes in 2 episodes of reach, seeds 1000000 to 1000001" in capsys.readouterr().out
    assert json.loads(file.with_name("found.json").read_text())["differences"] == []
    assert verifying.which_scenes(SceneSet("side-15-v3")) == "side-15-v3"
    assert verifying.which_scenes(SceneSet("side-15-v3", count=7)).endswith("its first 7 of 100 scenes")


def a_failure_as_a_success(content: dict[str, Any]) -> None:
    content["recordings"][0]["actions"] = Recording("ee", np.zeros((50, 10), np.float32)).to_json()["actions"]
    content["recordings"][0]["shape"] = [50, 10]
    content["episodes"][0]["actions"] = Recording.from_json(content["recordings"][0]).digest


def shorter(content: dict[str, Any]) -> None:
    recording = Recording.from_json(content["recordings"][0])
    content["recordings"][0] = replace(recording, actions=recording.actions[:-3]).to_json()


def longer(content: dict[str, Any]) -> None:
    recording = Recording.from_json(content["recordings"][0])
    more = replace(recording, actions=np.vstack((recording.actions, recording.actions)))
    content["recordings"][0], content["episodes"][0]["actions"] = more.to_json(), more.digest


def of_another_scene(content: dict[str, Any]) -> None:
    content["recordings"].reverse()
    for claim, values in zip(content["episodes"], content["recordings"], strict=True):
        claim["actions"] = Recording.from_json(values).digest


def other_scenes(content: dict[str, Any]) -> None:
    content["first_seed"] += 1


def another_environment(content: dict[str, Any]) -> None:
    content.update(env_id="clutter_env/Pick-v0", scenes="pick")


def of_a_suite(content: dict[str, Any]) -> None:
    content.update(suite="side-15-v3", scenes="side-15-v3", env_id="", grasps="side")


def of_skills(content: dict[str, Any]) -> None:
    content["recordings"][0]["control_mode"] = "skill"


def more_skills_than_allowed(content: dict[str, Any]) -> None:
    content["recordings"][0]["skills"] = content["episodes"][0]["skills"] = 1000


def without_recordings(content: dict[str, Any]) -> None:
    content["recordings"] = [None, None]


def without_a_failure(content: dict[str, Any]) -> None:
    content["summary"]["clean"]["mean"] = 0.9


def a_better_bound(content: dict[str, Any]) -> None:
    content["episodes"][0]["floor"] = 3


def of_the_other_track(content: dict[str, Any]) -> None:
    content["track"] = content["summary"]["track"] = "observations"


def with_nan(content: dict[str, Any]) -> None:
    content["episodes"][0]["sim_s"] = float("nan")


FORGERIES = [
    *(a_failure_as_a_success, shorter, longer, of_another_scene, other_scenes, another_environment, of_a_suite),
    *(of_skills, more_skills_than_allowed, without_recordings, without_a_failure, a_better_bound),
    *(of_the_other_track, with_nan),
]


@pytest.mark.usefixtures("in_process")
@pytest.mark.parametrize("change", FORGERIES, ids=lambda change: change.__name__)
def test_a_forged_file_is_not_confirmed(file: Path, change: Callable[[dict[str, Any]], object]) -> None:
    assert verify(forge(file, change)).differences


@pytest.mark.usefixtures("in_process")
def test_a_file_is_confirmed_where_the_checkpoint_that_played_is_not(file: Path) -> None:
    name = "lerobot:/not/here"
    found = verify(forge(file, lambda content: (content.update(policy=name), content["summary"].update(policy=name))))
    assert (found.differences, found.weights) == ((), "not here")


def test_to_verify_executes_nothing_that_lies_beside_the_file(file: Path, tmp_path_factory: Any) -> None:
    for name in ("loky", "multiprocessing", "numpy", "mujoco"):
        (file.parent / f"{name}.py").write_text("import os; open('executed', 'w'); os._exit(1)")
    script = tmp_path_factory.mktemp("bin") / "command.py"  # as the one that is installed: elsewhere
    script.write_text("from clutter_env.cli.main import main\nif __name__ == '__main__':\n    main()")
    env = {name: value for name, value in os.environ.items() if name != "PYTHONSAFEPATH"}
    command = [sys.executable, str(script), "verify", file.name, "--workers", "1"]
    ended = subprocess.run(
        command, cwd=file.parent, env={**env, "PYTHONPATH": str(Path.cwd())}, capture_output=True, text=True
    )
    assert not (file.parent / "executed").exists()
    assert "\nconfirmed: 2 clean successes" in f"\n{ended.stdout}", ended.stderr


def test_the_command_says_that_a_forged_file_is_not_confirmed(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["verify", str(forge(file, shorter)), "--workers", "1"])
    assert ended.value.code == 1
    assert "NOT confirmed" in capsys.readouterr().out


@pytest.mark.usefixtures("in_process")
def test_a_file_made_with_something_else_is_confirmed_by_the_same_digits_alone(file: Path) -> None:
    def forge_version(content: dict[str, Any]) -> None:
        content["provenance"].update(mujoco="1.0.0\x1b[2K")

    found = verify(forge(file, forge_version))
    assert found.is_confirmed
    assert "mujoco 1.0.0" in found.other_than[0]
    other_library = verify(forge(file, lambda content: content["provenance"].update(arithmetic="0")))
    assert other_library.is_confirmed
    assert "arithmetic 0" in other_library.other_than[1]
    assert len(verify(forge(file, lambda content: content["provenance"].pop("arithmetic"))).other_than) == 1
    changed = verify(forge(file, lambda content: content["judged_in"].update(success="0")))
    assert any("success has changed" in said for said in changed.other_than)
    assert verify(forge(file, lambda content: content["judged_in"].update(settings=3))).is_confirmed
    claimed = verify(forge(file, lambda content: (forge_version(content), shorter(content))))
    assert not claimed.is_confirmed


@pytest.mark.parametrize(
    "values",
    [
        {"actions": base64.b64encode(zlib.compress(bytes(2**26))).decode(), "shape": [2**20, 16]},
        {"actions": "not base 64!"},
        {"actions": base64.b64encode(b"not compressed").decode()},
        *({"shape": shape} for shape in ([2**32, 2**32], [-50, -10], [], [50], [50, 2, 5], ["nan"], [float("inf"), 1])),
        *({"skills": count} for count in (-1, 21, 1e300, float("inf"), None)),
        {"control_mode": "teleport"},
        {"control_mode": []},
        {"wall_s": float("nan")},
    ],
    ids=lambda values: json.dumps(values)[:40],
)
def test_damaged_recordings_are_refused(played: Evaluation, values: dict[str, Any]) -> None:
    recording = played.episodes[0].recording
    assert recording is not None
    with pytest.raises(LearningError, match="no recording"):
        Recording.from_json({**recording.to_json(), **values})


@pytest.mark.parametrize(
    "change",
    [
        lambda content: content.pop("recordings"),
        lambda content: content["recordings"].pop(),
        lambda content: content.update(env_id="antigravity:Reach-v0"),
        lambda content: content.update(env_id="CartPole-v2"),
        lambda content: content.update(first_seed="0"),
        lambda content: content.update(episodes={}, recordings={}),
        lambda content: content.update(episodes=[], recordings=[]),
        lambda content: content.update(policy="\x1b[2Kconfirmed"),
        lambda content: content.update(policy="x" * 5000),
        lambda content: content.update(format=4),
        lambda content: content.update(layout="nowhere"),
    ],
)
def test_a_file_that_holds_no_results_is_refused(file: Path, change: Callable[[dict[str, Any]], object]) -> None:
    with pytest.raises(ClutterEnvError):
        verify(forge(file, change))
    assert "antigravity" not in sys.modules


def mutated(value: Any, rng: random.Random) -> Any:
    """A JSON value in which one entry is another one."""
    if isinstance(value, dict | list) and value and rng.random() < 0.9:
        keys = list(value) if isinstance(value, dict) else list(range(len(value)))
        key = rng.choice(keys)
        changed = dict(value) if isinstance(value, dict) else list(value)
        if rng.random() < 0.1:
            del changed[key]
        else:
            changed[key] = mutated(value[key], rng)
        return changed
    others = [None, True, 0, -1, 2, 10**30, 0.5, float("nan"), "", "x", "skill", [], {}, [[]], {"a": 1}]
    return rng.choice([other for other in others if json.dumps(other) != json.dumps(value)])


def outcome(file: Path, content: Any) -> Verification | None:
    """What `verify` finds, None where it refuses the file."""
    file.write_text(json.dumps(content))
    try:
        return verify(file)
    except ClutterEnvError:
        return None


def decoded(values: dict[str, Any]) -> Any:
    """What a recording says of the episode, without times and words."""
    recording = Recording.from_json(values)
    return recording.digest, recording.control_mode, recording.skills, recording.refused


FREE = ("provenance", "weights", "seed", "feasibility", "environment", "policy", "grasps")
"""Entries that the scores do not depend on: claims, as `Verification` says."""


@pytest.mark.usefixtures("in_process")
@pytest.mark.parametrize("count", [20, pytest.param(3000, marks=pytest.mark.slow)])
def test_files_with_a_random_change_are_refused_or_not_confirmed(file: Path, count: int) -> None:
    rng, valid = random.Random(0), json.loads(file.read_text())
    for _ in range(count):
        content = mutated(valid, rng)
        found = outcome(file, content)
        if found is not None and found.is_confirmed:
            changed = {name for name in valid if not isinstance(content, dict) or content.get(name) != valid[name]}
            assert changed <= {*FREE, "recordings"}, changed
            assert list(map(decoded, content["recordings"])) == list(map(decoded, valid["recordings"]))


def test_a_recording_is_written_and_read_bit_for_bit(played: Evaluation) -> None:
    recording = played.episodes[0].recording
    assert recording is not None
    again = Recording.from_json(json.loads(json.dumps(recording.to_json())))
    assert again.actions.tobytes() == recording.actions.tobytes()
    assert again.ending == recording.ending


def test_a_policy_plays_scenes_that_nobody_could_know(file: Path, tmp_path: Path) -> None:
    fresh = evaluate("reach", fresh_scenes(file, 1, FRESH_SEEDS[1234], tmp_path))
    assert [scene.seed for scene in fresh.scenes.scenes] == [FRESH_SEEDS[1234]]
    assert fresh.scores[0].clean


MACHINES = {
    "two workers": {},
    "another home and hash seed": {"HOME": "/nonexistent", "PYTHONHASHSEED": "7"},
    "four threads": {"OMP_NUM_THREADS": "4", "OPENBLAS_NUM_THREADS": "4", "MKL_NUM_THREADS": "4"},
    "no AVX": {"NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL"},
}
OLD_PROCESSOR = {"OPENBLAS_CORETYPE": "Nehalem", "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL"}
"""Its BLAS rounds differently, and so do policies that are run on it; a replay calls none."""


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["lookahead", "keyframes", "random-skills"])
def test_results_are_the_same_bit_for_bit_and_verify_in_other_processes(policy: str, tmp_path: Path) -> None:
    digests = set()
    for k, (name, variables) in enumerate(MACHINES.items()):
        file = tmp_path / f"{k}.json"
        words = ["--suite", "side-15-v3", "--scenes", "2", "--workers", "2" if k == 0 else "1", "--json", str(file)]
        command = [sys.executable, "-m", "clutter_env.cli.main"]
        env = {**os.environ, "HOME": str(tmp_path), "PYTHONPATH": str(Path.cwd()), **variables}
        for said in (["evaluate", "--policy", policy, *words], ["verify", str(file)]):
            env |= OLD_PROCESSOR if said[0] == "verify" else {}
            ended = subprocess.run([*command, *said], env=env, cwd=tmp_path, capture_output=True, text=True)
            assert ended.returncode == 0, (name, ended.stderr)
        digests.add(json.loads(file.read_text())["digest"])
    assert len(digests) == 1


def fresh_of(file: Path, suite_name: str, count: int, folder: Path) -> SceneSet:
    path = forge(file, lambda content: content.update({"suite": suite_name, "policy": "random"}))
    return fresh_scenes(path, count, FRESH_SEEDS[0], folder)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["deep-shelf-12-v2", "household-shelf-10-v2", "sort-8-v3", "drawer-5-v1", "all-25-v3"])
def test_fresh_scenes_are_those_that_the_suites_own_rules_admit(name: str, file: Path, tmp_path: Path) -> None:
    """They had any lower bound once, then the least one, standard objects for household ones, the longest time."""
    fresh, rules = fresh_of(file, name, 2, tmp_path), rules_of(name)
    admitted = qualifying(rules, FRESH_SEEDS[:1000], 2, 1)
    assert [scene.seed for scene in fresh.scenes] == [entry["seed"] for entry in admitted]
    assert [scene.max_steps for scene in fresh.scenes] == [entry["max_steps"] for entry in admitted]
    assert (fresh.scenes[0].env_id, fresh.scenes[0].keywords) == (
        suite(name).test[0].env_id,
        suite(name).test[0].keywords,
    )
    assert len(suite(fresh.suite).validation) == 0


@pytest.mark.slow
def test_fresh_scenes_of_a_challenge_are_of_the_suite_that_its_entry_names(file: Path, tmp_path: Path) -> None:
    challenge = Challenge(register("random", "deep-shelf-12-v2", 2), "00" * 32)
    drawn = tmp_path / "challenge.json"
    drawn.write_text(file_text(draw(challenge)))
    assert rules_of(str(drawn)) == rules_of("deep-shelf-12-v2")
    fresh = fresh_of(file, str(drawn), 1, tmp_path)
    floor = fresh.scenes[0].floor_side
    assert floor.is_proved
    assert floor.count >= 2
