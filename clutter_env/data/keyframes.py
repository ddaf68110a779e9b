"""Demonstrations as whole-body keyframes, the actions of `clutter_env.envs.keyframe_actions.KeyframeActions`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clutter_env.data.episode import Episode
from clutter_env.errors import DatasetError


class KeyframeSteps(NamedTuple):
    """The keyframes of a demonstration.

    Attributes:
        rows: (k,) steps of the episode from which each is gone for: indices of observations and states.
        keyframes: (k, 12) base x, y [m] and yaw [rad], torso [m] and arm [rad], finger position [m].
    """

    rows: NDArray[np.int64]
    keyframes: NDArray[np.float64]


def keyframe_steps(episode: Episode) -> KeyframeSteps:
    """The keyframes that a demonstration goes for, each once, in their order.

    Raises:
        DatasetError: the expert had no plan, so that there are none.
    """
    keyframes = episode.labels.keyframe
    is_known = np.isfinite(keyframes).all(axis=1)
    known = np.flatnonzero(is_known)
    if not len(known):
        raise DatasetError(f"the episode of seed {episode.seed} has no keyframes: its expert has no plan")
    is_new = np.append(True, (keyframes[known[1:]] != keyframes[known[:-1]]).any(axis=1))
    return KeyframeSteps(known[is_new], keyframes[known[is_new]])
