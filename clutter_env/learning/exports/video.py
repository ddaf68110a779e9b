"""Videos of camera images, one frame a control step, for random access."""

from __future__ import annotations

import importlib
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clutter_env.learning.errors import LearningError

__all__ = ["Video"]

CODEC, PIXELS = "h264", "yuv420p"
_OPTIONS = {"crf": "18", "preset": "medium", "bf": "0", "g": "2"}
"""Little loss; no frame refers to a later one, and every second frame is complete, so that any one is found soon."""


class Video:
    """An mp4 file; use it as a context.

    Attributes:
        frames: how many have been written.
    """

    def __init__(self, path: Path, size: tuple[int, int], fps: int) -> None:
        """Start the file.

        Args:
            path: of the file; its directory is made.
            size: height and width of an image, even numbers.
            fps: frames a second.

        Raises:
            LearningError: PyAV is not installed, or a size is odd.
        """
        if any(side % 2 for side in size):
            raise LearningError(f"images of {size[0]} x {size[1]} pixels do not fit a video; take even numbers")
        try:
            self._av: Any = importlib.import_module("av")
        except ImportError as problem:
            raise LearningError("videos need PyAV; pip install 'clutter-env[data]'") from problem
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = self._av.open(str(path), "w")
        self._stream = self._file.add_stream("libx264", rate=fps, options=dict(_OPTIONS))
        self._stream.height, self._stream.width = size
        self._stream.pix_fmt = PIXELS
        self.frames = 0

    def __enter__(self) -> Video:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self._file.mux(self._stream.encode())
        self._file.close()

    def write(self, images: Iterable[NDArray[np.uint8]]) -> None:
        """Append images (height, width, 3)."""
        for image in images:
            frame = self._av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
            frame.pts = self.frames
            self._file.mux(self._stream.encode(frame))
            self.frames += 1
