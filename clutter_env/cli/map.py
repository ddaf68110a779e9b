"""Build the reachability map of a robot, save it, and draw it.

    clutter-env map panda.xml --base link0 --tip hand --approach z
    clutter-env map --robot fetch

The robot is any arm in an MJCF file, with the names of its base and of its TCP. Or a robot of the project by name, or
your own `RobotSpec` as module:NAME. Fetch's map takes a quarter of a minute, the map of an arm without a closed form
two minutes. Its chain is first compared with the model in MuJoCo, because a map of wrong kinematics is useless.

The scripts `map_figures.py`, `map_speed.py` and `map_truth.py` draw and measure maps.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from clutter_env.errors import UsageError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from assets import RobotSpec
    from irm import ArmChain, ReachabilityMap


@dataclass(frozen=True)
class Arguments:
    """Build a map."""

    mjcf: tyro.conf.Positional[Path | None] = None
    """MJCF file of an arm, which needs --base and --tip."""
    base: str = ""
    """Body of the MJCF file whose frame is the base frame, with z up."""
    tip: str = ""
    """Site or body of the MJCF file whose frame is the TCP frame."""
    approach: Literal["x", "-x", "y", "-y", "z", "-z"] = "x"
    """Axis of the tip along which the gripper approaches."""
    robot: str = "fetch"
    """Name of a robot, or module:NAME of a RobotSpec."""
    out: Path | None = None
    """File of the map. outputs/NAME.npz if not given."""
    voxel: float = 0.05
    """Edge of the position cells [m]."""
    orientations: int = 62
    """Number of approach axes: 6, 26, 62, 114, 182, 266, ..."""
    lift: bool = True
    """Whether the torso may move. If not, it stays at its height in the home configuration."""
    samples: int = 400_000
    """Random configurations, for arms without a closed form."""
    seed: int = 0
    """Random seed of these configurations."""
    check: bool = True
    """Whether to compare the chain with the robot's MJCF file first."""
    json: Path | None = None
    """File for machine-readable results."""

    def __post_init__(self) -> None:
        if self.out is not None and self.out.suffix == ".png":
            raise ValueError(f"--out {self.out} is the file of the map; its picture, beside it, ends with .png")
        if self.mjcf is None and (self.base or self.tip):
            raise ValueError("--base and --tip are for an MJCF file, which is named before all options")


def run(arguments: Arguments) -> None:
    """Check the chain, build the map, save it, draw it, and print a report."""
    import time

    import numpy as np

    from clutter_env.reporting.files import write_json
    from clutter_env.reporting.progress import progress_bar
    from irm import ArmChain, ReachabilityMap

    robot = _robot(arguments)
    names = ("voxel", "orientations", "lift", "samples", "seed")
    parameters = {name: getattr(arguments, name) for name in names}
    name = robot.robot if isinstance(robot, ArmChain) else robot.name
    file = arguments.out or Path("outputs") / f"{name}.npz"
    start = time.process_time()
    rm = ReachabilityMap.build(robot, progress=progress_bar, **parameters)
    build_s = time.process_time() - start
    rm.save(file)
    picture = file.with_suffix(".png")
    draw_arm_map(rm).savefig(picture, dpi=90)
    index = rm.reachability_index
    report = {
        "robot": rm.robot,
        "poses": len(rm),
        "voxels": int(np.count_nonzero(index)),  # positions that are reachable in at least one orientation
        "mean_reachability_index": float(index[index > 0].mean()) if len(rm) else 0.0,  # D, equation 1 [%]
        "best_manipulability": float(rm.manipulability.max(initial=0.0)),  # μ, equation 2
        "build_s": build_s,  # CPU time
        "megabytes": file.stat().st_size / 1e6,
        "file": str(file),
        "picture": str(picture),
    }
    for entry, value in report.items():
        print(f"{entry:>24}: {value:.4g}" if isinstance(value, float) else f"{entry:>24}: {value}")
    if arguments.json is not None:
        write_json(arguments.json, report)


def _robot(arguments: Arguments) -> RobotSpec | ArmChain:
    """The robot that the arguments name, compared with its MJCF file if requested."""
    import mujoco

    from clutter_env.cli.robot import robot_by_name
    from irm import ArmChain, compare_with_model

    if arguments.mjcf is None:
        robot = robot_by_name(arguments.robot)
        if arguments.check:
            model = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
            compare_with_model(ArmChain.from_robot(robot), model, robot.base_body, robot.tcp_site)
        return robot
    if not (arguments.base and arguments.tip):
        raise UsageError("an MJCF file needs --base, a body, and --tip, a site or a body")
    names = arguments.base, arguments.tip, arguments.approach
    chain = ArmChain.from_mjcf(arguments.mjcf, *names)
    if arguments.check:
        compare_with_model(chain, mujoco.MjModel.from_xml_path(str(arguments.mjcf)), *names)
    return chain


def draw_arm_map(rm: ReachabilityMap) -> Figure:
    """D in the plane through the first joint's axis, and D and best μ in the layer with most poses.

    The black line is the arm: the origins of its joints with every joint in the middle of its limits.
    """
    import numpy as np
    from matplotlib.figure import Figure

    from irm import link_origins

    grid = rm.grid
    layers, _, rows, columns = rm.indices()
    layer = int(np.bincount(layers, minlength=grid.layers).argmax())
    best = np.zeros(grid.shape[2:])  # best μ over the orientations
    mine = layers == layer
    np.maximum.at(best, (rows[mine], columns[mine]), rm.manipulability[mine])
    x, y, z = grid.edges(0), grid.edges(1), grid.z_edges()
    share, at = "reachability index D [%]", f"at z = {grid.layer_height(layer):.3f} m"
    index = rm.reachability_index
    figure = Figure(figsize=(13.6, 4.2), layout="constrained")
    side = (x, z, index[:, :, grid.half], "viridis", share, f"{rm.robot}: D in the plane y = {grid.centre[1]:.3f} m")
    top = (x, y, index[layer].T, "viridis", share, f"D {at}")
    plan = (x, y, best.T, "turbo_r", "best manipulability μ", f"best μ {at}")
    for axis, drawn, label in zip(figure.subplots(1, 3), (side, top, plan), ("z [m]", "y [m]", "y [m]"), strict=True):
        across, up, values, colours, meaning, title = drawn
        mesh = axis.pcolormesh(across, up, np.where(values > 0, values, np.nan), cmap=colours)
        figure.colorbar(mesh, ax=axis, label=meaning, shrink=0.9, aspect=22)
        if rm.chain is not None:
            origins = link_origins(rm.chain, (rm.chain.lower + rm.chain.upper) / 2)[1:]
            ahead, height = origins[:, 0], origins[:, 2 if label == "z [m]" else 1]
            axis.plot(ahead, height, color="black", marker="o", markersize=3, linewidth=1.5)
        axis.set(title=title, facecolor="#f4f4f6", aspect="equal", xlabel="x [m]", ylabel=label)
    return figure
