"""Scenes of Search in which a rendered image shows a pixel of the target at the start, and the time a scene takes.

    python scripts/hidden_targets.py

Prints the table of docs/notes/environments.md. The images are those of the observed camera, with the robot left out.
"""

from __future__ import annotations

import time

import numpy as np
import tyro

from clutter_env.envs.reset_options import ResetOptions
from clutter_env.envs.search import SearchEnv
from clutter_env.rendering.cameras import FIRST_OBJECT, FURNITURE
from clutter_env.rendering.renderer import Renderer
from clutter_env.reporting.progress import progress_bar
from clutter_env.reporting.tables import markdown_table

SETS = {("cabinet", 12): 300, ("shelf", 10): 200, ("two_boards", 12): 100}
"""Numbers of scenes, by layout and number of objects."""
HEAD = ("scenes", "number", "with a pixel of the target", "CPU time of a scene [ms]", "slowest [ms]")


def main(seed: int = 8_200_000, share: float = 1.0) -> None:
    """Draw the scenes one after the other, render each, and print the table.

    Args:
        seed: Of the first scene of each set.
        share: Share of the scenes that is drawn.
    """
    rows = []
    for (layout, objects), count in SETS.items():
        pixels, times = look(layout, objects, seed, round(share * count))
        name = f"{layout}, {objects} objects"
        rows.append(
            (name, str(len(pixels)), str(np.count_nonzero(pixels)), f"{times.mean():.1f}", f"{times.max():.1f}")
        )
    print(markdown_table(HEAD, rows), end="")


def look(layout: str, objects: int, seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of the target (count,), and CPU times [ms] to draw each scene (count,)."""
    env = SearchEnv(num_objects=objects, layout=layout)
    env.reset(seed=seed)
    size, geoms, slots = env.config.image_size, env.world.index.object_geoms, env.world.index.geom_slots
    renderer = Renderer(env.model, size, size)
    renderer._option.geomgroup[1:] = 0  # the groups of the robot
    pixels, times = np.zeros(count, int), np.zeros(count)
    for number in progress_bar(range(count), total=count, unit="scene"):
        start = time.process_time()
        env._start(env._draw_scene(ResetOptions()))  # a reset without its image
        times[number] = 1000 * (time.process_time() - start)
        labels = np.full(env.model.ngeom, FURNITURE, np.uint8)
        labels[geoms.start + slots.searchsorted(env.target_slot)] = FIRST_OBJECT
        for camera in env.config.observed_cameras:
            _, _, found = renderer.camera_images(env.data, camera, labels)
            pixels[number] += np.count_nonzero(found == FIRST_OBJECT)
    renderer.close()
    env.close()
    return pixels, times


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
