"""Check that a robot's data and its MJCF file agree, before anything is built. Errors name missing and different
entries."""

from __future__ import annotations

import mujoco
import numpy as np

from assets import RobotSpec, rotation_of
from clutter_env.errors import ConfigError

OFFSET_TOLERANCE = 1e-4
"""[m] between a joint's or the TCP's place in the data and in the MJCF."""
AXIS_TOLERANCE = 1e-6
"""Largest difference between the entries of two unit vectors."""
RANGE_TOLERANCE = 1e-3
"""[m], [rad] between a joint's range in the data and in the MJCF, which rounds it."""


def check_robot(robot: RobotSpec) -> None:
    """Compare a robot's data with its MJCF file.

    Raises:
        ConfigError: the file is missing or no MJCF. Or it lacks a body, joint, actuator, geom, site or camera that the
            data name. Or the kind, position, axis or range of a joint of the chain differs from the data.
    """
    try:
        model = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    except FileNotFoundError as problem:
        raise ConfigError(f"robot {robot.name!r}: {problem}") from None
    except ValueError as problem:
        raise ConfigError(f"{_place(robot)} is no valid MJCF file: {problem}") from None
    _check_names(robot, model)
    _check_base(robot, model)
    for arm in robot.acting_arms:
        _check_chain(robot.using(arm) if arm else robot, model)


def _check_names(robot: RobotSpec, model: mujoco.MjModel) -> None:
    """Check that every name of the data is in the file, and every joint of the file is in the data."""
    joints = (*robot.drive_joints, *robot.finger_joints, *robot.still_joints)
    bodies = (robot.base_body, robot.gripper_body, *(mesh.body for mesh in robot.meshes))
    for kind, count, wanted in (
        ("body", model.nbody, bodies),
        ("joint", model.njnt, joints),
        ("actuator", model.nu, joints),
        ("geom", model.ngeom, robot.finger_geoms),
        ("site", model.nsite, (robot.tcp_site,)),
        ("camera", model.ncam, robot.cameras),
    ):
        known = [getattr(model, kind)(index).name for index in range(count)]
        for name in wanted:
            if name not in known:
                raise ConfigError(f"{_place(robot)} has no {kind} {name!r}; it has: {', '.join(known) or 'none'}")
    if extra := [name for index in range(model.njnt) if (name := model.joint(index).name) not in joints]:
        raise ConfigError(f"{_place(robot)} has joints that the RobotSpec does not name: {', '.join(extra)}")


def _check_base(robot: RobotSpec, model: mujoco.MjModel) -> None:
    """Check that the base moves along world x and y and turns about world z, in this order."""
    slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    for name, kind, axis in zip(robot.base_joints, (slide, slide, hinge), np.eye(3), strict=True):
        joint = model.joint(name)
        is_right = int(joint.type[0]) == int(kind) and np.allclose(joint.axis, axis, atol=AXIS_TOLERANCE)
        if not is_right or model.body(joint.bodyid[0]).name != robot.base_body:
            raise ConfigError(
                f"{_place(robot)}: joints of {robot.base_body!r} must slide along x, slide along y and turn about z, "
                f"in this order; {name!r} does not"
            )


def _check_chain(robot: RobotSpec, model: mujoco.MjModel) -> None:
    """Check positions, axes, kinds and ranges of the chain's joints, and the pose of the TCP, with all joints at
    zero."""
    data = mujoco.MjData(model)
    data.qpos[:] = 0
    mujoco.mj_kinematics(model, data)
    base = data.body(robot.base_body)
    R, p, before = base.xmat.reshape(3, 3), base.xpos, robot.base_body
    for link in robot.chain:
        joint = model.joint(link.joint)
        kind = mujoco.mjtJoint.mjJNT_SLIDE if link.prismatic else mujoco.mjtJoint.mjJNT_HINGE
        previous, p, R = p, p + R @ link.offset, R @ rotation_of(link.quaternion)
        axis, away = R @ link.direction, data.xanchor[joint.id] - p
        if int(joint.type[0]) != int(kind):
            raise _different(robot, link.joint, "has another kind", "prismatic" if link.prismatic else "revolute")
        if not link.prismatic and np.abs(away - axis * (axis @ away)).max() > OFFSET_TOLERANCE:
            offset = data.xanchor[joint.id] - previous
            raise _different(robot, link.joint, f"is {_text(offset)} m from {before!r}", _text(p - previous))
        if np.abs(data.xaxis[joint.id] - axis).max() > AXIS_TOLERANCE:
            raise _different(robot, link.joint, f"has the axis {_text(data.xaxis[joint.id])}", _text(axis))
        if np.abs(joint.range - (link.lower, link.upper)).max() > RANGE_TOLERANCE and joint.limited[0]:
            raise _different(robot, link.joint, f"has the range {_text(joint.range)}", _text((link.lower, link.upper)))
        before = link.joint
    site, previous, p = data.site(robot.tcp_site), p, p + R @ robot.tcp_offset
    if np.abs(site.xpos - p).max() > OFFSET_TOLERANCE:
        offset = site.xpos - previous
        raise _different(robot, robot.tcp_site, f"is {_text(offset)} m from {before!r}", _text(p - previous))
    turn, wanted = site.xmat.reshape(3, 3), R @ rotation_of(robot.tcp_quaternion)
    for name, found, said in zip("xy", turn.T, wanted.T, strict=False):
        if np.abs(found - said).max() > AXIS_TOLERANCE:
            raise _different(robot, robot.tcp_site, f"has its {name} axis along {_text(found)} at zero", _text(said))


def _different(robot: RobotSpec, name: str, found: str, said: str) -> ConfigError:
    return ConfigError(f"{_place(robot)}: {name!r} {found}; the RobotSpec says {said}")


def _place(robot: RobotSpec) -> str:
    return f"robot {robot.name!r}: {robot.mjcf!r}"


def _text(values: object) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in np.asarray(values, float)) + ")"
