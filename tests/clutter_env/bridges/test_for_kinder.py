"""Our environments in KinDER: the worker behind them, without KinDER; KinDER's side with KINDER_PYTHON."""

from __future__ import annotations

import base64
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import clutter_env
from clutter_env.bridges.remote import BridgeError, Remote
from clutter_env.envs.success import DISTURBED_PATH, TOTAL_PATH
from clutter_env.simulation.pressing import SUSTAINED_FORCE, TOTAL_SLIDE, TRANSIENT_IMPULSE

pytestmark = pytest.mark.skipif(os.name == "nt", reason="the interpreter with this package is a shell script")
ROOT = Path(clutter_env.__file__).parents[1]
WITHOUT = """
import sys

class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {names}:
            raise ModuleNotFoundError(name)

sys.meta_path.insert(0, Missing())
import clutter_env.bridges.remote
print(clutter_env.time_limit(15))
"""


@pytest.fixture
def python(tmp_path: Path) -> str:
    """An interpreter that has this package wherever it is called, as an installation does."""
    interpreter = tmp_path / "python"
    interpreter.write_text(f'#!/bin/sh\nPYTHONPATH="{ROOT}" exec "{sys.executable}" "$@"\n')
    interpreter.chmod(0o755)
    return str(interpreter)


@pytest.fixture
def remote(python: str) -> Iterator[Remote]:
    with Remote(python, "retrieve_worker.py") as remote:
        yield remote


def numbers(made: dict[str, Any], answer: dict[str, Any], name: str, kind: str = "clutter_object") -> dict[str, float]:
    """The features of an object in a state."""
    return dict(zip(made["features"][kind], answer["state"][kind][name], strict=True))


def assert_same(made: dict[str, Any], answer: dict[str, Any], env: Any) -> None:
    """The numbers of an answer are those of our own environment, to the last bit."""
    joints = [env.data.joint(name) for name in env.robot.drive_joints]
    robot = list(numbers(made, answer, "robot", "clutter_robot").values())
    assert robot[: len(joints)] == [joint.qpos[0] for joint in joints]
    assert robot[len(joints) + 1 : 2 * len(joints) + 1] == [joint.qvel[0] for joint in joints]
    for name in env.object_names:
        joint = env.data.joint(f"{name}_joint")
        assert list(numbers(made, answer, name).values())[:13] == [*joint.qpos.tolist(), *joint.qvel.tolist()]
    assert answer["info"] == env.info


def test_states_are_those_of_the_environment_to_the_last_bit(remote: Remote) -> None:
    made = remote("make", keywords={"num_objects": 5})
    env: Any = gym.make("clutter_env/Retrieve-o5-v0").unwrapped
    rng = np.random.default_rng(0)
    for seed in (3, 4):
        env.reset(seed=seed)
        assert_same(made, remote("reset", seed=seed, options=None), env)
        for _ in range(40):
            action = rng.uniform(-1, 1, 12).astype(np.float32)
            env.step(action)
            assert_same(made, remote("step", action=action.tolist(), saved=False), env)


def test_an_episode_goes_on_from_a_saved_state_to_the_last_bit(remote: Remote) -> None:
    remote("make", keywords={"num_objects": 5})
    rng = np.random.default_rng(1)
    start = remote("reset", seed=0, options=None)
    before, after = ([rng.uniform(-1, 1, 12).tolist() for _ in range(count)] for count in (20, 10))
    middle = [remote("step", action=action, saved=True) for action in before][-1]
    end = [remote("step", action=action, saved=False) for action in after]
    assert remote("restore", saved=start["saved"])["state"] == start["state"] != middle["state"]
    assert remote("restore", saved=middle["saved"])["state"] == middle["state"]
    assert [remote("step", action=action, saved=False) for action in after] == end


def test_the_expert_s_success_can_be_read_off_a_state(remote: Remote) -> None:
    made = remote("make", keywords={"num_objects": 2})
    env: Any = gym.make("clutter_env/Retrieve-o1-v0", num_objects=2)
    _, info = env.reset(seed=5)
    answer = remote("reset", seed=5, options=None)
    is_over, highest = False, 0.0
    while not is_over:
        assert not answer["info"]["is_success"]
        action = remote("act")["action"]
        _, _, is_over, _, info = env.step(np.array(action, np.float32))
        answer = remote("step", action=action, saved=False)
        assert answer["terminated"] == is_over
        assert_same(made, answer, env.unwrapped)
        objects = {name: numbers(made, answer, name) for name in env.unwrapped.object_names}
        robot = numbers(made, answer, "robot", "clutter_robot")
        forces = max(robot["furniture_force"], robot["self_force"])
        impulses = max(robot["furniture_impulse"], robot["self_impulse"])
        is_gentle = forces <= SUSTAINED_FORCE and impulses <= TRANSIENT_IMPULSE and robot["total_slide"] <= TOTAL_SLIDE
        is_clean = (
            is_gentle
            and robot["total_path"] <= TOTAL_PATH
            and not any(each["is_fallen"] or each["path"] > DISTURBED_PATH for each in objects.values())
        )
        assert info["is_success"] == (is_clean and robot["hold_progress"] == 1)
        assert [name for name, each in objects.items() if each["is_held"]] == [info["held"]] * bool(info["held"])
        assert [name for name, each in objects.items() if each["is_target"]] == [info["target"]]
        highest = max(highest, robot["lift"])
    assert info["is_success"]
    assert highest >= 0.1


@pytest.mark.parametrize("keywords", [{}, {"control_mode": "ee"}, {"base": "differential"}, {"robot": "panda_mobile"}])
def test_actions_and_features_have_a_name_each(remote: Remote, keywords: dict[str, Any]) -> None:
    made = remote("make", keywords={"num_objects": 1, **keywords})
    env = gym.make("clutter_env/Retrieve-o1-v0", **keywords)
    assert len(set(made["actions"])) == len(made["actions"]) == env.action_space.shape[0]
    answer = remote("reset", seed=0, options=None)
    for kind, each in {**answer["state"], "clutter_furniture": made["furniture"]}.items():
        assert len(set(made["features"][kind])) == len(made["features"][kind])
        assert {len(row) for row in each.values()} == {len(made["features"][kind])}
    with pytest.raises(BridgeError, match="ActionError"):
        remote("step", action=[float("nan")] * len(made["actions"]), saved=False)


@pytest.mark.usefixtures("needs_gl")
def test_images_come_as_they_are(remote: Remote) -> None:
    keywords: dict[str, Any] = {"num_objects": 1, "width": 64, "height": 48}
    env: Any = gym.make("clutter_env/Retrieve-o1-v0", render_mode="rgb_array", **keywords)
    env.reset(seed=0)
    remote("make", keywords=keywords)
    remote("reset", seed=0, options=None)
    answer = remote("render")
    assert answer["shape"] == [48, 64, 3]
    assert base64.b64decode(answer["pixels"]) == env.render().tobytes()
    env.close()


@pytest.mark.parametrize("keywords", [{"obs_mode": "rgbd"}, {"reality": 0.5}])
def test_what_states_cannot_show_is_refused(remote: Remote, keywords: dict[str, Any]) -> None:
    with pytest.raises(BridgeError, match="states are exact"):
        remote("make", keywords={"num_objects": 1, **keywords})


def test_the_module_needs_nothing_that_kinder_lacks() -> None:
    lacking = {"mujoco", "mink", "numba", "scipy", "daqp", "kairos", "tyro", "platformdirs", "loky", "psutil"}
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT.replace("{names}", repr(lacking))],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout == "3700\n", done.stderr


@pytest.mark.slow
@pytest.mark.usefixtures("needs_gl")
@pytest.mark.skipif("KINDER_PYTHON" not in os.environ, reason="KinDER runs in an environment of its own")
def test_kinder_takes_them_for_its_own(python: str) -> None:
    script = Path(__file__).with_name("in_kinder.py")
    done = subprocess.run(
        [os.environ["KINDER_PYTHON"], str(script), python],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count(" passed") == 11
