"""What the expert keeps of an episode for its page."""

from __future__ import annotations

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import clutter_env
from planners import TampExpert
from planners.expert.config import ExpertError

assert clutter_env  # registers the environments


def test_the_recording_is_the_episode(tmp_path: Path) -> None:
    env = gym.make("clutter_env/Retrieve-o1-v0", disable_env_checker=True)
    _, info = env.reset(seed=0)
    expert = TampExpert(env)
    with pytest.raises(ExpertError, match="reset"):
        expert.to_html(tmp_path / "episode.html")
    expert.reset(info["target"])
    states = [env.unwrapped.data.qpos.copy()]  # type: ignore[attr-defined]  # of MuJoCo's environments
    phases = []
    is_over = False
    while not is_over:
        action = expert.act()
        phases.append(expert.phase)
        _, _, terminated, truncated, _ = env.step(action)
        states.append(env.unwrapped.data.qpos.copy())  # type: ignore[attr-defined]  # of MuJoCo's environments
        is_over = terminated or truncated or expert.done
    recording = expert.recording
    assert len(recording.frames) == len(states)
    for frame, state in zip(recording.frames, states, strict=True):
        np.testing.assert_allclose(frame.qpos, state, atol=1e-6)
    assert [frame.phase for frame in recording.frames[:-1]] == phases
    times = np.array([frame.time for frame in recording.frames])
    np.testing.assert_allclose(np.diff(times), 0.05, atol=1e-9)
    actions = [frame.action for frame in recording.frames if frame.action >= 0]
    assert actions == sorted(actions)
    assert recording.solves[0].outcome is expert.solution
    expert.to_html(tmp_path / "episode.html")
    assert '"result":"success"' in (tmp_path / "episode.html").read_text()
    env.reset(seed=1)
    assert len(expert.recording.frames) == len(states) - 1, "nothing of the next episode"
