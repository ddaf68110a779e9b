"""What the robots' cameras give, as a picture; and how many steps with images a CPU second allows."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np
import tyro
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Patch
from matplotlib.ticker import MultipleLocator
from numpy.typing import NDArray

import clutter_env  # noqa: F401  registers the environments

_ID = "clutter_env/Retrieve-o15-v0"
_KINDS: dict[str, dict[str, Any]] = {
    "state": {},
    "rgbd": {"obs_mode": "rgbd"},
    "rgbd, segmentation": {"obs_mode": "rgbd", "segmentation": True},
    "pointcloud": {"obs_mode": "pointcloud"},
    "rgbd, segmentation, head alone": {"obs_mode": "rgbd", "segmentation": True, "cameras": ("head",)},
}
_ROBOTS = {"fetch": "Fetch", "pr2": "PR2", "panda_mobile": "Panda"}
_COLOURS, _MEANINGS = (
    ((0.93, 0.93, 0.93), (0.35, 0.35, 0.35), (0.80, 0.70, 0.55)),
    ("ground and sky", "robot", "furniture"),
)
"""Of the first three values of a segmentation."""
_FARTHEST = 2.5
"""[m] White in the picture of depths."""
_BLOCKS, _BLOCK = 25, 12


def main(out: Path = Path("docs/images/cameras.png"), seed: int = 1, speed: bool = False) -> None:
    """Draw the views of each robot's head, or measure.

    Args:
        out: The picture.
        seed: Of the scene.
        speed: Measure steps with images of 128 x 128 pixels instead.
    """
    if speed:
        measure()
        return
    figure = plt.figure(figsize=(14, 12), layout=ConstrainedLayoutEngine(h_pad=0.2))
    for row, (robot, name) in enumerate(_ROBOTS.items()):
        observation, points, colours = views(robot, seed)
        segments = observation["head_segmentation"][..., 0]
        shown = {
            f"{name}: colour": observation["head_rgb"],
            "segmentation": palette(segments),
            "depth [m]": observation["head_depth"][..., 0],
        }
        for column, (title, image) in enumerate(shown.items()):
            axes = figure.add_subplot(3, 4, 4 * row + column + 1)
            drawn = axes.imshow(image, cmap="gray", vmin=0, vmax=_FARTHEST if title == "depth [m]" else None)
            axes.set_title(title, fontsize=13)
            axes.axis("off")
            if title == "depth [m]":
                figure.colorbar(drawn, ax=axes, shrink=0.7, extend="max")
        cloud = figure.add_subplot(3, 4, 4 * row + 4, projection="3d")
        kept = (points[:, 0] < 2.2) & (np.abs(points[:, 1]) < 1.2)
        cloud.scatter(*points[kept].T, c=colours[kept] / 255, s=1.2, depthshade=False)
        cloud.view_init(25, -125)
        cloud.set_box_aspect(np.ptp(points[kept], axis=0))
        cloud.set_title("points of all its cameras", fontsize=13)
        for axis, label in ((cloud.xaxis, "x [m]"), (cloud.yaxis, "y [m]"), (cloud.zaxis, "z [m]")):
            axis.set_label_text(label)
            axis.set_major_locator(MultipleLocator(0.5))
    kinds = [Patch(color=colour, label=label) for colour, label in zip(_COLOURS, _MEANINGS, strict=True)]
    figure.legend(
        handles=kinds,
        title="segmentation; every object has a colour of its own",
        loc="outside lower center",
        ncols=3,
        fontsize=13,
        title_fontsize=13,
    )
    figure.savefig(out, dpi=80)
    print(out)


def views(robot: str, seed: int) -> tuple[dict[str, Any], NDArray[Any], NDArray[Any]]:
    """Images at the start, and the cloud: points, colours."""
    found = []
    kinds: tuple[dict[str, Any], ...] = (_KINDS["rgbd, segmentation"], {"obs_mode": "pointcloud", "num_points": 8192})
    for keywords in kinds:
        env: Any = gym.make(_ID, robot=robot, image_size=256, **keywords).unwrapped
        observation, _ = env.reset(seed=seed)
        found.append(observation)
        env.close()
    return found[0], found[1]["points"], found[1]["point_rgb"]


def palette(segments: NDArray[np.uint8]) -> NDArray[np.float64]:
    """A colour for every value of a segmentation."""
    colours = np.vstack((_COLOURS, plt.colormaps["hsv"](np.arange(60) * 97 % 256)[:, :3]))
    return np.asarray(colours[segments])


def measure() -> None:
    """Steps per CPU second (of all threads, the renderer's too), kinds in turn: the median of blocks, and the best."""
    for robot in _ROBOTS:
        envs = {
            name: gym.make(_ID, robot=robot, **{**keywords, "image_size": 128}) for name, keywords in _KINDS.items()
        }
        rng = np.random.default_rng(0)
        size = (_BLOCK, *(envs["state"].action_space.shape or ()))
        actions = rng.uniform(-0.3, 0.3, size)
        spent: dict[str, list[float]] = {name: [] for name in envs}
        for block in range(_BLOCKS):
            for name, env in envs.items():
                env.reset(seed=block)
                env.step(actions[0])
                start = time.process_time()
                for action in actions:
                    env.step(action)
                spent[name].append((time.process_time() - start) / _BLOCK)
        for name, times in spent.items():
            print(f"{robot:13s} {name:32s} {1 / np.median(times):6.0f} median, {1 / min(times):6.0f} best")
        for env in envs.values():
            env.close()


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
