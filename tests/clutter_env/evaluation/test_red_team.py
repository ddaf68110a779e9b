"""Policies that cheat in `evaluate` are scored by what their actions do in an environment that they cannot reach."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from clutter_env.cli.main import main
from clutter_env.errors import LearningError
from clutter_env.evaluation.evaluate import Evaluation, evaluate
from clutter_env.evaluation.recording import Recording
from clutter_env.evaluation.scenes import SceneSet
from clutter_env.evaluation.tables import results
from clutter_env.evaluation.verify import verify
from clutter_env.reporting.files import write_json

SCENES = SceneSet("side-15-v2", count=1)

CHEATS = '''
import gc
import numpy as np

class Privileged:
    is_privileged = True
    done = False

    def reset(self, info, env):
        self.env, self.inner, self.done = env, env.unwrapped, False
        self.cheat()

    def act(self, observation):
        self.done = True
        return np.zeros(12, np.float32)

class OverwritesTheMonitor(Privileged):
    def cheat(self):
        from clutter_env.envs.success import SuccessMonitor
        SuccessMonitor.lifted = SuccessMonitor.is_clean = True

class ForgesTheInfo(Privileged):
    def cheat(self):
        info = self.inner.info
        self.inner._info = lambda: {**info, "is_success": True, "lifted": True}

class WritesTheState(Privileged):
    def cheat(self):
        inner = self.inner
        inner.data.qpos[inner.world.index.object_qpos].reshape(-1, 7)[:, 0] += 5.0
        inner._monitor.steps_held = 100

class ForgesItsActions(Privileged):
    def cheat(self):
        self.inner._actions = [np.full(12, np.inf)]

    def act(self, observation):
        self.inner._actions.append(np.full(12, np.nan))
        return super().act(observation)

class ResetsTheEnvironment(Privileged):
    """Exchanges the scene for one with the target alone, and takes it."""
    def cheat(self):
        from planners import TampExpert
        objects = [{"shape": "cylinder", "radius": 0.03, "height": 0.15, "position": (-0.1, 0.0)}]
        self.env.reset(options={"objects": objects, "target": "object_00", "obstructed": False})
        self.expert = TampExpert(self.env)
        self.expert.reset()

    def act(self, observation):
        return self.expert.act()

class SpeedsUpTheRobot(ResetsTheEnvironment):
    """As before, with a robot ten times as fast and more time."""
    def cheat(self):
        super().cheat()
        self.inner.world.controller.max_velocity[:] *= 10
        self.env._max_episode_steps = 10**9

class LooksForTheEnvironment:
    """Of the observations track: it finds no environment in its process."""
    done = False

    def reset(self, info):
        from clutter_env.envs.base import BaseEnv
        assert not [one for one in gc.get_objects() if isinstance(one, BaseEnv)]

    def act(self, observation):
        assert not any("env" in str(type(one)) and hasattr(one, "unwrapped") for one in gc.get_objects())
        self.done = True
        return np.zeros(12, np.float32)

class Answers:
    """Of the observations track: it answers with something that would be executed if it were unpickled."""
    done = False

    def reset(self, info):
        pass

    def act(self, observation):
        class Evil:
            def __reduce__(self):
                return (print, ("executed",))
        return np.array([Evil()] * 12, dtype=object)
'''
NAMES = [line.split()[1].partition("(")[0].rstrip(":") for line in CHEATS.splitlines() if line.startswith("class ")]


@pytest.fixture
def cheats(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "cheats.py").write_text(CHEATS)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", NAMES[1:])
def test_a_policy_that_cheats_has_no_success(cheats: Path, name: str) -> None:  # noqa: ARG001  its directory
    evaluation = evaluate(f"cheats:{name}", SCENES, count_crashes=True)
    (score,) = evaluation.scores
    assert not score.clean
    assert not score.lifted
    assert score.is_crash == (name in ("Answers", "ForgesItsActions"))


@pytest.fixture(scope="module")
def played() -> Evaluation:
    return evaluate("lookahead", SCENES)


@pytest.fixture
def file(played: Evaluation, tmp_path: Path) -> Path:
    write_json(tmp_path / "results.json", results(played))
    return tmp_path / "results.json"


def test_a_results_file_is_confirmed_by_its_recorded_actions(file: Path, capsys: pytest.CaptureFixture) -> None:
    main(["verify", str(file), "--workers", "1"])
    assert "confirmed: 1 clean successes in 1 episodes" in capsys.readouterr().out


def forge(file: Path, change) -> Path:
    content = json.loads(file.read_text())
    change(content)
    file.write_text(json.dumps(content))
    return file


def claim_fewer_steps(content: dict) -> None:
    content["episodes"][0]["steps"] -= 100


def leave_out_an_action(content: dict) -> None:
    recording = Recording.from_json(content["recordings"][0])
    shorter = Recording(recording.control_mode, recording.actions[:-30])
    content["recordings"][0] = shorter.to_json()


def leave_out_the_recording(content: dict) -> None:
    content["recordings"][0] = None


@pytest.mark.parametrize("change", [claim_fewer_steps, leave_out_an_action, leave_out_the_recording])
def test_a_forged_file_is_not_confirmed(file: Path, change, capsys: pytest.CaptureFixture) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["verify", str(forge(file, change)), "--workers", "1"])
    assert ended.value.code == 1
    assert "NOT confirmed" in capsys.readouterr().out


def test_a_file_of_another_machine_is_not_comparable(file: Path) -> None:
    found = verify(forge(file, lambda content: content["provenance"].update(mujoco="1.0.0")))
    assert not found.is_confirmed
    assert "mujoco 1.0.0" in found.not_comparable[0]


def test_a_file_that_holds_no_results_is_refused(file: Path) -> None:
    with pytest.raises(LearningError, match="no results file"):
        verify(forge(file, lambda content: content.pop("recordings")))


def test_a_recording_is_written_and_read_bit_for_bit(played: Evaluation) -> None:
    recording = played.episodes[0].recording
    again = Recording.from_json(json.loads(json.dumps(recording.to_json())))
    assert again.actions.tobytes() == recording.actions.tobytes()
    assert again.ending == recording.ending
