"""Names of a robot in a user's model: those of its own MJCF file, with a prefix where they would clash."""

from __future__ import annotations

import mujoco

from assets.robots import RobotSpec
from planners.scene.solid import SceneError


def robot_prefix(model: mujoco.MjModel, robot: RobotSpec) -> str:
    """Prefix of all names of a robot in a model, "" if it has the names of its own MJCF file.

    Raises:
        SceneError: the model lacks parts of the robot, or has it twice behind prefixes, which is ambiguous.
    """
    if not (missing := _missing(model, robot, "")):
        return ""
    tips = [model.site(index).name for index in range(model.nsite)]
    prefixes = [name.removesuffix(robot.tcp_site) for name in tips if name.endswith(robot.tcp_site)]
    found = [prefix for prefix in dict.fromkeys(prefixes) if not _missing(model, robot, prefix)]
    if len(found) == 1:
        return found[0]
    if found:
        raise SceneError(
            f"robot {robot.name!r} is there {len(found)} times, as {', '.join(found)}: which one is meant?"
        )
    joints = [model.joint(index).name for index in range(model.njnt)]
    raise SceneError(
        f"the model lacks {', '.join(missing)} of robot {robot.name!r}; its joints: "
        f"{', '.join(filter(None, joints)) or 'none'}; put the robot in with `planners.insert_robot(model, robot, "
        "without=[…])`, or say by `RobotSpec.from_mjcf(base_joints=…, tip=…, finger_joints=…)` what its parts are "
        "called"
    )


def _missing(model: mujoco.MjModel, robot: RobotSpec, prefix: str) -> list[str]:
    """Names of the parts of a robot that a model lacks behind a prefix."""
    kinds = {
        mujoco.mjtObj.mjOBJ_BODY: (robot.base_body,),
        mujoco.mjtObj.mjOBJ_JOINT: (*robot.drive_joints, *robot.finger_joints),
        mujoco.mjtObj.mjOBJ_SITE: (robot.tcp_site,),
    }
    asked = [(kind, name) for kind, names in kinds.items() for name in names]
    return [name for kind, name in asked if mujoco.mj_name2id(model, kind, prefix + name) < 0]
