"""An episode as a film, and as one page with an image of every grasp, lift and placement. Video files."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from clutter_env.config import CONTROL_HZ
from clutter_env.errors import LearningError, missing_extra
from clutter_env.rendering.framing import ABOVE, across, near_view, table_points, view_of, whole_scene, work_place
from clutter_env.rendering.renderer import Renderer

Frame = NDArray[np.uint8]

_SIZE, _SMALL_SIZE = (640, 480), (384, 240)
"""Width and height [pixels] of a frame's view across the table, and of the smaller views from above and of the
gripper."""
_AROUND_TABLE = 0.12
"""[m] Margin around the table in the view from above."""
STEPS_PER_FRAME = 4
"""Control steps of 0.05 s between frames. At 20 frames/s the film runs four times as fast as the robot."""
FRAMES_PER_SECOND = 20
_SPEED = STEPS_PER_FRAME * FRAMES_PER_SECOND / CONTROL_HZ
_GIF_SHARE = 2
"""A GIF, made on machines without PyAV, has 1/2 of the frames, at 1/2 of the size."""
LOOKING = "looks around"
"""Caption of a robot that looks around without a plan."""
_KEY_PHASES = (": close", ": lift", ": open", LOOKING)
"""Phases whose last state goes on the page: the grasp, the lifted object, the placed object, the look."""
_STRIP_COLUMNS = 4
_MOST_MOMENTS = 24
_STRIP_SIZE = 480, 360
_BAR = 34
"""[pixels] Height of the caption's bar."""
_INK, _PAPER = (48, 52, 59), (255, 255, 255)


@dataclass
class Film:
    """Collects frames of an environment that has been reset. Close it after use.

    Raises:
        RenderingUnavailable: when made on a machine without OpenGL.
    """

    env: Any
    frames: list[Frame] = field(default_factory=list)
    moments: list[tuple[str, Frame]] = field(default_factory=list)
    _share: int = field(default_factory=lambda: 1 if importlib.util.find_spec("av") else _GIF_SHARE)
    _steps: int = 0
    _caption: str = ""

    def __post_init__(self) -> None:
        model, layout, start = self.env.model, self.env.layout, self.env.world.scene.base
        sizes = [tuple(side // self._share for side in size) for size in (_SIZE, _SMALL_SIZE)]
        self._large, self._small = (Renderer(model, *size) for size in sizes)
        self._of_moments = Renderer(model, *_STRIP_SIZE)
        self._small.has_shadows = False  # shadows look coarse in small views
        direction, aspect = across(layout), _SIZE[0] / _SIZE[1]
        self._across = whole_scene(model, layout, start, direction, aspect)
        self._near = work_place(model, layout, direction, aspect)
        self._above = view_of(model, table_points(layout, _AROUND_TABLE), ABOVE, _SMALL_SIZE[0] / _SMALL_SIZE[1])
        self._of_gripper = near_view(direction)
        self._about = f"target {self.env.target}, red" if self.env.target else ""

    def watch(self, caption: str) -> None:
        """Record the state after a control step. The ends of the phases in `_KEY_PHASES` go on the page."""
        if caption != self._caption and self._caption.endswith(_KEY_PHASES):
            self._keep_moment()
        self._caption = caption or self._caption
        if self._steps % (STEPS_PER_FRAME * self._share) == 0:
            self._keep_frame()
        self._steps += 1

    def finish(self, caption: str) -> None:
        """Record the last state. The film shows it for a second."""
        self._caption = caption
        self._keep_moment()
        self._keep_frame()
        self.frames += self.frames[-1:] * (FRAMES_PER_SECOND // self._share)

    def save_strip(self, path: Path) -> None:
        """Save the recorded moments on one page. Of more than `_MOST_MOMENTS`, it shows evenly spaced moments and the
        last."""
        chosen = np.unique(np.linspace(0, len(self.moments) - 1, _MOST_MOMENTS).round().astype(int))
        tiles = [_tile(*self.moments[index]) for index in chosen]
        columns = min(_STRIP_COLUMNS, len(tiles))
        blank = np.full_like(tiles[0], 255)
        tiles += [blank] * (-len(tiles) % columns)
        rows = [np.hstack(tiles[start : start + columns]) for start in range(0, len(tiles), columns)]
        Image.fromarray(np.vstack(rows)).save(path, optimize=True)

    def save_film(self, stem: Path) -> Path:
        """Save an mp4 if PyAV is installed (extra [data]), otherwise a GIF. Return its path."""
        if self._share == 1:
            path = stem.with_suffix(".mp4")
            with Video(path, self.frames[0].shape[:2], FRAMES_PER_SECOND) as video:
                video.write(self.frames)
            return path
        path = stem.with_suffix(".gif")
        save_gif(self.frames, path, 1000 * _GIF_SHARE // FRAMES_PER_SECOND)
        return path

    def close(self) -> None:
        """Free the graphics."""
        for renderer in (self._large, self._small, self._of_moments):
            renderer.close()

    def _keep_moment(self) -> None:
        self.moments.append((self._caption, self._of_moments.colour(self.env.data, self._near)))

    def _keep_frame(self) -> None:
        self._of_gripper.lookat[:] = self.env.data.site_xpos[self.env.world.index.tcp_site]
        small = [self._small.colour(self.env.data, view) for view in (self._above, self._of_gripper)]
        picture = np.hstack([self._large.colour(self.env.data, self._across), np.vstack(small)])
        said = f"{self._about}   {_SPEED:.0f}x speed".strip()
        self.frames.append(_captioned(picture, self._caption, said))


def _captioned(picture: Frame, caption: str, said: str) -> Frame:
    """The picture with a bar under it: the current action on the left, a text for the whole film on the right."""
    height, width = picture.shape[:2]
    page = Image.new("RGB", (width, height + _BAR), _PAPER)
    page.paste(Image.fromarray(picture), (0, 0))
    draw, font = ImageDraw.Draw(page), ImageFont.load_default(max(12, width // 64))
    draw.text((12, height + 8), caption, fill=_INK, font=font)
    draw.text((width - 12, height + 8), said, fill=_INK, font=font, anchor="ra")
    return np.asarray(page)


def _tile(caption: str, picture: Frame) -> Frame:
    """A moment for the strip: a smaller picture with its caption and a white frame."""
    width, height = _STRIP_SIZE
    page = Image.new("RGB", (width + 8, height + 8 + _BAR), _PAPER)
    page.paste(Image.fromarray(picture), (4, 4))
    ImageDraw.Draw(page).text((8, height + 10), caption, fill=_INK, font=ImageFont.load_default(14))
    return np.asarray(page)


def save_gif(images: Sequence[Frame], path: Path, milliseconds: int, comment: str = "") -> None:
    """Write a film with one palette for all frames. A palette for each frame would take most of the time.

    `comment` is kept in the file. It can say what the film was made from.
    """
    # Of three frames side by side, so that a target that is hidden in some of them keeps its colour.
    palette = Image.fromarray(np.hstack([images[0], images[len(images) // 2], images[-1]])).quantize()
    frames = [Image.fromarray(image).quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    about: dict[str, Any] = {"comment": comment.encode()} if comment else {}
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=milliseconds, loop=0, optimize=True, **about)


CODEC, PIXELS = "h264", "yuv420p"
_OPTIONS = {"crf": "18", "preset": "medium", "bf": "0", "g": "2"}
"""High quality. Every second frame is complete and none refers to a later frame, so any frame is found quickly."""


class Video:
    """An mp4 file, used as a context manager.

    Attributes:
        frames: number of images that have been written.

    Raises:
        LearningError: PyAV is not installed, or a side of the image has an odd number of pixels.
    """

    def __init__(self, path: Path, size: Sequence[int], fps: int) -> None:
        if any(side % 2 for side in size):
            raise LearningError(f"images of {size[0]} x {size[1]} pixels do not fit a video; take even numbers")
        try:
            import av  # an optional dependency
        except ModuleNotFoundError as problem:
            raise LearningError(missing_extra(problem) or str(problem)) from problem
        path.parent.mkdir(parents=True, exist_ok=True)
        # Unbuffered, so that the file's size is that of the images so far.
        self._av, self._file = av, av.open(str(path), "w", options={"flush_packets": "1"})
        self._stream = self._file.add_stream("libx264", rate=fps, options=dict(_OPTIONS))
        self._stream.height, self._stream.width = size
        self._stream.pix_fmt = PIXELS
        self.frames = 0

    def __enter__(self) -> Video:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self._file.mux(self._stream.encode())
        self._file.close()

    def write(self, images: Iterable[NDArray[np.uint8]]) -> None:
        """Append images (n, height, width, 3)."""
        for image in images:
            frame = self._av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
            frame.pts = self.frames
            self._file.mux(self._stream.encode(frame))
            self.frames += 1
