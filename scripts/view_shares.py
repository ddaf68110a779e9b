"""What the head camera's image shows at reset and along the expert's path: the robot itself, the target, the objects.

    python scripts/view_shares.py
    python scripts/view_shares.py --robots fetch --home 0.25 0 -1.02 0 2.12 0 -1.1 0

Prints the tables of docs/environments/cameras.md. There is one ray through the middle of each pixel, so no renderer is
needed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import gymnasium as gym
import mujoco
import numpy as np
import tyro
from numpy.typing import NDArray

import clutter_env  # noqa: F401  registers the environments
from assets import RobotSpec
from assets.robots import robot as find_robot
from clutter_env.errors import UsageError
from clutter_env.policies.playing import played
from clutter_env.reporting.progress import progress_bar
from clutter_env.reporting.tables import markdown_table
from planners import TampExpert

_CAMERA = "head"
_DRAWN = np.array((1, 1, 1, 0, 0, 0), np.uint8)
"""Groups of geoms that MuJoCo draws by default."""
_EVERY = 10
"""Control steps between two images along a path: half a second."""
_SHARES = ("robot", "target")
_HEAD = ("robot", "layout", "arm in the image", "target seen", "target's pixels", "objects seen")


@dataclass(frozen=True)
class Arguments:
    """Which scenes to look at."""

    robots: tuple[str, ...] = ("fetch", "pr2", "panda_mobile")
    """Names of robots."""
    layouts: tuple[str, ...] = ("paper", "wide", "dense", "shelf", "two_boards", "cabinet", "island")
    """Names of layouts."""
    home: tuple[float, ...] = ()
    """Torso [m] and arm [rad] in place of the home configuration, for one robot."""
    objects: int = 10
    """Objects in a scene."""
    scenes: int = 20
    """Scenes whose first image is looked at."""
    paths: int = 5
    """Scenes that the expert plays, the first ones."""
    size: int = 96
    """Pixels along each side of an image."""
    seed: int = 0
    """Of the first scene."""


class View(NamedTuple):
    """Shares of an image that show the robot, the target, and each object (n,)."""

    robot: float
    target: float
    objects: NDArray[np.float64]


def main(arguments: Arguments) -> None:
    """Look at all scenes, and print a table of the first images and one of those along the expert's paths."""
    if arguments.home and len(arguments.robots) != 1:
        raise UsageError(f"--home is that of one robot; --robots names {len(arguments.robots)}")
    cases = [(name, layout) for name in arguments.robots for layout in arguments.layouts]
    first, later = [], []
    for name, layout in progress_bar(cases, total=len(cases), unit="layout"):
        robot = find_robot(name)
        robot = replace(robot, home=arguments.home) if arguments.home else robot
        starts, paths = views(robot, layout, arguments)
        first.append((name, layout, *_summary([starts])))
        if paths:
            later.append((name, layout, *_summary(paths)))
    print(f"At reset, {arguments.scenes} scenes of {arguments.objects} objects:\n")
    print(markdown_table(_HEAD, first))
    if later:
        print(f"Along the expert's path, {arguments.paths} scenes, an image every {_EVERY} steps:\n")
        print(markdown_table(_HEAD, later))


def views(robot: RobotSpec, layout: str, arguments: Arguments) -> tuple[list[View], list[list[View]]]:
    """The first images of all scenes, and the images along the path of each scene that the expert plays."""
    env: Any = gym.make(
        f"clutter_env/Retrieve-o{arguments.objects}-v0", robot=robot, layout=layout, disable_env_checker=True
    )
    starts, paths = [], []
    for number in range(arguments.scenes):
        env.reset(seed=arguments.seed + number)
        starts.append(view(env.unwrapped, arguments.size))
        if number < arguments.paths:
            paths.append(_path(env, arguments.size))
    env.close()
    return starts, [path for path in paths if path]


def view(env: Any, size: int) -> View:
    """What an image of the head camera with `size` pixels on each side shows now."""
    model, data, index = env.model, env.data, env.world.index
    mujoco.mj_camlight(model, data)  # a step leaves cameras where it started
    camera, count = model.camera(_CAMERA).id, size * size
    across = (2 * np.arange(size) + 1 - size) / size * math.tan(math.radians(model.cam_fovy[camera]) / 2)
    u, v = (grid.ravel() for grid in np.meshgrid(across, across))
    rays = np.column_stack((u, v, -np.ones(count))) @ data.cam_xmat[camera].reshape(3, 3).T
    found, distance = np.empty(count, np.int32), np.empty(count)
    eye, flat = data.cam_xpos[camera], np.ascontiguousarray(rays.ravel())
    inside = int(model.cam_bodyid[camera])
    mujoco.mj_multiRay(model, data, eye, flat, _DRAWN, True, inside, found, distance, None, count, mujoco.mjMAXVAL)
    met = found[found >= 0]
    is_robot = model.body_rootid[model.geom_bodyid[met]] == model.body_rootid[index.base_body]
    first = index.object_geoms.start
    is_object = (met >= first) & (met < first + len(index.geom_slots))
    objects = np.bincount(index.geom_slots[met[is_object] - first], minlength=len(env.world.names)) / count
    return View(float(is_robot.sum() / count), float(objects[env.target_slot]), objects)


def _path(env: Any, size: int) -> list[View]:
    """Images while the expert takes the target out; none where it finds no plan."""
    expert = TampExpert(env)
    expert.reset()
    steps = enumerate(played(expert, env.step), start=1)
    return [view(env.unwrapped, size) for number, _ in steps if number % _EVERY == 0]


def _summary(groups: list[list[View]]) -> tuple[str, ...]:
    """Mean share of the robot, images in which the target is seen, its mean share, share of objects that are seen.

    Of paths, each of which counts alike; of the images at reset, one group, their number is said.
    """
    robot, target = (np.mean([np.mean([getattr(one, name) for one in group]) for group in groups]) for name in _SHARES)
    seen = [sum(one.target > 0 for one in group) for group in groups]
    objects = np.mean([np.mean([(one.objects > 0).mean() for one in group]) for group in groups])
    share = np.mean([count / len(group) for count, group in zip(seen, groups, strict=True)])
    often = f"{seen[0]} of {len(groups[0])}" if len(groups) == 1 else f"{share:.0%}"
    return f"{robot:.0%}", often, f"{target:.2%}", f"{objects:.0%}"


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
