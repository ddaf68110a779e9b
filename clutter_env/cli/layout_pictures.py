"""One picture of every layout, seen by the cameras "scene" and "top"."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from tqdm import tqdm

from clutter_env.cli.command import run_command
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.scene.layout import LAYOUTS

LABEL_COLOUR = (40, 44, 52)


@dataclass(frozen=True)
class Arguments:
    """Command line."""

    objects: int = 20
    shapes: str = "mixed"
    size: int = 360
    """Pixels along each side of one picture."""
    seed: int = 1
    output: Path = Path("docs/images/layouts.png")


def picture(layout: str, camera: str, arguments: Arguments) -> NDArray[np.uint8]:
    """One layout through one camera, (size, size, 3)."""
    env = RetrieveEnv(
        num_objects=arguments.objects,
        layout=layout,
        shapes=arguments.shapes,
        render_mode="rgb_array",
        camera=camera,
        width=arguments.size,
        height=arguments.size,
    )
    env.reset(seed=arguments.seed)
    drawn = env.render()
    assert drawn is not None
    env.close()
    image = Image.fromarray(drawn)
    if camera == "scene":
        ImageDraw.Draw(image).text((10, 8), layout, fill=LABEL_COLOUR, font_size=20)
    return np.asarray(image)


def run(arguments: Arguments) -> None:
    """Draw, join, save."""
    columns = [
        np.vstack([picture(layout, camera, arguments) for camera in ("scene", "top")])
        for layout in tqdm(LAYOUTS, desc="drawing", unit="layout")
    ]
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.hstack(columns)).save(arguments.output, optimize=True)
    print(f"picture: {arguments.output}")


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("layout_pictures", Arguments, run, __doc__, words)
