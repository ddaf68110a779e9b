"""Rendering in worker processes and in threads: it works, or an error says what to do; it never hangs."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import clutter_env  # noqa: F401 - registers the environments
from clutter_env.errors import RenderingUnavailable

ID = "clutter_env/Retrieve-o1-v0"
ROOT = Path(__file__).resolve().parents[3]

pytestmark = [
    pytest.mark.usefixtures("needs_gl"),
    pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="this system has no fork"),
]

VECTOR = f"""
import gymnasium as gym, clutter_env
if __name__ == "__main__":
    env = gym.make({ID!r}, render_mode="rgb_array", width=32, height=32)
    env.reset(seed=0)
    env.render()
    {{close}}
    envs = gym.make_vec({ID!r}, num_envs=2, vectorization_mode="async", vector_kwargs=dict(context={{context!r}}),
                        obs_mode="rgbd", image_size=32)
    try:
        print(envs.reset(seed=0)[0]["head_rgb"].shape)
    except RuntimeError as error:
        print(type(error).__name__, error)
        envs.close(terminate=True)
    else:
        envs.close()
"""


@pytest.mark.slow  # that a forked process is told, the next test says
@pytest.mark.parametrize("close", ["", "env.close()"])
@pytest.mark.parametrize(
    ("context", "expected"), [("fork", "RenderingUnavailable this process was forked"), ("spawn", "(2, 32, 32, 3)")]
)
def test_vector_environments_after_the_parent_has_rendered(
    close: str, context: str, expected: str, tmp_path: Path
) -> None:
    script = tmp_path / "vector.py"
    script.write_text(VECTOR.format(close=close, context=context))
    result = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, timeout=120, cwd=tmp_path, env=environment()
    )
    assert expected in result.stdout, result.stdout + result.stderr
    if context == "fork":
        assert "spawn" in result.stdout


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT)}


FORKED = f"""
import os, signal, gymnasium as gym, clutter_env
env = gym.make({ID!r}, render_mode="rgb_array", width=32, height=32).unwrapped
env.reset(seed=0)
env.render()
child = os.fork()
if child == 0:
    signal.alarm(60)
    try:
        env.render()
    except RuntimeError as error:
        print(type(error).__name__, flush=True)
    env.close()
    os._exit(0)
print("status", os.waitpid(child, 0)[1], env.render().shape)
"""


def test_a_forked_process_says_so_and_closes(tmp_path: Path) -> None:
    result = subprocess.run(
        [sys.executable, "-c", FORKED], capture_output=True, text=True, timeout=120, cwd=tmp_path, env=environment()
    )
    assert result.stdout.split("\n")[:2] == ["RenderingUnavailable", "status 0 (32, 32, 3)"], result.stderr


def in_thread(call: Callable[[], object]) -> object:
    """What a call returns or raises in another thread."""
    results: list[object] = []

    def run() -> None:
        try:
            results.append(call())
        except Exception as error:
            results.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    return results[0]


def test_a_second_thread_is_told_that_the_context_belongs_to_the_first() -> None:
    env = gym.make(ID, render_mode="rgb_array", width=32, height=32).unwrapped
    env.reset(seed=0)
    picture = env.render()
    for call in (env.render, env.close):
        error = in_thread(call)
        assert isinstance(error, RenderingUnavailable), error
        assert "thread" in str(error)
    assert np.array_equal(env.render(), picture)
    env.close()


def test_one_environment_for_each_thread_renders() -> None:
    def picture() -> object:
        env = gym.make(ID, render_mode="rgb_array", width=32, height=32).unwrapped
        env.reset(seed=0)
        result = env.render()
        env.close()
        return result

    assert np.array_equal(in_thread(picture), picture())
