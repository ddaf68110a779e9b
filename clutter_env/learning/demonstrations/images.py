"""Camera images of an episode, rendered from its physics states: no image is made while the expert acts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from clutter_env.learning.demonstrations.columns import Columns
from clutter_env.learning.demonstrations.episode import PHYSICS_STATE, Episode
from clutter_env.learning.errors import LearningError
from clutter_env.rendering.cameras import EnvRenderer

__all__ = ["render_images", "with_images"]


def with_images(episode: Episode, image_size: int) -> Episode:
    """The episode whose observations have the images of the robot's cameras too.

    Raises:
        RenderingUnavailable: this machine cannot render.
        LearningError: the robot has no camera.
    """
    images = render_images(episode, image_size)
    columns = {f"observations/{name}": Columns(f"image {name}") for name in images}
    return replace(
        episode,
        observations={**episode.observations, **images},
        columns={**episode.columns, **columns},
    )


def render_images(episode: Episode, image_size: int) -> Mapping[str, NDArray[Any]]:
    """Colour (T + 1, size, size, 3) uint8 and depth (T + 1, size, size) float32 [m] images, as with obs_mode="rgbd".

    Raises:
        RenderingUnavailable: this machine cannot render.
        LearningError: the robot has no camera.
    """
    env = episode.task.make(obs_mode="rgbd", image_size=image_size)
    try:
        inner: Any = env.unwrapped
        if not inner.robot.cameras:
            raise LearningError(f"robot {inner.robot.name!r} has no camera")
        env.reset(seed=episode.seed, options=None if episode.options is None else dict(episode.options))
        renderer = EnvRenderer(inner.config)
        try:
            frames = []
            for state in episode.states:
                mujoco.mj_setState(inner.model, inner.data, state, PHYSICS_STATE)
                mujoco.mj_kinematics(inner.model, inner.data)
                frames.append(renderer.observation(inner.world))
        finally:
            renderer.close()
    finally:
        env.close()
    return {name: np.stack([frame[name] for frame in frames]) for name in frames[0]}
