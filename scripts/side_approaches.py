"""Side grasps that a robot reaches on each layout without objects, tabulated with the planner: assets/approaches.

    python scripts/side_approaches.py --out assets/approaches
    python scripts/side_approaches.py --robot pr2 --arm left --layouts paper

Scenes with `obstructed=True` are drawn by means of this table; make it again when a robot, a layout or the planner's
choice of grasps and base poses changes. Other robots need none: theirs is made when it is first asked for.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tyro

from assets import robot as find_robot
from clutter_env.envs.side_approaches import cell_centres, reachable_yaws
from clutter_env.reporting.files import write_json
from clutter_env.reporting.progress import progress_bar
from clutter_env.scene.layout import LAYOUTS, find_layout
from planners import SideGripper

TABLES = tuple(name for name, layout in LAYOUTS.items() if layout.opens is None)
"""Names of the layouts that are not shut at the start."""


def main(
    robot: str = "fetch",
    arm: str = "",
    layouts: tuple[str, ...] = TABLES,
    out: Path = Path("outputs/approaches"),
) -> None:
    """Tabulate and write: of each layout rows of cells along x, each cell a mask of the reachable yaws in hexadecimal.

    Args:
        robot: Name of the robot.
        arm: Name of the arm that grasps, of a robot with several; the active one if not given.
        layouts: Names of the layouts.
        out: Directory of the file.
    """
    grasping = find_robot(robot).using(arm) if arm else find_robot(robot)
    gripper, tables = SideGripper.of(grasping), {}
    with progress_bar(desc="cells") as bar:
        for name in layouts:
            xs, ys = cell_centres(layout := find_layout(name))
            rows = [
                reachable_yaws(grasping, layout, np.column_stack((np.full(len(ys), x), ys)), bar.update) for x in xs
            ]
            masks = [row @ (1 << np.arange(row.shape[1])) for row in rows]
            tables[name] = ["".join(f"{int(mask):06x}" for mask in row) for row in masks]
    table = {
        "robot": grasping.full_name,
        "grasp_height": grasping.grasp_height,
        "planner": gripper.margins,
        "palm_reach": gripper.palm_reach,
        "pad_half_height": gripper.pad_half_height,
        "solids": gripper.solids,
        "layouts": tables,
    }
    file = out / f"{grasping.full_name}.json"
    write_json(file, table)
    print(f"written: {file}")


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
