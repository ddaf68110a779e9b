"""Check a robot's data, and draw the robot.

    clutter-env robot check panda_mobile
    clutter-env robot check my_package.robots:MINE
    clutter-env robot check my_robot.xml --page my_robot.json

Says what is missing or inconsistent, and draws the collision shapes, the frames of the joints and where the level
gripper reaches. The page of an MJCF file is a JSON object with the keyword arguments of `RobotSpec.from_mjcf`. Without
a `home` in it, configurations are suggested.
"""

from __future__ import annotations

import importlib
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

import assets
from clutter_env.errors import UsageError
from clutter_env.reporting.files import check_picture

if TYPE_CHECKING:
    from assets import RobotSpec


@dataclass(frozen=True)
class Arguments:
    """Check a robot's data, and draw the robot."""

    action: tyro.conf.Positional[Literal["check"]]
    """There is one so far."""
    robot: tyro.conf.Positional[str]
    """Name of a robot, module:NAME of a RobotSpec, or an MJCF file."""
    page: Path | None = None
    """JSON file of what the MJCF file does not say."""
    homes: bool = False
    """Suggest home configurations; always done for a page without one."""
    table: float = 0.75
    """Height of the table that the robot is to work at [m]."""
    out: Path | None = None
    """The picture; outputs/NAME.png if not given."""

    def __post_init__(self) -> None:
        check_picture(self.out)


def run(arguments: Arguments) -> None:
    """Report, draw, and end with an error if there is a problem."""
    from clutter_env.cli.robot_report import draw_robot, home_candidates, report_of

    robot, has_home = _robot(arguments)
    if arguments.homes or not has_home:
        print("home, best first:")
        for candidate in home_candidates(robot, table_height=arguments.table):
            print(f"  {[round(float(value), 4) for value in candidate.q]}  {candidate.distance:.2f} rad from grasps")
    if not has_home:
        raise UsageError(f"{arguments.page} says no home; take one of these, or your own")
    report = report_of(robot, arguments.table)
    print(report.summary())
    if report.reach is not None:
        file = arguments.out or Path("outputs") / f"{robot.name}.png"
        draw_robot(robot, report.reach, file)
        print(f"  picture: {file}")
    if report.problems:
        sys.exit(1)


def robot_by_name(name: str) -> RobotSpec:
    """A robot of the project by its name, or the `RobotSpec` that module:NAME refers to.

    Raises:
        UsageError: there is no such robot, module or name, or it is not a `RobotSpec`.
    """
    module, _, attribute = name.partition(":")
    if not (module and attribute):
        return assets.robot(name)
    if (here := str(Path.cwd())) not in sys.path:  # a console script does not look in the current directory
        sys.path.insert(0, here)
    try:
        found = getattr(importlib.import_module(module), attribute, None)
    except ModuleNotFoundError as problem:
        if not f"{module}.".startswith(f"{problem.name}."):
            raise  # an import in the user's module
        raise UsageError(f"there is no robot {name!r}: {problem}") from problem
    if found is None:
        raise UsageError(f"there is no robot {name!r}: {module} has no {attribute}")
    if not isinstance(found, assets.RobotSpec):
        raise UsageError(f"{name} is a {type(found).__name__}, not a RobotSpec")
    return found


def _robot(arguments: Arguments) -> tuple[RobotSpec, bool]:
    """The robot, and whether a home configuration was given: if not, it has the middle of the joints' ranges."""
    import mujoco

    from irm import ArmChain

    if not arguments.robot.endswith(".xml"):
        if arguments.page is not None:
            raise UsageError(f"--page is for an MJCF file, whose name ends with .xml; {arguments.robot!r} is none")
        return robot_by_name(arguments.robot), True
    if arguments.page is None:
        raise UsageError("an MJCF file needs --page, a JSON file; see docs/add_a_robot.md")
    try:
        page = json.loads(arguments.page.read_text(encoding="utf-8"))
    except ValueError as problem:
        raise UsageError(f"{arguments.page} is no JSON file: {problem}") from None
    if not isinstance(page, dict):
        raise UsageError(f"{arguments.page} holds {page!r:.40}; it must hold a JSON object, see docs/add_a_robot.md")
    path, has_home = Path(arguments.robot).resolve(), "home" in page
    if not has_home:
        try:
            model = mujoco.MjModel.from_xml_path(str(path))
            base = model.body(model.joint(page["base_joints"][0]).bodyid[0]).name
            arm = ArmChain.from_mjcf(model, base, page["tip"])
            page["home"] = tuple(((arm.lower + arm.upper) / 2).tolist())
        except (ValueError, LookupError, TypeError):
            page["home"] = ()  # `from_mjcf` meets the same problem, and says what it is
    return assets.RobotSpec.from_mjcf(path, **page), has_home
