"""Pictures of all layouts, or tasks of Rearrange, in one image: the whole scene, and below it the table from above.

python scripts/layout_pictures.py --out docs/images/layouts.png
python scripts/layout_pictures.py --tasks --objects 8 --out docs/images/rearrange.png
python scripts/layout_pictures.py --household --size 220 --out docs/images/household.png

With `--household` each kind of household object, alone on the table.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import tyro
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from clutter_env.envs.base import BaseEnv
from clutter_env.envs.rearrange import RearrangeEnv
from clutter_env.envs.rearrange_tasks import TASKS
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.rendering.framing import ABOVE, across, table_points, view_of, whole_scene
from clutter_env.rendering.renderer import Renderer
from clutter_env.reporting.progress import progress_bar
from clutter_env.scene.household import KINDS
from clutter_env.scene.layout import LAYOUTS
from clutter_env.scene.object_sets import capacity

Picture = NDArray[np.uint8]

AROUND_TABLE = 0.12
"""[m] around the table, so that a picture of it shows what it stands beside."""
COLUMNS = 4
"""Pictures in one row."""
LABEL_COLOUR, PAPER = (40, 44, 52), 255
GAP = 8
"""Pixels of white between two pictures."""


def main(
    objects: int = 20,
    shapes: str = "mixed",
    tasks: bool = False,
    household: bool = False,
    size: int = 440,
    seed: int = 1,
    out: Path = Path("outputs/layouts.png"),
) -> None:
    """Render every layout, or every task, join the images, save.

    Args:
        objects: Objects on every table.
        shapes: Shapes of the objects: "cylinder", "box" or "mixed"; tasks have their own.
        tasks: Show the tasks of Rearrange.
        household: Show the kinds of household objects.
        size: Pixels of one layout's, or one kind's, width.
        seed: Random seed of the scenes.
        out: File of the image.
    """
    if household:
        save_images(kind_images(seed, size), out)
        print(f"image: {out}")
        return
    images = []
    for name in progress_bar(TASKS if tasks else LAYOUTS, desc="rendering", unit="picture"):
        env: BaseEnv = (
            RearrangeEnv(num_objects=objects, task=name, render_mode="rgb_array")
            if tasks
            else RetrieveEnv(
                num_objects=min(objects, capacity(LAYOUTS[name], shapes)),
                layout=name,
                shapes=shapes,
                render_mode="rgb_array",
            )
        )
        images.append(scene_image(env, name, seed, size))
    save_images(images, out, len(images) if tasks else 3)
    print(f"image: {out}")


def scene_image(env: BaseEnv, label: str, seed: int, size: int) -> Picture:
    """A scene above its table from above: (5/4 size, size, 3).

    Raises:
        RenderingUnavailable: this machine cannot render.
    """
    env.reset(seed=seed)
    scene = whole_scene(env.model, env.layout, env.world.scene.base, across(env.layout), 4 / 3)
    table = view_of(env.model, table_points(env.layout, AROUND_TABLE), ABOVE, 2.0)
    pictures = []
    for view, height in ((scene, 3 * size // 4), (table, size // 2)):
        renderer = Renderer(env.model, size, height)
        renderer.marks = env.world.marks
        pictures.append(renderer.colour(env.data, view))
        renderer.close()
    env.close()
    page = Image.fromarray(np.vstack(pictures))
    ImageDraw.Draw(page).text((10, 8), label, fill=LABEL_COLOUR, font_size=max(page.height // 24, 8))
    return np.asarray(page)


def kind_images(seed: int, size: int) -> list[Picture]:
    """Every kind of household object without the others, its name above it: (size, size, 3) each.

    Raises:
        RenderingUnavailable: this machine cannot render.
    """
    env = RetrieveEnv(num_objects=len(KINDS) + 1, layout="island", object_set="household", render_mode="rgb_array")
    env.reset(seed=seed, options={"target": env.object_names[len(KINDS)]})  # red, whatever its kind
    renderer, colours, images = Renderer(env.model, size, size), env.model.geom_rgba.copy(), []
    renderer.has_shadows = False  # from near they are coarse
    moves = env.model.body_weldid[env.model.geom_bodyid] > 0  # the robot and all objects
    for slot, name in enumerate(KINDS):
        shown = env.model.geom_bodyid == env.model.body(env.object_names[slot]).id
        env.model.geom_rgba[:] = colours
        env.model.geom_rgba[moves & ~shown, 3] = 0.0
        camera = mujoco.MjvCamera()
        camera.lookat[:], camera.distance = env.data.body(env.object_names[slot]).xpos, 0.42
        camera.azimuth, camera.elevation = np.degrees(env.world.scene.yaws[slot]) + 205.0, -28.0
        page = Image.fromarray(renderer.colour(env.data, camera))
        ImageDraw.Draw(page).text((10, 8), name, fill=LABEL_COLOUR, font_size=max(size // 12, 8))
        images.append(np.asarray(page))
    renderer.close()
    env.close()
    return images


def save_images(images: Sequence[Picture], file: Path, most: int = COLUMNS) -> None:
    """Join images of one size in rows, so many at most in one, and save them; missing directories are made."""
    height, width = images[0].shape[:2]
    columns, rows = min(most, len(images)), -(-len(images) // most)
    page = np.full((rows * (height + GAP) - GAP, columns * (width + GAP) - GAP, 3), PAPER, np.uint8)
    for index, image in enumerate(images):
        top, left = index // most * (height + GAP), index % most * (width + GAP)
        page[top : top + height, left : left + width] = image
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(page).save(file, optimize=True)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
