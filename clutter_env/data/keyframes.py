"""Demonstrations as whole-body keyframes, the actions of `clutter_env.envs.keyframe_actions.KeyframeActions`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clutter_env.data.episode import Episode
from clutter_env.errors import DatasetError
from clutter_env.policies.parsed_observation import parse_observation


class KeyframeSteps(NamedTuple):
    """The keyframes of a demonstration.

    Attributes:
        rows: (k,) steps of the episode at which the motion towards each keyframe starts: indices of observations and
            states.
        keyframes: (k, 12) base x, y [m] and yaw [rad], torso [m] and arm [rad], finger position [m].
    """

    rows: NDArray[np.int64]
    keyframes: NDArray[np.float64]


def keyframe_steps(episode: Episode, every: int | None = None) -> KeyframeSteps:
    """Find the keyframes of a demonstration, each once, in their order.

    The plan's own keyframes are the ends of its phases. Between them the robot drives around obstacles, which a
    straight line between keyframes would cross. With `every`, the configuration after each such number of steps is a
    keyframe too.

    Args:
        episode: of an expert that has a plan, with state observations.
        every: number of steps, None for the plan's own keyframes alone.

    Raises:
        DatasetError: the expert had no plan, so the episode has no keyframes, or `every` is less than 1.
    """
    if every is not None and every < 1:
        raise DatasetError(f"every={every} is not valid; it must be at least 1, or None")
    planned = episode.labels.keyframe
    known = np.flatnonzero(np.isfinite(planned).all(axis=1))
    if not len(known):
        raise DatasetError(f"the episode of seed {episode.seed} has no keyframes: its expert has no plan")
    is_new = np.append(True, (planned[known[1:]] != planned[known[:-1]]).any(axis=1))
    starts = known[is_new]
    if every is None:
        return KeyframeSteps(starts, planned[starts])
    was_at = parse_observation(episode.observations).whole_body
    rows, keyframes = list[int](), list[NDArray[np.float64]]()
    for start, end in zip(starts.tolist(), [*starts[1:].tolist(), len(episode)], strict=True):
        between = range(start + every, end - every // 2, every)
        rows += [start, *between]
        keyframes += [np.append(was_at[row], planned[start, -1]) for row in between]
        keyframes.append(planned[start])
    return KeyframeSteps(np.array(rows), np.array(keyframes))
