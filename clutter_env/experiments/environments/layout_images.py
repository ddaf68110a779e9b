"""Every layout through the cameras "scene" and "top", side by side."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from clutter_env.config import SCENE_CAMERAS
from clutter_env.envs.retrieve import RetrieveEnv

__all__ = ["layout_column", "save_columns"]

LABEL_COLOUR = (40, 44, 52)


def layout_column(layout: str, objects: int, shapes: str, seed: int, size: int) -> NDArray[np.uint8]:
    """One layout through both cameras, one image above the other: (2 size, size, 3).

    Raises:
        ConfigError: an unknown layout or set of shapes, or more objects than fit.
        RenderingUnavailable: this machine cannot render.
    """
    return np.vstack([_image(layout, objects, shapes, seed, size, camera) for camera in SCENE_CAMERAS])


def _image(layout: str, objects: int, shapes: str, seed: int, size: int, camera: str) -> NDArray[np.uint8]:
    env = RetrieveEnv(
        num_objects=objects,
        layout=layout,
        shapes=shapes,
        render_mode="rgb_array",
        camera=camera,
        width=size,
        height=size,
    )
    env.reset(seed=seed)
    image = env.render()
    assert image is not None
    env.close()
    page = Image.fromarray(image)
    if camera == SCENE_CAMERAS[0]:
        ImageDraw.Draw(page).text((10, 8), layout, fill=LABEL_COLOUR, font_size=20)
    return np.asarray(page)


def save_columns(columns: Iterable[NDArray[np.uint8]], file: Path) -> None:
    """Join columns from left to right and save them; missing directories are made."""
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.hstack(list(columns))).save(file, optimize=True)
