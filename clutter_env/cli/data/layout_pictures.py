"""One image of every layout: the whole scene, and the table from above."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from clutter_env.experiments.environments.layout_images import layout_image, save_images
from clutter_env.reporting.command import run_command
from clutter_env.reporting.progress import progress_bar
from clutter_env.scene.layout import LAYOUTS


@dataclass(frozen=True)
class Arguments:
    """Command line."""

    objects: int = 20
    """Objects on every table."""
    shapes: str = "mixed"
    """Shapes of the objects: "cylinder", "box" or "mixed"."""
    size: int = 440
    """Pixels of one layout's width."""
    seed: int = 1
    """Random seed of the scenes."""
    out: Path = Path("outputs/layouts.png")
    """File of the image."""


def run(arguments: Arguments) -> None:
    """Render every layout, join the images, save."""
    images = [
        layout_image(layout, arguments.objects, arguments.shapes, arguments.seed, arguments.size)
        for layout in progress_bar(LAYOUTS, desc="rendering", unit="layout")
    ]
    save_images(images, arguments.out)
    print(f"image: {arguments.out}")


def main(words: Sequence[str] | None = None) -> None:
    """Run the command; `words` are its arguments, those of the process if not given."""
    run_command("layout_pictures", Arguments, run, __doc__, words)
