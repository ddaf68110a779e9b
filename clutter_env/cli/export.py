"""Write demonstrations in the format of another tool.

    clutter-env export --demos outputs/demos/o15 --to lerobot --out outputs/lerobot/o15 --image-size 96

The demonstrations are those of `clutter-env collect`. Of LIBERO's tasks they are one file:

    clutter-env export --demos outputs/demos/libero_goal_4_demo.hdf5 --to lerobot --out outputs/lerobot/libero_goal_4
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

_EPISODE_S, _RENDERED_S = 0.02, 1.5
"""[s] of CPU time of an episode with 15 objects, without images and with such of 96 pixels that are rendered."""


@dataclass(frozen=True)
class Arguments:
    """Export demonstrations."""

    to: Literal["lerobot", "minari", "hdf5", "robomimic"]
    """"lerobot" (format v3.0) and "minari" are directories. "hdf5" (one group an episode) and "robomimic" are files."""
    demos: tuple[Path, ...]
    """Directories that `clutter-env collect` made, which differ only in their seeds. All of them become one dataset. Or
    one file of a task of LIBERO."""
    out: Path | None = None
    """Directory or file to write. By default outputs/exports/FORMAT, and ….hdf5 for a file. It must not exist."""
    observations: Literal["images", "state", "environment_state", ""] = ""
    """Inputs of policies that learn from it, for LeRobot. "images": images and the robot's own state, without exact
    poses. "state": one vector of everything. "environment_state": the robot's state, and apart from it all poses. Empty
    for "images" where there are any, else "environment_state"."""
    image_size: int = 0
    """Pixels along each side of camera images, for LeRobot, rendered from the episodes' states. 0: those collected."""
    cameras: tuple[str, ...] = ()
    """Those whose images are rendered, for example "--cameras top gripper" ("top" looks down at the table). The robot's
    own if none is named."""
    workers: int = 2
    """Number of processes that render images."""
    json: Path | None = None
    """Write where the export is, and its size, to this file."""


def run(arguments: Arguments) -> None:
    """Export, and print the paths written."""
    from clutter_env.data.dataset import Shards
    from clutter_env.data.hdf5 import export_hdf5
    from clutter_env.data.lerobot import export_lerobot
    from clutter_env.data.minari import export_minari
    from clutter_env.errors import LearningError
    from clutter_env.reporting.progress import progress_bar

    if (arguments.image_size or arguments.observations or arguments.cameras) and arguments.to != "lerobot":
        raise LearningError(
            f"--image-size, --cameras and --observations are for --to lerobot; for {arguments.to} collect images: "
            "clutter-env collect --obs-mode rgbd"
        )
    if not arguments.demos:
        raise LearningError("--demos names no directory")
    if len(arguments.demos) == 1 and arguments.demos[0].is_file():
        _export_libero(arguments)
        return
    dataset = Shards.of(arguments.demos)
    if not (episodes := len(dataset)):
        raise LearningError(f"{', '.join(map(str, arguments.demos))}: no episodes")
    suffix = ".hdf5" if arguments.to in ("hdf5", "robomimic") else ""
    out = arguments.out or Path("outputs/exports") / f"{arguments.to}{suffix}"
    out.parent.mkdir(parents=True, exist_ok=True)
    if arguments.to == "lerobot":
        seconds = episodes * (_RENDERED_S / arguments.workers if arguments.image_size else _EPISODE_S)
        with progress_bar(total=episodes, unit="episode", seconds=seconds) as bar:
            path = export_lerobot(
                dataset,
                out,
                arguments.image_size,
                arguments.workers,
                bar.update,
                arguments.observations,
                arguments.cameras,
            )
    elif arguments.to == "minari":
        path = export_minari(dataset, out)
    else:
        path = export_hdf5(dataset, out, robomimic=arguments.to == "robomimic")
    _tell(arguments, path, episodes)


def _export_libero(arguments: Arguments) -> None:
    """Export a file in LIBERO's layout, and print the path written."""
    from clutter_env.data.libero import export_libero
    from clutter_env.errors import LearningError

    if arguments.to != "lerobot" or arguments.image_size or arguments.observations or arguments.cameras:
        raise LearningError("a file of LIBERO's demonstrations is exported --to lerobot, with the images that it has")
    out = arguments.out or Path("outputs/exports") / arguments.to
    out.parent.mkdir(parents=True, exist_ok=True)
    _tell(arguments, out, export_libero(arguments.demos[0], out))


def _tell(arguments: Arguments, path: Path, episodes: int) -> None:
    """Print where an export is, and write it where asked."""
    from clutter_env.reporting.files import write_json

    files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file()]
    size = sum(file.stat().st_size for file in files)
    print(f"{episodes} episodes in {path}: {size / 1e6:.1f} MB")
    if arguments.json is not None:
        write_json(arguments.json, {"path": path, "format": arguments.to, "episodes": episodes, "bytes": size})
