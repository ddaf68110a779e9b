"""A short film of every environment, for the documentation.

python scripts/gallery.py
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import tyro
from numpy.typing import NDArray
from PIL import Image

import clutter_env
from clutter_env.reporting.progress import progress_bar

assert clutter_env  # registers the environments

Frame = NDArray[np.uint8]

FRAMES_PER_SECOND = 10
_LAST_S = 1.5
"""How long the last frame stays."""
_COLOURS = 96
"""Colours of a film's palette."""


@dataclass(frozen=True)
class Entry:
    """A film.

    Attributes:
        name: of the file.
        env_id: of the environment.
        keywords: of the environment.
        expert: who acts: a name of `clutter_env.policies.experts`, or "greedy" for skills.
        seed: of the scene.
        steps_per_frame: control steps of 0.05 s from frame to frame.
    """

    name: str
    env_id: str
    keywords: Mapping[str, Any] = field(default_factory=dict)
    expert: str = "lookahead"
    seed: int = 1
    steps_per_frame: int = 5


ENTRIES = (
    Entry("retrieve", "clutter_env/Retrieve-o15-v0", {"obstructed": True}),
    Entry("shelf", "clutter_env/Retrieve-o10-v0", {"layout": "shelf"}, "lookahead-all"),
    Entry("dense", "clutter_env/Retrieve-o25-v0", {"layout": "dense", "obstructed": True}, "lookahead-all"),
    Entry("skill", "clutter_env/Skill-o10-v0", {"obstructed": True}, "greedy"),
    Entry("reach", "clutter_env/Reach-v0", {}, "reach", steps_per_frame=1),
    Entry("pick", "clutter_env/Pick-v0", {}, "pick", steps_per_frame=1),
    Entry("rgbd", "clutter_env/Retrieve-o15-v0", {"obs_mode": "rgbd", "image_size": 192}),
)
NAMES = tuple(entry.name for entry in ENTRIES)


def main(
    names: tuple[str, ...] = NAMES,
    size: int = 320,
    out: Path = Path("docs/images/gallery"),
) -> None:
    """Play and write every film.

    Args:
        names: Films to make.
        size: Pixels along each side.
        out: Directory of the films.
    """
    known = {entry.name: entry for entry in ENTRIES}
    if unknown := sorted(set(names) - set(known)):
        sys.exit(f"no film {', '.join(unknown)}; films: {', '.join(known)}")
    out.mkdir(parents=True, exist_ok=True)
    for name in progress_bar(names, desc="films", unit="film"):
        path = out / f"{name}.gif"
        save_gif(list(frames(known[name], size)), path)
        print(f"{path}: {path.stat().st_size / 1e6:.1f} MB")


def frames(entry: Entry, size: int) -> Iterator[Frame]:
    """The frames of one episode; with images in the observation those of the robot's cameras, side by side."""
    keywords = dict(entry.keywords)
    if "obs_mode" not in keywords:
        keywords |= {"render_mode": "rgb_array", "width": size, "height": size}
    if entry.expert == "greedy":
        env = gym.make(entry.env_id, max_episode_steps=100, **keywords)
        yield from _skill_frames(env, entry)
    else:
        from clutter_env.policies.experts import make_expert

        wanted = dict(getattr(make_expert(entry.expert), "env_keywords", {}))
        env = gym.make(entry.env_id, **wanted, **keywords)
        yield from _expert_frames(env, entry)
    env.close()


def _expert_frames(env: gym.Env, entry: Entry) -> Iterator[Frame]:
    from clutter_env.policies.experts import make_expert
    from clutter_env.policies.protocol import begin_episode

    observation, info = env.reset(seed=entry.seed)
    expert = make_expert(entry.expert)
    begin_episode(expert, info, env)
    step, is_over = 0, False
    while not (is_over or expert.done):
        if step % entry.steps_per_frame == 0:
            yield _image(env, observation)
        observation, _, terminated, truncated, _ = env.step(expert.act(observation))
        step, is_over = step + 1, terminated or truncated
    yield _image(env, observation)


def _skill_frames(env: gym.Env, entry: Entry) -> Iterator[Frame]:
    """One frame, shown for a second, after every skill."""
    from clutter_env.policies.baselines import GreedyPolicy

    observation, info = env.reset(seed=entry.seed)
    policy = GreedyPolicy()
    policy.reset(info, env)
    is_over = False
    while not is_over:
        for _ in range(FRAMES_PER_SECOND):
            yield np.asarray(env.render())
        observation, _, terminated, truncated, _ = env.step(policy.act(observation))
        is_over = terminated or truncated
    yield np.asarray(env.render())


def _image(env: gym.Env, observation: Any) -> Frame:
    if env.unwrapped.render_mode is not None:
        return np.asarray(env.render())
    return np.hstack([observation[name] for name in sorted(observation) if name.endswith("rgb")])


def save_gif(images: Sequence[Frame], path: Path) -> None:
    """Write a film with one palette for all frames; the last one stays."""
    chosen = [Image.fromarray(image) for image in [*images, *[images[-1]] * round(_LAST_S * FRAMES_PER_SECOND)]]
    palette = chosen[len(chosen) // 2].quantize(_COLOURS)
    first, *others = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in chosen]
    first.save(path, save_all=True, append_images=others, duration=1000 // FRAMES_PER_SECOND, loop=0, optimize=True)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
