"""Reading of a robot's data from its MJCF file. The caller gives the data that the model lacks."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from assets.files import path as asset_path
from assets.robot_parts import ARM_FIELDS, ArmSpec, ChainLink, InvalidRobot, check_names, require
from irm.chain import ArmChain, JointTable, frames_of, pose_of
from irm.errors import ChainError
from irm.model_reading import shapes_of
from irm.self_contact import is_excluded, is_solid, link_of_body
from irm.shapes import Shapes, with_pairs

Floats = NDArray[np.float64]

BASE_LIMITS = (1.0, 1.0, 1.5)
"""[m/s], [m/s], [rad/s] Default velocity limits of the base. Per second, also its acceleration limits."""
LIFT_LIMITS = (0.1, 0.5)
"""[m/s], [m/s²] Default limits of the lift."""
ARM_LIMITS = (1.5, 2.0)
"""[rad/s], [rad/s²] Default limits of the arm's joints."""
_ROUNDING = 9
"""Decimals kept of computed values."""


_NEEDED = ("base_joints", "tip", "finger_joints", "home")
_DEFAULTS: Mapping[str, Any] = {
    "name": "",
    "finger_geoms": (),
    "head_joints": (),
    "head_configuration": (),
    "max_velocity": (),
    "max_acceleration": (),
    "max_loaded_yaw_rate": 0.6,
    "max_tcp_velocity": (0.3, 1.0),
    "max_finger_velocity": 0.05,
    "grasp_height": 0.065,
    "grasp_axis_offset": 0.0,
    "finger_gap": 0.012,
    "ahead": (),
}
"""Optional data of a robot in addition to its MJCF file. Empty values are read from the file, or become slow limits."""


def read_fields(mjcf: str | Path, page: Mapping[str, Any]) -> dict[str, Any]:
    """Read the fields of a robot's `RobotSpec`. Arguments and exceptions as in `RobotSpec.from_mjcf`."""
    if "arms" in page:
        return _with_arms(mjcf, page)
    known = (*_NEEDED, *_DEFAULTS)
    if wrong := [*(set(page) - set(known)), *(set(_NEEDED) - set(page))]:
        raise InvalidRobot(
            f"these do not describe a robot (unknown or missing: {', '.join(sorted(wrong))}); "
            f"what can be said: {', '.join((*known, 'base', 'arms'))}"
        )
    said = {**_DEFAULTS, **{name: tuple(value) if isinstance(value, list) else value for name, value in page.items()}}
    # MuJoCo looks up any value without a check: None would end the process.
    check_names("base_joints", said["base_joints"], 3)
    check_names("finger_joints", said["finger_joints"], 2)
    check_names("finger_geoms", said["finger_geoms"])
    require(isinstance(said["name"], str), "name", f"must be a string, not {said['name']!r}")
    for limits in ("max_velocity", "max_acceleration"):
        require(isinstance(said[limits], tuple), limits, f"must be a tuple of numbers, not {said[limits]!r}")
    file = Path(mjcf).resolve() if Path(mjcf).is_file() else mjcf
    path = asset_path(str(file))
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as problem:
        raise InvalidRobot(f"{path} cannot be read as an MJCF file: {problem}") from problem
    tip = said.pop("tip")
    base = model.body(model.jnt_bodyid[_joint(model, said["base_joints"][0])]).name
    try:
        arm = ArmChain.from_mjcf(model, base, tip)
    except ChainError as problem:
        raise InvalidRobot(str(problem)) from problem
    sites = [model.site(number).name for number in range(model.nsite)]
    require(tip in sites, "tip", f"must name the TCP's site, not {tip!r}; sites: {', '.join(map(repr, sites))}")
    if not arm.joints[0]:
        raise InvalidRobot(f"{mjcf}: between {base!r} and the arm there must be a lift: a slide along z with a range")
    arm_count = len(arm.joints) - 1
    return {
        **said,
        "name": said["name"] or arm.robot,
        "mjcf": str(file),
        "base_body": base,
        "chain": _chain(arm),
        "tcp_offset": _numbers(arm.tip[:3]),
        "tcp_quaternion": _quaternion(arm.tip),
        "tcp_site": tip,
        "gripper_body": model.body(model.site(tip).bodyid[0]).name,
        "cameras": tuple(model.camera(number).name for number in range(model.ncam)),
        "max_velocity": said["max_velocity"] or (*BASE_LIMITS, LIFT_LIMITS[0], *[ARM_LIMITS[0]] * arm_count),
        "max_acceleration": said["max_acceleration"] or (*BASE_LIMITS, LIFT_LIMITS[1], *[ARM_LIMITS[1]] * arm_count),
        **_gripper(model, said["finger_joints"], said["finger_geoms"]),
        **footprint(model, base),
    }


def _with_arms(mjcf: str | Path, page: Mapping[str, Any]) -> dict[str, Any]:
    """Read the fields of a robot with several arms. Each is read as if it were the only arm, and the first is
    active."""
    arms, shared = page["arms"], {name: value for name, value in page.items() if name != "arms"}
    is_known = isinstance(arms, Mapping) and len(arms) > 1 and all(isinstance(arm, Mapping) for arm in arms.values())
    require(is_known, "arms", f"must hold what is said of each arm by its name, of two or more, not {arms!r}")
    (active, fields), *others = ((name, read_fields(mjcf, {**shared, **arm})) for name, arm in arms.items())
    idle = []
    for name, one in others:
        is_shared = one["chain"][0] == fields["chain"][0] and one["home"][0] == fields["home"][0]
        require(is_shared, "arms", f"must share one lift and its height at home; {name!r} and {active!r} do not")
        own = {entry: one[entry] for entry in ARM_FIELDS} | {entry: one[entry][1:] for entry in ("chain", "home")}
        limits = {entry: one[entry][4:] for entry in ("max_velocity", "max_acceleration")}
        idle.append(ArmSpec(name=name, **own, **limits))
    return fields | {"arm_name": active, "idle_arms": tuple(idle)}


def read_shapes(
    mjcf: Path,
    base_body: str,
    chain: Sequence[ChainLink],
    fingers: Mapping[str, float],
    still: Mapping[str, float],
    idle_joints: Collection[str],
) -> Shapes:
    """Read the collision shapes of a robot, in the frames of base and chain.

    Args:
        mjcf: its MJCF file.
        base_body: name of the base's body.
        chain: torso and arm.
        fingers: travel of the fingers' joints by name [m].
        still: positions of joints that no action moves, by name [m], [rad].
        idle_joints: names of the first joints of arms that do not act.

    Raises:
        InvalidRobot: the file has collision geometry of an unknown kind, or lacks a joint.
    """
    model = mujoco.MjModel.from_xml_path(str(mjcf))
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    for joint, position in still.items():
        data.joint(joint).qpos = position
    mujoco.mj_kinematics(model, data)
    base, (offsets, _, _) = data.body(base_body), frames_of(JointTable(chain, (0.0, 0.0, 0.0), np.eye(3)))
    places = [np.eye(4)]
    places[0][:3, :3], places[0][:3, 3] = base.xmat.reshape(3, 3), base.xpos
    for place in offsets:
        places.append(places[-1] @ pose_of(place))
    names = [link.joint for link in chain]
    of_fingers = {int(model.jnt_bodyid[_joint(model, name)]): farthest for name, farthest in fingers.items()}
    geoms, links = collision_geoms(model, base_body, names, idle_joints), link_of_body(model, names)
    try:
        shapes = shapes_of(model, data, geoms, links, places, [_joint(model, name) for name in names], of_fingers)
    except ChainError as problem:
        raise InvalidRobot(str(problem)) from problem
    counts = ~is_excluded(model, np.array(geoms)[shapes.pairs])
    return shapes if counts.all() else with_pairs(shapes, shapes.pairs[counts], len(places) - 2)


def collision_geoms(
    model: mujoco.MjModel, base_body: str, joints: Sequence[str], idle_joints: Collection[str]
) -> list[int]:
    """Ids of a robot's collision geoms: the gripper's, then others, then those of idle arms.

    Args:
        model: a model that contains the robot.
        base_body: name of the base's body.
        joints: names of the joints of torso and arm.
        idle_joints: names of the first joints of arms that do not act.
    """
    idle = {int(model.jnt_bodyid[model.joint(joint).id]) for joint in idle_joints}
    for body in range(model.nbody):
        if int(model.body_parentid[body]) in idle:
            idle.add(body)
    base = model.body(base_body).id
    of_robot = is_solid(model) & (model.body_rootid[model.geom_bodyid] == base)
    links, last = link_of_body(model, joints), len(joints) - 1  # a body may come after the arm in the file

    def group(geom: int) -> tuple[bool, bool]:
        body = int(model.geom_bodyid[geom])
        return body in idle, links[body] != last

    return sorted(np.flatnonzero(of_robot)[::-1].tolist(), key=group)


def _chain(arm: ArmChain) -> tuple[ChainLink, ...]:
    """The chain of an arm, with rounded numbers."""
    return tuple(
        ChainLink(
            joint,
            _numbers(place[:3]),
            "xyz"[int(axis) % 3],
            round(float(lower), _ROUNDING),
            round(float(upper), _ROUNDING),
            prismatic=bool(axis >= 3),
            quaternion=_quaternion(place),
        )
        for joint, place, axis, lower, upper in zip(
            arm.joints, arm.offsets, arm.axes, arm.lower, arm.upper, strict=True
        )
    )


def _numbers(values: Floats) -> Any:
    """A tuple of rounded numbers, without minus zeros."""
    return tuple(round(float(value), _ROUNDING) + 0.0 for value in values)


def _quaternion(place: Floats) -> Any:
    """Quaternion wxyz of the orientation in a row of `ArmChain`."""
    if place.size == 3:
        return (1.0, 0.0, 0.0, 0.0)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, place[3:].copy())
    return tuple(float(value) + 0.0 for value in quaternion)


def _joint(model: mujoco.MjModel, name: str) -> int:
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
    if number < 0:
        known = ", ".join(repr(model.joint(k).name) for k in range(model.njnt))
        raise InvalidRobot(f"there is no joint {name!r}; there are {known}")
    return int(number)


def _gripper(model: mujoco.MjModel, finger_joints: tuple[str, ...], pads: tuple[str, ...]) -> dict[str, Any]:
    """Read pads, range and thickness of the fingers, and the gap between the pads of the closed gripper."""
    joints = [_joint(model, name) for name in finger_joints]
    geoms = pads or tuple(_only_geom(model, int(model.jnt_bodyid[joint])) for joint in joints)
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    numbers = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, name) for name in geoms]
    if min(numbers) < 0 or len(numbers) != 2:
        raise InvalidRobot(f"finger_geoms must name the two pads; there are no geoms {geoms!r}")
    along = data.xaxis[joints[0]]
    halves = [_half_extent(model, data, number, along) for number in numbers]
    apart = abs(float(along @ (data.geom_xpos[numbers[0]] - data.geom_xpos[numbers[1]])))
    return {
        "finger_geoms": geoms,
        "max_finger_position": round(min(float(model.jnt_range[joint][1]) for joint in joints), _ROUNDING),
        "finger_gap_closed": round(max(apart - sum(halves), 0.0), _ROUNDING),
        "finger_thickness": round(2 * max(halves), _ROUNDING),
    }


def _only_geom(model: mujoco.MjModel, body: int) -> str:
    """The name of a body's only collision geom."""
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    touching = [
        geom for geom in range(first, first + count) if model.geom_contype[geom] or model.geom_conaffinity[geom]
    ]
    names = [str(model.geom(geom).name) for geom in touching]
    if len(names) != 1 or not names[0]:
        raise InvalidRobot(f"name the pads in finger_geoms: {model.body(body).name!r} has the geoms {names}")
    return names[0]


def _half_extent(model: mujoco.MjModel, data: mujoco.MjData, geom: int, along: Floats) -> float:
    """Half extent of the box around a geom along a direction [m]."""
    return float(np.abs(along @ data.geom_xmat[geom].reshape(3, 3)) @ model.geom_aabb[geom, 3:])


def footprint(model: mujoco.MjModel, base: str) -> dict[str, Any]:
    """Radius and height of the cylinder about the base's axis that contains its collision geoms.

    Bodies fixed to the base are a part of it. The geoms that reach farthest out determine the cylinder, because bodies
    on top of them are narrower. If the farthest geom is not round, the outline of all geoms is returned too.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    body = model.body(base).id
    found: list[tuple[float, float, bool]] = []
    corners: list[tuple[float, float]] = []
    for geom in range(model.ngeom):
        if int(model.body_weldid[model.geom_bodyid[geom]]) == body and (
            model.geom_contype[geom] or model.geom_conaffinity[geom]
        ):
            centre = data.geom_xpos[geom] - data.xpos[body]
            x, y, z = (_half_extent(model, data, geom, axis) for axis in np.eye(3))
            is_round = model.geom_type[geom] == int(mujoco.mjtGeom.mjGEOM_CYLINDER) and x == y
            radius = float(np.hypot(*centre[:2])) + x if is_round else float(np.hypot(*(np.abs(centre[:2]) + (x, y))))
            found.append((radius, float(centre[2]) + z, bool(is_round)))
            corners += [(centre[0] + x * i, centre[1] + y * j) for i, j in itertools.product((-1.0, 1.0), repeat=2)]
    if not found:
        raise InvalidRobot(f"the base {base!r} has no geom that can touch something")
    radius, height, is_round = max(found)
    outline = () if is_round else tuple(map(_numbers, np.array(corners)[ConvexHull(corners).vertices]))
    return {"base_radius": round(radius, 6), "base_height": round(height, 6), "base_outline": outline}
