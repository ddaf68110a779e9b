"""Policies that see less than the scene, made of demonstrations: what they win can be won without looking.

With its observations zeroed, every deterministic policy is one sequence of actions: `blind` finds the best of several.
`robot_only` sees the robot alone, and `nearest` the whole first observation. Both play the demonstration with the most
similar observation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clutter_env.errors import LearningError
from clutter_env.evaluation.evaluate import Evaluation
from clutter_env.evaluation.scenes import Scene
from clutter_env.evaluation.score import play_scene
from clutter_env.task import family

ROBOT = ("robot", "tcp", "gripper")
"""Entries of an observation that show the robot alone."""
CANDIDATES, TRIALS = 6, 10
"""Sequences of actions that are tried for the blind policy, each on so many scenes."""
SELDOM = 10
"""Control steps between images that nobody looks at, the most that Search allows."""
_CONSTANT = 1e-6
"""A number that varies less between demonstrations is no part of what looks alike."""

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Demonstrations:
    """Episodes of an expert that were clean successes.

    Attributes:
        control_mode: of the actions, "joint" or "ee".
        scenes: that were played.
        first: their first observations, each a dictionary of vectors.
        actions: (steps, n) of each.
    """

    control_mode: str
    scenes: tuple[Scene, ...]
    first: tuple[Mapping[str, NDArray[Any]], ...]
    actions: tuple[NDArray[np.float32], ...]

    @classmethod
    def of(cls, played: Evaluation) -> Demonstrations:
        """Those of an evaluation.

        Raises:
            LearningError: there is not a single clean success, or it is one of skills.
        """
        won = [
            (scene, episode.recording)
            for scene, episode in zip(played.scenes.scenes, played.episodes, strict=True)
            if episode.score.clean and episode.recording and episode.recording.control_mode != "skill"
        ]
        if not won:
            raise LearningError(f"{played.policy} has no clean success in {len(played.episodes)} demonstrations")
        mode = won[0][1].control_mode
        with closing(won[0][0].make(control_mode=mode)) as env:
            first = tuple(scene.reset(env)[0] for scene, _ in won)
        return cls(mode, tuple(scene for scene, _ in won), first, tuple(recording.actions for _, recording in won))

    @property
    def env_keywords(self) -> dict[str, Any]:
        """Of the environment in which the actions mean what they meant."""
        return {"control_mode": self.control_mode}

    @property
    def replay_keywords(self) -> dict[str, Any]:
        """The same, for a policy that looks at the first observation alone: Search shows few of the images after it."""
        seldom = {"frame_every": SELDOM} if family(self.scenes[0].env_id) == "search" else {}
        return self.env_keywords | seldom

    @property
    def longest(self) -> int:
        """Control steps of the longest."""
        return max(map(len, self.actions))


class Replay:
    """Plays the demonstration whose first observation is nearest in some of its entries. Without entries, the first.

    Attributes:
        env_keywords: of the demonstrations' environment.
        done: after its last action.
    """

    def __init__(self, known: Demonstrations, entries: Sequence[str]) -> None:
        self.env_keywords = known.replay_keywords
        self._known, self._entries = known, tuple(entries)
        self._left: list[NDArray[np.float32]] | None = None
        self.done = False
        seen = np.array([self._vector(one) for one in known.first])
        spread = seen.std(axis=0)
        self._scale = np.where(spread > _CONSTANT, 1 / np.maximum(spread, _CONSTANT), 0.0)
        self._seen = seen * self._scale

    def _vector(self, observation: Mapping[str, NDArray[Any]]) -> Vector:
        return np.concatenate([np.ravel(observation[name]) for name in self._entries] or [np.zeros(0)]).astype(float)

    def reset(self, info: Mapping[str, Any]) -> None:  # noqa: ARG002  part of the protocol
        """Start an episode."""
        self._left, self.done = None, False

    def chosen(self, observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
        """(steps, n) The actions that it plays where it sees this at first."""
        apart = np.linalg.norm(self._seen - self._vector(observation) * self._scale, axis=1)
        return self._known.actions[int(apart.argmin())]

    def act(self, observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
        """The next action of the demonstration that was chosen at the first."""
        if self._left is None:
            self._left = list(self.chosen(observation)[::-1])
        action = self._left.pop()
        self.done = not self._left
        return action


def blind(known: Demonstrations) -> Replay:
    """The sequence of actions, among some that were demonstrated, that wins most of the demonstrations' scenes."""
    chosen = range(min(CANDIDATES, len(known.actions)))
    scenes = known.scenes[-TRIALS:]
    with closing(scenes[0].make(**known.replay_keywords)) as env:
        wins = [sum(play_scene(scene, env, _only(known, k)).clean for scene in scenes) for k in chosen]
    return _only(known, int(np.argmax(wins)))


def _only(known: Demonstrations, index: int) -> Replay:
    part = slice(index, index + 1)
    one = replace(known, scenes=known.scenes[part], first=known.first[part], actions=known.actions[part])
    return Replay(one, ())


def robot_only(known: Demonstrations) -> Replay:
    """The demonstration at whose beginning the robot was most alike."""
    return Replay(known, [name for name in ROBOT if name in known.first[0]])


def nearest(known: Demonstrations) -> Replay:
    """The demonstration whose whole first observation was most alike."""
    return Replay(known, tuple(known.first[0]))
