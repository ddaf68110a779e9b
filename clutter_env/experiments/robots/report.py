"""What is missing or inconsistent in a robot's data and its MJCF file, in words."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from assets.robots import RobotSpec
from clutter_env.errors import ConfigError
from clutter_env.experiments.robots.reach import LevelReach, level_reach, touches_itself
from clutter_env.scene.layout import TABLE_HEIGHT
from clutter_env.scene.object_sets import OBJECT_SETS
from clutter_env.simulation.robot_check import check_robot
from irm.arm.general.solutions import CLOSED_FORM, ITERATIVE, PARALLEL, SPHERICAL, solver_arrays
from irm.arm.kinematics import ArmChain, forward
from planners.collision.scene_arrays import GeometryError, robot_arrays
from planners.grasping.grasp_poses import gripper_clearances

__all__ = ["RobotReport", "report_of"]

LEVEL = 0.999
"""Smallest cosine between the vertical and the level gripper's z axis."""
ABOVE_OBJECTS = 0.28
"""[m] of the TCP at home above the table at least: the highest objects, and the lower end of one that is held."""
KINDS = {
    CLOSED_FORM: "the closed form of Fetch's arm",
    SPHERICAL: "closed form: three axes meet in a point",
    PARALLEL: "closed form: three axes are parallel",
    ITERATIVE: "iteration: no closed form is known for this arm, so planning is slow",
}


@dataclass(frozen=True)
class RobotReport:
    """What was found.

    Attributes:
        name: of the robot.
        facts: what was read and computed, by its name.
        problems: what must be mended; empty if nothing.
        reach: of the level gripper; None if the robot's files could not be read.
    """

    name: str
    facts: dict[str, str]
    problems: tuple[str, ...]
    reach: LevelReach | None = None

    def summary(self) -> str:
        """Facts, then problems, one a line."""
        lines = [f"{self.name}", *(f"  {name}: {value}" for name, value in self.facts.items())]
        lines += [f"  PROBLEM: {problem}" for problem in self.problems] or ["  no problem found"]
        return "\n".join(lines)


def report_of(robot: RobotSpec) -> RobotReport:
    """Compare the data with the file, and check what environments and planner need."""
    try:
        check_robot(robot)
        robot_arrays(robot)
    except (ConfigError, GeometryError) as problem:
        return RobotReport(robot.name, {}, (str(problem),))
    model, reach = mujoco.MjModel.from_xml_path(str(robot.mjcf_path)), level_reach(robot)
    problems = (*_motors(robot, model), *_contacts(robot, model), *_home(robot), *_size(robot, reach))
    return RobotReport(robot.name, _facts(robot, reach), problems, reach)


def _facts(robot: RobotSpec, reach: LevelReach) -> dict[str, str]:
    chain, gripper = ArmChain.from_robot(robot), gripper_clearances(robot)
    tcp = forward(chain, robot.home)[:3, 3]
    farthest = _farthest(reach)
    return {
        "arm": f"{chain.size - 1} joints, {KINDS[solver_arrays(chain).kind]}",
        "lift": f"{robot.chain[0].joint}, {chain.lower[0]:.3g} to {chain.upper[0]:.3g} m",
        "gripper": f"opens to {robot.max_opening:.3f} m, palm {1000 * gripper.palm_reach:.0f} mm behind the TCP",
        "base": f"radius {robot.base_radius:.3f} m, height {robot.base_height:.3f} m",
        "home": f"TCP at ({', '.join(f'{value:.3f}' for value in tcp)}) m",
        "level gripper at the table": f"reaches x = {farthest[0]:.2f} to {farthest[1]:.2f} m straight ahead"
        if farthest
        else "reaches nothing",
        "cameras": ", ".join(robot.cameras) or "none: no image observations",
    }


def _farthest(reach: LevelReach) -> tuple[float, float] | None:
    """Smallest and largest x [m] straight ahead at the height of a grasp on the table; None if there is none."""
    middle = reach.reached[:, reach.y.size // 2, reach.z.size // 2]
    return (float(reach.x[middle].min()), float(reach.x[middle].max())) if middle.any() else None


def _motors(robot: RobotSpec, model: mujoco.MjModel) -> list[str]:
    """Motors that do not follow positions, bodies that sink, and fingers that move apart."""
    names = (*robot.drive_joints, *robot.finger_joints, *robot.head_joints)
    wrong = [
        name
        for name in names
        if not (gain := model.actuator(name).gainprm[0]) > 0 or not np.isclose(model.actuator(name).biasprm[1], -gain)
    ]
    found = [f"actuators that are not position servos: {', '.join(wrong)}"] if wrong else []
    sinking = [model.body(body).name for body in range(1, model.nbody) if model.body_gravcomp[body] != 1.0]
    if sinking:
        found.append(f"bodies without gravcomp=1: {', '.join(sinking)}")
    fingers = {model.joint(name).id for name in robot.finger_joints}
    pairs = [{int(a), int(b)} for a, b in zip(model.eq_obj1id, model.eq_obj2id, strict=True)]
    if fingers not in pairs:
        found.append("no joint equality couples the fingers")
    return found


def _contacts(robot: RobotSpec, model: mujoco.MjModel) -> list[str]:
    """Geoms that the robot would hit itself with, and pads that objects slip from."""
    bits = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    wrong = bits & ((model.geom_contype != 2) | (model.geom_conaffinity != 0))
    found = []
    if wrong.any():
        names = ", ".join(model.geom(int(geom)).name or f"geom {geom}" for geom in np.flatnonzero(wrong))
        found.append(f'geoms without contype="2" conaffinity="0": {names}')
    soft = [name for name in robot.finger_geoms if model.geom(name).condim[0] < 4 or model.geom(name).priority[0] < 1]
    if soft:
        found.append(f'pads without condim="4" priority="1", from which objects slip: {", ".join(soft)}')
    return found


def _home(robot: RobotSpec) -> list[str]:
    T = forward(ArmChain.from_robot(robot), robot.home)
    found = []
    if T[2, 2] < LEVEL or T[0, 0] < LEVEL:
        found.append(
            f"home: the gripper is not level and straight ahead; its x axis is {np.round(T[:3, 0], 3).tolist()}"
        )
    if T[2, 3] < TABLE_HEIGHT + ABOVE_OBJECTS:
        found.append(f"home: the TCP is {T[2, 3]:.2f} m high; objects need {TABLE_HEIGHT + ABOVE_OBJECTS:.2f} m")
    if touched := touches_itself(robot):
        found.append(f"home: the robot touches {' and '.join(touched)}")
    return found


def _size(robot: RobotSpec, reach: LevelReach) -> list[str]:
    """A gripper too small for the standard objects, a reach that ends before the table."""
    found, widest = [], 2 * OBJECT_SETS["standard"].radius[1]
    if robot.max_opening <= widest:
        found.append(f"the gripper opens to {robot.max_opening:.3f} m; standard objects are up to {widest:.3f} m wide")
    farthest = _farthest(reach)
    if farthest is None or farthest[1] < robot.base_radius + 0.3:
        found.append("the level gripper does not reach 0.3 m beyond the base at the table's height")
    return found
