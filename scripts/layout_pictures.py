"""Pictures of all layouts in one image: each one's whole scene, and below it its table from above.

python scripts/layout_pictures.py --out docs/images/layouts.png
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import tyro
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.rendering.framing import ABOVE, across, whole_scene, whole_table
from clutter_env.rendering.renderer import Renderer
from clutter_env.reporting.progress import progress_bar
from clutter_env.scene.layout import LAYOUTS

Picture = NDArray[np.uint8]

COLUMNS = 4
"""Layouts in one row."""
LABEL_COLOUR, PAPER = (40, 44, 52), 255
GAP = 8
"""Pixels of white between two layouts."""


def main(
    objects: int = 20, shapes: str = "mixed", size: int = 440, seed: int = 1, out: Path = Path("outputs/layouts.png")
) -> None:
    """Render every layout, join the images, save.

    Args:
        objects: Objects on every table.
        shapes: Shapes of the objects: "cylinder", "box" or "mixed".
        size: Pixels of one layout's width.
        seed: Random seed of the scenes.
        out: File of the image.
    """
    layouts = progress_bar(LAYOUTS, desc="rendering", unit="layout")
    save_images([layout_image(layout, objects, shapes, seed, size) for layout in layouts], out)
    print(f"image: {out}")


def layout_image(layout: str, objects: int, shapes: str, seed: int, size: int) -> Picture:
    """One layout: its scene, as wide as high, above its table, twice as wide as high: (3/2 size, size, 3).

    Raises:
        ConfigError: an unknown layout or set of shapes, or more objects than fit.
        RenderingUnavailable: this machine cannot render.
    """
    env = RetrieveEnv(num_objects=objects, layout=layout, shapes=shapes, render_mode="rgb_array")
    env.reset(seed=seed)
    views = ((whole_scene, across(env.layout), size, size), (whole_table, ABOVE, size, size // 2))
    pictures = []
    for view, direction, width, height in views:
        renderer = Renderer(env.model, width, height)
        pictures.append(renderer.colour(env.data, view(env.model, env.layout, direction, width / height)))
        renderer.close()
    env.close()
    page = Image.fromarray(np.vstack(pictures))
    ImageDraw.Draw(page).text((10, 8), layout, fill=LABEL_COLOUR, font_size=max(page.height // 24, 8))
    return np.asarray(page)


def save_images(images: Sequence[Picture], file: Path) -> None:
    """Join images of one size in rows and save them; missing directories are made."""
    height, width = images[0].shape[:2]
    columns, rows = min(COLUMNS, len(images)), -(-len(images) // COLUMNS)
    page = np.full((rows * (height + GAP) - GAP, columns * (width + GAP) - GAP, 3), PAPER, np.uint8)
    for index, image in enumerate(images):
        top, left = index // COLUMNS * (height + GAP), index % COLUMNS * (width + GAP)
        page[top : top + height, left : left + width] = image
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(page).save(file, optimize=True)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
