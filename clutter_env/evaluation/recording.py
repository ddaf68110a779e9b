"""The recording of an episode: the actions from which anyone can play it again, and so check its score."""

from __future__ import annotations

import base64
import hashlib
import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from clutter_env.errors import LearningError
from clutter_env.evaluation.scenes import Scene
from clutter_env.evaluation.score import Score, Watch, play_scene
from clutter_env.policies.protocol import SKILLS

_MOST_BYTES = 2**24
"""A longer recording is refused before it fills the memory. 200,000 actions of the largest robot are shorter."""
CONTROL_MODES = ("joint", "ee", "skill")


@dataclass(frozen=True)
class Recording:
    """A policy's actions in an episode.

    Of skills it holds the low-level actions that carried them out, unless the scene's own environment is one of skills.

    Attributes:
        control_mode: meaning of the actions, "joint" or "ee", or "skill" for numbers of skills.
        actions: (steps, n) float32, or (steps,) numbers of skills.
        skills: number of skills tried, 0 for a policy that does not act by skills.
        refused: number of skills that the motion layer refused.
        ending: why the episode was no success when it was played, "" for one.
        wall_s: wall time [s], with planning and the policy's inference.
    """

    control_mode: str
    actions: NDArray[Any]
    skills: int = 0
    refused: int = 0
    ending: str = ""
    wall_s: float = 0.0

    @classmethod
    def of(cls, scene: Scene, env: gym.Env[Any, Any], score: Score) -> Recording:
        """That of the episode that has just ended in `env`, with this score."""
        outer: Any = env.unwrapped
        inner = getattr(outer, "physics_env", outer)
        if scene.env_id.startswith("clutter_env/Skill"):
            return cls(
                "skill", np.array(outer.actions, np.float32), score.steps, score.refused, score.failure, score.wall_s
            )
        skills = score.steps if inner is not outer else 0
        actions = np.array(inner.actions, np.float32).reshape(-1, inner.action_size)
        return cls(inner.control_mode, actions, skills, score.refused, score.failure, score.wall_s)

    def replay(self, scene: Scene, env: gym.Env[Any, Any], watch: Watch = lambda *_: None) -> Score:
        """The score of the same actions in an environment of the scene, which no policy has touched. See `play_scene`.

        Raises:
            SuiteError: the first state is not the one that the suite was made with.
        """
        score = replace(play_scene(scene, env, _Playback(self), watch=watch), wall_s=self.wall_s)
        return score if self.control_mode == "skill" else replace(score, skills=self.skills, refused=self.refused)

    @property
    def digest(self) -> str:
        """SHA-256 of the actions."""
        return hashlib.sha256(self.actions.tobytes()).hexdigest()

    def cut(self, steps: int) -> Recording:
        """The recording without actions after the end of the episode, of which they are no part."""
        return replace(self, actions=self.actions[:steps])

    def to_json(self) -> dict[str, Any]:
        """JSON values, with compressed actions."""
        packed = base64.b64encode(zlib.compress(np.ascontiguousarray(self.actions.T).tobytes(), 6)).decode()
        return {
            "control_mode": self.control_mode,
            "shape": list(self.actions.shape),
            "actions": packed,
            "ending": self.ending,
            "skills": self.skills,
            "refused": self.refused,
            "wall_s": self.wall_s,
        }

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Recording:
        """The recording that `to_json` gave, bit for bit.

        Raises:
            LearningError: the values are no recording.
        """
        try:
            shape = tuple(int(size) for size in values["shape"])
            mode, counts = values["control_mode"], (int(values["skills"]), int(values["refused"]))
            if mode not in CONTROL_MODES or len(shape) not in (1, 2) or not 0 <= min(shape) <= max(shape) < _MOST_BYTES:
                raise ValueError(f"control mode {mode!r}, actions of shape {shape}")
            most = math.inf if mode == "skill" else SKILLS  # a Skill environment counts them again in the replay
            if not (0 <= counts[1] <= counts[0] <= most and 0 <= float(values["wall_s"]) < math.inf):
                raise ValueError(f"{counts[0]} skills of at most {most}, {counts[1]} refused, {values['wall_s']} s")
            stream = zlib.decompressobj()
            content = stream.decompress(base64.b64decode(values["actions"], validate=True), _MOST_BYTES)
            if len(content) != 4 * int(np.prod(shape)) or not stream.eof:
                raise ValueError("its actions are not of the shape that is said")
            actions = np.frombuffer(content, np.float32).reshape(shape[::-1]).T
            if not np.isfinite(actions).all():
                raise ValueError("an action is not finite")
            return cls(mode, actions, *counts, str(values["ending"]), float(values["wall_s"]))
        except (KeyError, TypeError, ValueError, OverflowError, zlib.error) as problem:
            raise LearningError(f"no recording of an episode: {problem}") from problem


class _Playback:
    """A policy that gives recorded actions, one after the other."""

    def __init__(self, recording: Recording) -> None:
        self._recording, self._next = recording, 0
        self.failure = recording.ending or "its actions do not give what was played"

    def reset(self, info: Mapping[str, Any]) -> None:  # noqa: ARG002  part of the protocol
        self._next = 0

    @property
    def done(self) -> bool:
        return self._next >= len(self._recording.actions)

    def act(self, observation: Any) -> Any:  # noqa: ARG002  part of the protocol
        action = self._recording.actions[self._next]
        self._next += 1
        return action if action.ndim else int(action)
