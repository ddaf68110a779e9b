"""One episode of a built-in policy, to look at: in a window, or as a film."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym

from clutter_env import OBJECT_COUNTS
from clutter_env.learning.comparison.evaluation import DrawnScene, Score, SuitePolicy, play_scene
from clutter_env.policies.registry import env_keywords, load_policy
from clutter_env.learning.errors import LearningError
from clutter_env.learning.task import Task
from clutter_env.rendering.film import Film

__all__ = ["Played", "play_policy", "played_task"]


@dataclass(frozen=True)
class Played:
    """How an episode ended: its score, and the file of its film, None if there is none."""

    score: Score
    film: Path | None


def played_task(objects: int, layout: str, obstructed: bool) -> Task:
    """The environment of these scenes.

    Raises:
        LearningError: no environment with so many objects; the message lists the valid numbers.
    """
    if objects not in OBJECT_COUNTS:
        raise LearningError(f"objects={objects} is not valid; valid numbers: {', '.join(map(str, OBJECT_COUNTS))}")
    chosen = {"layout": layout, "obstructed": obstructed}
    return Task(f"clutter_env/Retrieve-o{objects}-v0", {name: value for name, value in chosen.items() if value})


def play_policy(task: Task, name: str, seed: int, film: Path | None) -> Played:
    """One episode.

    Args:
        task: environment, see `played_task`.
        name: of the policy, see `load_policy`.
        seed: of the scene.
        film: file of a film, without its ending; None shows a window, which its user closes in the end.

    Raises:
        LearningError: no such policy; the message lists the known ones.
        UnknownTask: not with these keyword arguments; the message lists the valid ones.
        RenderingUnavailable: no OpenGL, or no display for a window.
    """
    policy = load_policy(name, seed)
    mode = "human" if film is None else "rgb_array"
    env = task.make(render_mode=mode, **env_keywords(policy))
    if film is None:
        score = play_scene(DrawnScene(seed), env, policy)
        inner: Any = env.unwrapped
        inner.wait_for_window()
        env.close()
        return Played(score, None)
    filmed = _Filmed(policy)
    score = play_scene(DrawnScene(seed), env, filmed)
    return Played(score, filmed.save(film, "lifted" if score.lifted else "not lifted"))


class _Filmed:
    """A policy whose episode is filmed."""

    def __init__(self, policy: SuitePolicy) -> None:
        self._policy = policy
        self._film: Film | None = None
        self._has_acted = False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._policy, name)

    def reset(self, env: gym.Env[Any, Any], info: Mapping[str, Any]) -> None:
        """Start an episode, and its film."""
        self._film, self._has_acted = Film(env.unwrapped), False
        self._policy.reset(env, info)

    def act(self, observation: Any) -> Any:
        """The next action; the state after the last one is filmed."""
        assert self._film is not None
        if self._has_acted:
            self._film.watch(str(getattr(self._policy, "phase", "")))
        self._has_acted = True
        return self._policy.act(observation)

    def save(self, stem: Path, caption: str) -> Path:
        """End the film with the last state, and write it to a file, to whose name the ending is added."""
        assert self._film is not None
        self._film.finish(caption)
        stem.parent.mkdir(parents=True, exist_ok=True)
        path = self._film.save_film(stem)
        self._film.close()
        return path
