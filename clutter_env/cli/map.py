"""Build the reachability map of a robot, save it, and draw it.

    clutter-env map panda.xml --base link0 --tip hand --approach z
    clutter-env map --robot fetch

The robot is any arm in an MJCF file, with the names of its base and of its TCP; or one of the project's robots by name;
or your own `RobotSpec` as module:NAME. Its chain is first compared with the model in MuJoCo, because a map of wrong
kinematics is useless.

The scripts `map_figures.py`, `map_speed.py` and `map_accuracy.py` draw and measure maps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from clutter_env.errors import UsageError

if TYPE_CHECKING:
    from assets import RobotSpec
    from irm import ArmChain


@dataclass(frozen=True)
class Arguments:
    """Build a map."""

    mjcf: tyro.conf.Positional[Path | None] = None
    """MJCF file of an arm; it needs --base and --tip."""
    base: str = ""
    """Body of the MJCF file whose frame is the base frame, with z up."""
    tip: str = ""
    """Site or body of the MJCF file whose frame is the TCP frame."""
    approach: Literal["x", "-x", "y", "-y", "z", "-z"] = "x"
    """Axis of the tip along which the gripper approaches."""
    robot: str = "fetch"
    """Name of a robot, or module:NAME of a RobotSpec."""
    out: Path | None = None
    """File of the map; outputs/NAME.npz if not given."""
    voxel: float = 0.05
    """Edge of the position cells [m]."""
    orientations: int = 62
    """Number of approach axes: 6, 26, 62, 114, 182, 266, ..."""
    rolls: int = 0
    """Roll samples for each approach axis; 0 stands for 1 if the wrist rolls freely, and for 4 otherwise."""
    pitches: tuple[float, ...] = ()
    """Rings of pitch to keep [degrees]; all if not given."""
    heights: tuple[float, float] = (0.0, 10.0)
    """Lowest and highest TCP position [m]."""
    lift: bool = True
    """Whether the torso may move; if not, it stays at its height in the home configuration."""
    samples: int = 400_000
    """Random configurations, for arms without a closed form."""
    seed: int = 0
    """Random seed of these configurations."""
    check: bool = True
    """Whether to compare the chain with the robot's MJCF file first."""
    json: Path | None = None
    """File for machine-readable results."""


def run(arguments: Arguments) -> None:
    """Check the chain, build the map, save it, draw it, and print a report."""
    from clutter_env.cli.map_report import build_map
    from clutter_env.reporting.files import write_json
    from irm import ArmChain, MapParameters

    robot = _robot(arguments)
    parameters = MapParameters(
        voxel=arguments.voxel,
        orientations=arguments.orientations,
        rolls=arguments.rolls,
        pitches=tuple(math.radians(pitch) for pitch in arguments.pitches),
        heights=arguments.heights,
        lift=arguments.lift,
        samples=arguments.samples,
        seed=arguments.seed,
    )
    name = robot.robot if isinstance(robot, ArmChain) else robot.name
    report = build_map(robot, parameters, arguments.out or Path("outputs") / f"{name}.npz")
    print(report)
    if arguments.json is not None:
        write_json(arguments.json, report)


def _robot(arguments: Arguments) -> RobotSpec | ArmChain:
    """The robot that the arguments name, compared with its MJCF file if wanted."""
    import mujoco

    from clutter_env.cli.named_robot import robot_by_name
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
