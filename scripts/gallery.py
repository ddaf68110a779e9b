"""A short film of every environment, for the documentation.

python scripts/gallery.py
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Mapping
from itertools import count
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import tyro
from numpy.typing import NDArray

import clutter_env  # noqa: F401  registers the environments
from clutter_env.policies.experts import EXPERTS, make_expert
from clutter_env.policies.playing import played
from clutter_env.policies.protocol import begin_episode
from clutter_env.policies.registry import PolicyTraits, load_policy
from clutter_env.rendering.film import save_gif
from clutter_env.rendering.framing import across, near_view, work_place
from clutter_env.rendering.renderer import Renderer
from clutter_env.reporting.progress import progress_bar

Frame = NDArray[np.uint8]

FRAMES_PER_SECOND = 10
_LAST_S = 1.5
"""How long the last frame stays."""
_WITH_HAND, _NEAR = (640, 400), (224, 168)
"""Width and height [pixels] of a film with the hand, and of its view of the gripper, with a white edge."""
_EDGE = 3
_LARGE, _FAR = (640, 480), 1.3
"""The same of films from near, and [m] from the middle of the table to the base up to which the robot is in them."""
_INTO_DRAWER, _PAST_DOOR = (65.0, -58.0), (30.0, -46.0)
"""[deg] Azimuth and elevation of their view of a drawer, and of a door with its hinges on the left."""


class Entry(NamedTuple):
    """A film: name of the file, environment, its keyword arguments, expert or policy, seed."""

    name: str
    env_id: str
    keywords: Mapping[str, Any] = MappingProxyType({})
    expert: str = "lookahead"
    seed: int = 1
    steps_per_frame: int = 5
    """Control steps of 0.05 s from frame to frame."""
    shows_hand: bool = False
    """Whether it is larger, with the gripper from near in a corner."""
    is_near: bool = False
    """Whether it shows the table and the robot at work, larger, and not where the robot starts."""


ENTRIES: tuple[Entry, ...] = (
    Entry("retrieve", "clutter_env/Retrieve-o15-v0", {"obstructed": True}, shows_hand=True),
    Entry("pr2", "clutter_env/Retrieve-o15-v0", {"obstructed": True, "robot": "pr2"}, seed=2, shows_hand=True),
    Entry(
        "panda", "clutter_env/Retrieve-o15-v0", {"obstructed": True, "robot": "panda_mobile"}, seed=2, shows_hand=True
    ),
    Entry("household", "clutter_env/Retrieve-o15-v0", {"object_set": "household"}, "lookahead-all", shows_hand=True),
    Entry("failure", "clutter_env/Retrieve-o15-v0", {"obstructed": True}, "direct-approach", shows_hand=True),
    Entry("shelf", "clutter_env/Retrieve-o10-v0", {"layout": "shelf"}, "lookahead-all"),
    Entry("dense", "clutter_env/Retrieve-o25-v0", {"layout": "dense", "obstructed": True}, "lookahead-all"),
    Entry("sort", "clutter_env/Rearrange-o4-v0", {"task": "sort"}, "lookahead-all", steps_per_frame=10),
    Entry("stack", "clutter_env/Rearrange-o8-v0", {"task": "stack"}, "lookahead-all", steps_per_frame=10),
    Entry("skill", "clutter_env/Skill-o10-v0", {"obstructed": True}, "greedy"),
    Entry("reach", "clutter_env/Reach-v0", {}, "reach", steps_per_frame=1),
    Entry("pick", "clutter_env/Pick-v0", {}, "pick", steps_per_frame=1),
    Entry("arm_pick", "clutter_env/ArmPick-v0", {}, "armpick", steps_per_frame=1, shows_hand=True),
    Entry("arm_retrieve", "clutter_env/ArmRetrieve-o3-v0", {}, "armretrieve", steps_per_frame=2, shows_hand=True),
    Entry("search", "clutter_env/Search-o10-v0", {}, "examples.search_expert:Searches", steps_per_frame=10),
    Entry("rgbd", "clutter_env/Retrieve-o15-v0", {"obs_mode": "rgbd", "image_size": 192}),
)
OPENING = tuple(
    Entry(layout, f"clutter_env/Retrieve-o{count}-v0", {"layout": layout}, "lookahead-all", seed, steps, is_near=True)
    for layout, count, seed, steps in (
        ("drawer", 5, 1, 18),
        ("cupboard", 5, 7, 20),
        ("fridge", 10, 1, 16),
        ("blocked_drawer", 5, 2, 20),
    )
)
"""Films of things that open."""
ENTRIES += OPENING
NAMES = tuple(entry.name for entry in ENTRIES)


def main(
    names: tuple[str, ...] = NAMES,
    size: int = 400,
    out: Path = Path("docs/images/gallery"),
) -> None:
    """Play and write every film.

    Args:
        names: Films to make.
        size: Pixels of a film's width, but for the larger ones; it is three quarters as high.
        out: Directory of the films.
    """
    known = {entry.name: entry for entry in ENTRIES}
    if unknown := sorted(set(names) - set(known)):
        sys.exit(f"no film {', '.join(unknown)}; films: {', '.join(known)}")
    out.mkdir(parents=True, exist_ok=True)
    for name in progress_bar(names, desc="films", unit="film"):
        path = out / f"{name}.gif"
        images = list(frames(known[name], size))
        save_gif(images + images[-1:] * round(_LAST_S * FRAMES_PER_SECOND), path, 1000 // FRAMES_PER_SECOND)
        print(f"{path}: {path.stat().st_size / 1e6:.1f} MB")


def frames(entry: Entry, size: int) -> Iterator[Frame]:
    """The frames of one episode; with images in the observation those of the robot's cameras, side by side."""
    acts_by_skills = entry.env_id.startswith("clutter_env/Skill")
    policy: Any = make_expert(entry.expert) if entry.expert in EXPERTS else load_policy(entry.expert, 0)
    keywords = {**PolicyTraits.of(policy).env_keywords, **entry.keywords}
    if "obs_mode" not in keywords:
        keywords |= {"render_mode": "rgb_array", "width": size, "height": 3 * size // 4}
    env = gym.make(entry.env_id, **keywords)
    observation, info = env.reset(seed=entry.seed)
    begin_episode(policy, info, env)
    world = env.unwrapped
    special = _with_hand(world) if entry.shows_hand else _at_work(world) if entry.is_near else None
    picture = special or (lambda: _image(env, observation))
    # A skill is one step, whose frame is shown for a second.
    repeats, every = (FRAMES_PER_SECOND, 1) if acts_by_skills else (1, entry.steps_per_frame)
    numbers, taken = count(), list[Frame]()

    def step(action: Any) -> tuple[Any, ...]:
        if next(numbers) % every == 0 and (not entry.is_near or _is_at_work(env.unwrapped)):
            taken.extend([picture()] * repeats)
        return env.step(action)

    for last in played(policy, step, observation):
        yield from taken
        taken.clear()
        observation = last.observation
    yield picture()
    env.close()


def _with_hand(env: Any) -> Callable[[], Frame]:
    """Pictures of the table and the robot at work, the gripper from near in the corner before the robot."""
    views = [Renderer(env.model, *size) for size in (_WITH_HAND, _NEAR)]
    views[1].has_shadows = False  # from near they are coarse
    direction, (width, height) = across(env.layout), _WITH_HAND
    whole, near = work_place(env.model, env.layout, direction, width / height), near_view(direction)

    def picture() -> Frame:
        near.lookat[:] = env.data.site_xpos[env.world.index.tcp_site]
        image = views[0].colour(env.data, whole).copy()
        inset = np.pad(views[1].colour(env.data, near), ((_EDGE, _EDGE), (_EDGE, _EDGE), (0, 0)), constant_values=255)
        image[-len(inset) :, : inset.shape[1]] = inset
        return image

    return picture


def _at_work(env: Any) -> Callable[[], Frame]:
    """Pictures of the table and the robot at work, from so high that it does not hide what is inside."""
    view, (width, height) = Renderer(env.model, *_LARGE), _LARGE
    turn, tilt = _INTO_DRAWER if env.layout.has_drawers else _PAST_DOOR
    direction = (-turn if env.layout.opens == "door_right" else turn), tilt
    camera = work_place(env.model, env.layout, direction, width / height)
    return lambda: view.colour(env.data, camera).copy()


def _is_at_work(env: Any) -> bool:
    """Whether the robot is where films from near show it."""
    x, y, _ = env.data.body(env.robot.base_body).xpos
    return math.hypot(x, y) < _FAR


def _image(env: gym.Env, observation: Any) -> Frame:
    if env.unwrapped.render_mode is not None:
        return np.asarray(env.render())
    return np.hstack([observation[name] for name in sorted(observation) if name.endswith("rgb")])


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
