"""Make a robot from an arm's file, or check a robot's data, and draw the robot.

    clutter-env robot make arm.xml --base base --tip flange --tool 0.16 --on 0.15 0.75
    clutter-env robot check panda_mobile
    clutter-env robot check my_package.robots:MINE
    clutter-env robot check my_robot.xml --page my_robot.json

`make` writes an MJCF file and its page. The arm has boxes, cylinders and capsules in place of its meshes. It stands on
a base, with a lift, motors and two sliding fingers, see docs/add_a_robot.md. `check` lists missing and inconsistent
data. Both draw the collision shapes, the frames of the joints and the reach of the level gripper. They let the robot
plan and execute three scenes before they report no problem. The page of an MJCF file is a JSON object with the keyword
arguments of `RobotSpec.from_mjcf`. Without a `home` in it, `check` suggests some.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import tyro

import assets
from clutter_env.errors import NoHome, UsageError
from clutter_env.reporting.files import check_picture, write_json

if TYPE_CHECKING:
    from assets import RobotSpec
    from assets.robot_making import Mounting


@dataclass(frozen=True)
class Arguments:
    """Make a robot from an arm's file, or check a robot's data, and draw the robot."""

    action: tyro.conf.Positional[Literal["check", "make"]]
    """What to do."""
    robot: tyro.conf.Positional[str]
    """check: name of a robot, module:NAME of a RobotSpec, or an MJCF file. make: an MJCF or URDF file."""
    page: Path | None = None
    """JSON file of what the MJCF file does not say. By default the one with the same name."""
    table: float = 0.75
    """Height of the table that the robot is to work at [m]."""
    scenes: int = 3
    """Scenes with five objects that the robot plans and executes, on the table of the environments, 0 for none."""
    out: Path | None = None
    """check: the picture, outputs/NAME.png if not given. make: the robot's file, outputs/NAME.xml if not given. Page
    and picture are in the same directory."""
    json: Path | None = None
    """Write facts, problems and the results of the scenes to this file."""
    base: str = ""
    """make: body that the arm begins with, or that is the file's own mobile base."""
    tip: str = ""
    """make: site or body between the finger tips, or of the flange."""
    approach: Literal["x", "-x", "y", "-y", "z", "-z"] = "z"
    """make: axis of the tip along which the gripper approaches. Fingers move along y."""
    turn: float = 0.0
    """make: angle about the approach from the tip's y axis to the axis along which the fingers move [rad]."""
    on: tuple[float, float] | None = None
    """make: x and height of the arm's base on a round mobile base [m]. A file with a base of its own needs none."""
    radius: float = 0.27
    """make: of the round base [m]."""
    lift: tuple[float, float] | None = None
    """make: range of a lift under the arm [m]. No lift if not given."""
    opening: float = 0.085
    """make: of the gripper [m]."""
    tool: float = 0.0
    """make: from the tip to the point between the finger tips [m]."""
    without: tuple[str, ...] = ()
    """make: bodies that are left out, with all that they carry."""
    apart: tuple[str, ...] = ()
    """make: bodies, two by two, that cannot touch, whatever the shapes in place of their meshes do."""
    mesh_scale: float = 1.0
    """make: scale of all meshes: 0.001 for a file that takes millimetres for metres."""
    radians: bool = False
    """make: angles of the MJCF file are radians, although it does not say so."""
    drive: Literal["holonomic", "differential", "fixed"] = "holonomic"
    """make: how the base moves. fixed with --on: the arm stands on a pedestal of that --radius."""

    def __post_init__(self) -> None:
        if self.action == "check":
            check_picture(self.out)
        if self.scenes < 0:
            raise ValueError(f"--scenes {self.scenes} is not valid; it must be at least 0")


def run(arguments: Arguments) -> None:
    """Report, draw, and end with an error if a problem is found."""
    from clutter_env.cli.robot_report import home_candidates

    if arguments.action == "make":
        _make(arguments)
        return
    robot, has_home = _robot(arguments)
    if not has_home:
        print("home, best first:")
        for candidate in home_candidates(robot, table_height=arguments.table):
            print(f"  {[round(float(value), 4) for value in candidate.q]}  {candidate.distance:.2f} rad from grasps")
        raise UsageError("the page says no home; take one of these, or your own")
    _report(robot, arguments, arguments.out or Path("outputs") / f"{robot.name}.png")


def _report(robot: RobotSpec, arguments: Arguments, picture: Path) -> None:
    """Print facts and problems, and draw. Then let the robot plan and execute scenes, unless problems were found."""
    from clutter_env.cli.robot_report import draw_robot, report_of
    from clutter_env.cli.robot_trials import SceneTrials, try_scenes

    report = report_of(robot, arguments.table)
    print(report.facts_text(), flush=True)
    if report.reach is not None:
        draw_robot(robot, report.reach, picture)
        print(f"  picture: {picture}", flush=True)
    trials = SceneTrials({})
    if arguments.scenes and not report.problems:
        trials = try_scenes(robot, arguments.scenes)
        if trials.is_good:
            print(f"  scenes: {trials}")
        else:
            report = replace(report, problems=(str(trials),))
    print(report.problems_text())
    if arguments.json is not None:
        values = {"facts": report.facts, "problems": report.problems, "scenes": trials.reasons}
        write_json(arguments.json, {"robot": report.name, **values})
    if report.problems:
        sys.exit(1)


def _make(arguments: Arguments) -> None:
    """Write the robot's file, its page with the best home configuration, and the picture."""
    from assets.robot_making import Mounting

    if not (arguments.base and arguments.tip):
        raise UsageError("make needs --base, the arm's first body, and --tip, the site or body between the finger tips")
    mounting = Mounting(**{entry.name: getattr(arguments, entry.name) for entry in fields(Mounting)})
    source = Path(arguments.robot)
    stem = source.parent.name if source.stem in ("robot", "model", "scene") else source.stem
    file = arguments.out or Path("outputs") / f"{stem}.xml"
    if file.suffix != ".xml":
        raise UsageError(f"--out {file} must end with .xml: it is the robot's name, and its page lies beside it")
    if file.exists() and source.exists() and file.samefile(source):
        raise UsageError(f"--out {file} is the arm's own file, which would be lost; give the robot another name")
    file.parent.mkdir(parents=True, exist_ok=True)
    made = first = _made(source, mounting, file, arguments.table)
    if not first.has_home:
        # Two fingers are the same after half a turn of the wrist; narrow limits may leave one of the two.
        turn = mounting.turn + math.pi
        turned = _made(source, replace(mounting, turn=turn), file, arguments.table)
        turned.found["turn"] = f"the gripper is turned by half a turn, --turn {turn:.4f}: else {first.why_no_home}"
        made = turned if turned.has_home else first
    file.write_text(made.mjcf, encoding="utf-8")
    print("\n".join(f"{name}: {value}" for name, value in made.found.items()))
    if not made.has_home:
        raise NoHome(f"{file} is written, but no home configuration is found: {made.why_no_home}")
    write_json(file.with_suffix(".json"), made.page)
    print(f"written: {file}, {file.with_suffix('.json').name}")
    _report(assets.RobotSpec.from_mjcf(file, **made.page), arguments, file.with_suffix(".png"))


class _Made(NamedTuple):
    """A robot from `make_robot`, its page with a home, or the reason for its absence."""

    mjcf: str
    page: dict[str, Any]
    found: dict[str, str]
    why_no_home: str

    @property
    def has_home(self) -> bool:
        return not self.why_no_home


def _made(source: Path, mounting: Mounting, file: Path, table: float) -> _Made:
    """The robot of an arm's file, written to a file, with its best home at a table of some height [m]."""
    from assets.robot_making import make_robot
    from clutter_env.cli.robot_report import home_candidates, least_grasp_height, why_no_home

    mjcf, page, found = make_robot(source, mounting)
    file.write_text(mjcf, encoding="utf-8")
    draft = assets.RobotSpec.from_mjcf(file, **page, home=_middle(file, page))
    if (least := least_grasp_height(draft)) > draft.grasp_height:
        page["grasp_height"] = least
        found["grasp_height"] = f"{least} m, so that the hand keeps off the table in level grasps"
    homes = home_candidates(draft, count=1, table_height=table)
    if not homes:
        return _Made(mjcf, page, found, why_no_home(draft, table))
    page["home"] = [round(float(value), 6) for value in homes[0].q]
    return _Made(mjcf, page, found, "")


def _middle(file: Path, page: Mapping[str, Any]) -> tuple[float, ...]:
    """The middle of the joints' ranges, in place of a home configuration.

    Raises:
        ValueError, LookupError, TypeError: as `RobotSpec.from_mjcf` says it better.
    """
    import mujoco

    from irm import ArmChain

    model = mujoco.MjModel.from_xml_path(str(file))
    base = model.body(model.joint(page["base_joints"][0]).bodyid[0]).name
    arm = ArmChain.from_mjcf(model, base, page["tip"])
    return tuple(((arm.lower + arm.upper) / 2).tolist())


def robot_by_name(name: str) -> RobotSpec:
    """A robot of the project by its name, or the `RobotSpec` that module:NAME refers to.

    Raises:
        UsageError: no such robot, module or name, or it is not a `RobotSpec`.
    """
    from clutter_env.policies.registry import imported

    if not all(name.partition(":")):
        return assets.robot(name)
    found = imported(name, UsageError(f"there is no robot {name!r}"))
    if not isinstance(found, assets.RobotSpec):
        raise UsageError(f"{name} is a {type(found).__name__}, not a RobotSpec")
    return found


def _robot(arguments: Arguments) -> tuple[RobotSpec, bool]:
    """The robot, and whether a home configuration was given: if not, it has the middle of the joints' ranges."""
    if not arguments.robot.endswith(".xml"):
        if arguments.page is not None:
            raise UsageError(f"--page is for an MJCF file, whose name ends with .xml; {arguments.robot!r} is none")
        return robot_by_name(arguments.robot), True
    file = arguments.page or Path(arguments.robot).with_suffix(".json")
    try:
        page = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise UsageError(f"an MJCF file needs --page, or {file} beside it; see docs/add_a_robot.md") from None
    except ValueError as problem:
        raise UsageError(f"{file} is no JSON file: {problem}") from None
    if not isinstance(page, dict):
        raise UsageError(f"{file} holds {page!r:.40}; it must hold a JSON object, see docs/add_a_robot.md")
    path, has_home = Path(arguments.robot).resolve(), "home" in page
    if not has_home:
        try:
            page["home"] = _middle(path, page)
        except (ValueError, LookupError, TypeError):
            page["home"] = ()  # `from_mjcf` finds the same problem, and reports it
    return assets.RobotSpec.from_mjcf(path, **page), has_home
