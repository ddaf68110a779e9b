"""Replay of an episode from its seed and actions, and the camera images of its physics states.

`python -m clutter_env.data.replay FILE` replays the file of an episode and prints the result as JSON.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from clutter_env.data.episode import PHYSICS_STATE, Columns, Episode
from clutter_env.data.episode_file import read_episode
from clutter_env.errors import LearningError
from clutter_env.rendering.cameras import EnvRenderer

VECTOR = 2
"""Dimensions of an observation's entry over all steps, if it is no image."""


@dataclass(frozen=True)
class ReplayResult:
    """Whether a replay was identical and successful. `first_difference` is the first step that differed, or -1."""

    is_identical: bool
    is_success: bool
    first_difference: int


def replay(episode: Episode) -> ReplayResult:
    """Repeat the actions in a new environment and compare observations and rewards bit for bit. Images are left out."""
    with closing(episode.task.make()) as env:
        observation, info = env.reset(seed=episode.seed, options=_options(episode))
        if not _same(episode, 0, observation):
            return ReplayResult(False, bool(info["is_success"]), 0)
        for step, action in enumerate(episode.actions):
            observation, reward, _, _, info = env.step(action)
            if not _same(episode, step + 1, observation) or float(reward) != episode.rewards[step]:
                return ReplayResult(False, bool(info["is_success"]), step + 1)
        return ReplayResult(True, bool(info["is_success"]), -1)


def _options(episode: Episode) -> dict[str, Any] | None:
    return None if episode.options is None else dict(episode.options)


def replay_in_fresh_process(path: Path) -> ReplayResult:
    """Replay the file of an episode in a new Python process.

    Raises:
        LearningError: that process failed. The message ends with its last output.
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(part for part in sys.path if part)}
    command = [sys.executable, "-m", "clutter_env.data.replay", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    if done.returncode != 0:
        raise LearningError(f"replaying {path} ended with status {done.returncode}: {done.stderr.strip()[-500:]}")
    return ReplayResult(**json.loads(done.stdout.splitlines()[-1]))


def with_images(episode: Episode, image_size: int, cameras: tuple[str, ...] = ()) -> Episode:
    """Add the images of these cameras to the observations, or of the robot's cameras, as with `obs_mode="rgbd"`.

    Colour is (T + 1, size, size, 3) uint8, depth (T + 1, size, size) float32 [m]. They are rendered from the physics
    states, so that no image is rendered while the expert acts.

    Raises:
        RenderingUnavailable: this machine cannot render.
        UnknownTask: no camera of that name, or a robot without cameras.
    """
    with closing(episode.task.make(obs_mode="rgbd", image_size=image_size, cameras=cameras)) as env:
        inner: Any = env.unwrapped
        env.reset(seed=episode.seed, options=_options(episode))
        with closing(EnvRenderer(inner.config)) as renderer:
            frames = []
            for state in episode.states:
                mujoco.mj_setState(inner.model, inner.data, state, PHYSICS_STATE)
                mujoco.mj_kinematics(inner.model, inner.data)
                frames.append(renderer.observation(inner.world))
    images = {name: np.stack([frame[name] for frame in frames]) for name in frames[0]}
    columns = {f"observations/{name}": Columns(f"image {name}") for name in images}
    return replace(episode, observations={**episode.observations, **images}, columns={**episode.columns, **columns})


def _same(episode: Episode, step: int, observation: Mapping[str, NDArray[Any]]) -> bool:
    """Whether an observation equals that of a step of the episode, bit for bit."""
    vectors = {name for name, values in episode.observations.items() if values.ndim == VECTOR}
    return observation.keys() == vectors and all(
        np.asarray(value).tobytes() == episode.observations[name][step].tobytes() for name, value in observation.items()
    )


if __name__ == "__main__":
    print(json.dumps(asdict(replay(read_episode(Path(sys.argv[1]))))))
