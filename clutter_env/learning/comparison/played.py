"""One episode of a built-in policy, to look at: in a window, or as a film."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clutter_env import OBJECT_COUNTS
from clutter_env.learning.comparison.suite_policies import env_keywords, load_policy
from clutter_env.learning.errors import LearningError
from clutter_env.learning.task import Task
from clutter_env.rendering.film import Film

__all__ = ["Played", "play_policy", "played_task"]


@dataclass(frozen=True)
class Played:
    """How an episode ended.

    Attributes:
        clean: the target was lifted, and nothing had fallen or been disturbed.
        lifted: the target was lifted.
        disturbed, fallen: numbers of objects.
        steps: control steps of 0.05 s.
        failure: why the policy gave up, "" if it did not.
        film: the film, None if there is none.
    """

    clean: bool
    lifted: bool
    disturbed: int
    fallen: int
    steps: int
    failure: str
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
    inner: Any = env.unwrapped
    observation, info = env.reset(seed=seed)
    camera = None if film is None else Film(inner)
    policy.reset(env, info)
    steps, is_over = 0, False
    while not is_over and not getattr(policy, "done", False):
        observation, _, terminated, truncated, info = env.step(policy.act(observation))
        steps += 1
        is_over = terminated or truncated or bool(info["lifted"])
        if camera is not None:
            camera.watch(str(getattr(policy, "phase", "")))
    failure = str(getattr(policy, "failure", "")) if not info["lifted"] else ""
    saved = _saved(camera, film, info)
    inner.wait_for_window()
    env.close()
    return Played(
        clean=bool(info["lifted"]) and not info["num_disturbed"] and not info["num_fallen"],
        lifted=bool(info["lifted"]),
        disturbed=int(info["num_disturbed"]),
        fallen=int(info["num_fallen"]),
        steps=steps,
        failure=failure,
        film=saved,
    )


def _saved(camera: Film | None, stem: Path | None, info: dict[str, Any]) -> Path | None:
    """The film's file."""
    if camera is None or stem is None:
        return None
    camera.finish("lifted" if info["lifted"] else "not lifted")
    stem.parent.mkdir(parents=True, exist_ok=True)
    path = camera.save_film(stem)
    camera.close()
    return path
