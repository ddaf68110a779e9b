"""Video files, written by PyAV, which brings its own ffmpeg."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clutter_env.errors import LearningError, missing_extra

CODEC, PIXELS = "h264", "yuv420p"
_OPTIONS = {"crf": "18", "preset": "medium", "bf": "0", "g": "2"}
"""Little loss; no frame refers to a later one, and every second frame is complete, so that any one is found soon."""


class Video:
    """An mp4 file; a context.

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
        self._av, self._file = av, av.open(str(path), "w")
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
