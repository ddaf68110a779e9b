"""The film on the first page: one recorded episode, its actions played again, with the moved objects marked.

    python scripts/front_page.py

The episode is one of results/side-15-v3_lookahead.json.xz, so nothing is planned. The film holds the digest of that
file, and a test compares them. It takes a minute.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import tyro
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from clutter_env.config import CONTROL_HZ
from clutter_env.evaluation.recording import Recording
from clutter_env.evaluation.verify import claimed, read_results, scenes_of
from clutter_env.rendering.film import Frame, save_gif
from clutter_env.rendering.framing import pixels_of, table_points, view_of
from clutter_env.rendering.renderer import Renderer
from clutter_env.scene.layout import TABLE_HEIGHT
from clutter_env.simulation.world import Mark

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "results" / "side-15-v3_lookahead.json.xz"
FILM = ROOT / "docs" / "images" / "front_page.gif"
EPISODE = 44
"""An episode in which two objects are moved, so that there is an order, and the target is seen throughout."""

_SIZE, _BAR = (640, 384), 40
"""Width and height [pixels] of the picture, and height of the bar with the text above it."""
_DIRECTION = (66.0, -36.0)
"""[deg] Azimuth and elevation of the camera."""
_FRAMES_PER_SECOND, _STEPS_PER_FRAME = 10, 8
"""Eight steps of 0.05 s a frame: four times the robot's speed."""
_FIRST_S, _LAST_S = 2.5, 4.0
"""How long the question and the answer stay."""
_STAYS, _MOVES, _TARGET = (0.80, 0.81, 0.82, 1.0), (0.95, 0.60, 0.10, 1.0), (0.85, 0.08, 0.08, 1.0)
"""Colours of the objects that stay, of those that are moved, and of the target."""
_INK, _PAPER = (33, 37, 43), (255, 255, 255)
_LABEL_RADIUS = 13
"""[pixels] of the disc with an object's number."""
_ABOVE = 0.15
"""[m] Height of the disc over an object's centre."""
_HAND_SPACE = np.array(((-0.62, 0.0, 1.25), (-0.62, 0.4, 1.25), (0.0, 0.0, 1.3)))
"""[m] Points that are in view too, in front of the table and above it, so that the arm is seen at work."""
_PAD = 0.035
"""[m] Half side of the mark where an object will be put down."""


@dataclass(frozen=True)
class Episode:
    """A recorded episode, played again.

    Attributes:
        env: the environment, at the end of the episode.
        states: (steps + 1, n) joint positions.
        moved: slots of the objects that were carried, in order, without the target.
        ends: the number of the state in which each of them was put down.
        bound: the lower bound of the suite, which is proved.
    """

    env: Any
    states: NDArray[np.float64]
    moved: tuple[int, ...]
    ends: tuple[int, ...]
    bound: int


def main(out: Path = FILM) -> None:
    """Play the episode again and write the film."""
    content = read_results(RESULTS)
    episode = play_again(content, EPISODE)
    save_gif(frames(episode), out, 1000 // _FRAMES_PER_SECOND, json.dumps({RESULTS.name: content["digest"]}))
    print(f"{out}: {out.stat().st_size / 1e6:.2f} MB; {answer(len(episode.moved), episode.bound)}")


def answer(moved: int, bound: int) -> str:
    """The film's last sentence."""
    assert moved == bound, "the episode is one of fewest moves"
    return f"{moved} moved, {bound} is the proved minimum"


def play_again(content: Any, index: int) -> Episode:
    """The states of a recorded episode, and what was moved in it."""
    scene = scenes_of(content).scenes[index]
    env = scene.make(control_mode="joint", render_mode="rgb_array")
    states: list[NDArray[np.float64]] = []
    carried: dict[int, int] = {}

    def watch(env: Any, _policy: Any) -> None:
        world = env.unwrapped
        states.append(world.data.qpos.copy())
        carried.update(dict.fromkeys(world.measurements.grip.carried, len(states)))

    Recording.from_json(content["recordings"][index]).replay(scene, env, watch)
    inner: Any = env.unwrapped
    moved = tuple(slot for slot in carried if slot != inner.target_slot)
    bound = claimed(RESULTS).floors[index]
    assert bound.is_proved
    assert bound.count is not None
    return Episode(inner, np.array(states), moved, tuple(carried[slot] for slot in moved), bound.count)


def frames(episode: Episode) -> list[Frame]:
    """The film: the question over the first state, the episode, the answer over the last state."""
    env, count = episode.env, len(episode.moved)
    _colour(env, episode.moved)
    renderer, data = Renderer(env.model, *_SIZE), mujoco.MjData(env.model)
    points = np.vstack((table_points(env.layout), _HAND_SPACE))
    camera = view_of(env.model, points, _DIRECTION, _SIZE[0] / _SIZE[1])
    renderer.marks = _destinations(episode)

    def frame(number: int, text: str) -> Frame:
        data.qpos[:] = episode.states[number]
        mujoco.mj_forward(env.model, data)
        return _labelled(renderer.colour(data, camera), _places(env, data, camera, episode.moved), text)

    question = frame(0, "Take the red object. What must move first, in which order, where to?")
    film = [question] * round(_FIRST_S * _FRAMES_PER_SECOND)
    for number in range(0, len(episode.states), _STEPS_PER_FRAME):
        done = sum(number >= end for end in episode.ends)
        film.append(frame(number, f"{done} of {count} moved" if done < count else f"{count} moved, the way is free"))
    last = frame(len(episode.states) - 1, f"Taken. {answer(count, episode.bound)}.")
    renderer.close()
    speed = _STEPS_PER_FRAME * _FRAMES_PER_SECOND / CONTROL_HZ
    assert speed == round(speed)
    return [*film, *[last] * round(_LAST_S * _FRAMES_PER_SECOND)]


def _destinations(episode: Episode) -> tuple[Mark, ...]:
    """Squares on the table where the moved objects are at the end."""
    env = episode.env
    ends = env.measurements.poses[list(episode.moved), :2]
    colour, half = np.array((*_MOVES[:3], 0.6)), np.full(2, _PAD)
    return tuple(Mark(np.array((x, y, TABLE_HEIGHT)), half, 0.0, colour) for x, y in ends)


def _colour(env: Any, moved: tuple[int, ...]) -> None:
    """Give the objects the film's colours."""
    index = env.world.index
    colours = env.model.geom_rgba[index.object_geoms]
    colours[:] = _STAYS
    colours[np.isin(index.geom_slots, moved)] = _MOVES
    colours[index.geom_slots == env.target_slot] = _TARGET


def _places(
    env: Any, data: mujoco.MjData, camera: mujoco.MjvCamera, moved: tuple[int, ...]
) -> list[tuple[float, float]]:
    """Pixels over the moved objects, in order."""
    index = env.world.index
    first = index.object_geoms.start + np.searchsorted(index.geom_slots, moved)
    places = pixels_of(env.model, camera, data.geom_xpos[first] + (0.0, 0.0, _ABOVE), _SIZE)
    return [(float(x), max(float(y), _LABEL_RADIUS)) for x, y in places]


def _labelled(picture: Frame, places: list[tuple[float, float]], text: str) -> Frame:
    """The picture under a bar with the text, and the number of each moved object over it."""
    page = Image.new("RGB", (_SIZE[0], _SIZE[1] + _BAR), _PAPER)
    page.paste(Image.fromarray(picture), (0, _BAR))
    draw, radius = ImageDraw.Draw(page), _LABEL_RADIUS
    draw.text((12, _BAR // 2), text, fill=_INK, font=ImageFont.load_default(19), anchor="lm")
    for number, (x, y) in enumerate(places, start=1):
        middle = (x, y + _BAR)
        draw.ellipse((x - radius, middle[1] - radius, x + radius, middle[1] + radius), fill=_INK)
        draw.text(middle, str(number), fill=_PAPER, font=ImageFont.load_default(17), anchor="mm")
    return np.asarray(page)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
