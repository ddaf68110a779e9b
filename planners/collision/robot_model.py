"""The robot's collision primitives, read from its MJCF, as arrays for kernels."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from irm.chain import ArmChain
from irm.ik.solutions import SolverArrays, solver_arrays
from irm.kinematics import fk_frames
from planners.collision.geometry import BOX, CYLINDER

__all__ = ["BASE", "GeometryError", "RobotArrays", "collision_geoms", "link_of_body", "robot_arrays"]

_CORES = {
    int(mujoco.mjtGeom.mjGEOM_BOX): BOX,
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): BOX,
    int(mujoco.mjtGeom.mjGEOM_SPHERE): BOX,
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): CYLINDER,
}


BASE = -1
"""Link number of what is fixed to the base; 0 is the torso with the head, 1 … n are the links of the arm."""


class GeometryError(ValueError):
    """A robot with collision geometry other than boxes, capsules, cylinders and spheres."""


class RobotArrays(NamedTuple):
    """A robot for kernels: a chain of n joints and p collision solids, those of the gripper first. Lengths in metres.

    Attributes:
        offsets: (n, 3 or 12), `axes` (n,), `tip` (3,), `lower`, `upper` (n,): see `ArmChain`.
        ik: its inverse kinematics.
        core: (p,) BOX or CYLINDER; `half` (p, 3) its half extents; `radius` (p,) by which it is grown.
        bound: (p,) radius of the sphere about the solid's centre that contains it.
        link: (p,) BASE, 0 (torso with head and idle arms) … n - 1; `position` (p, 3) and `rotation` (p, 3, 3) in that
            link's frame.
        slides: (p,) whether it is part of a finger; `slide` (p, 3) its motion in its link per metre of that.
        gap: opening of the closed gripper; `slide_end`: upper limit of the finger joints.
        self_pairs: (s, 2) solids checked for self-collision: those on links that are not neighbours.
        held_from: solids from this one on are checked against the held object; those before are the gripper's.
        reach: (3 + n,) upper bound of the motion of any point of the robot per radian or metre of each joint.
        tip_reach: (3 + n,) the same for the TCP alone.
    """

    offsets: NDArray[np.float64]
    axes: NDArray[np.int64]
    tip: NDArray[np.float64]
    ik: SolverArrays
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    core: NDArray[np.int64]
    half: NDArray[np.float64]
    radius: NDArray[np.float64]
    bound: NDArray[np.float64]
    link: NDArray[np.int64]
    position: NDArray[np.float64]
    rotation: NDArray[np.float64]
    slides: NDArray[np.bool_]
    slide: NDArray[np.float64]
    gap: float
    slide_end: float
    self_pairs: NDArray[np.int64]
    held_from: int
    reach: NDArray[np.float64]
    tip_reach: NDArray[np.float64]


def collision_geoms(model: mujoco.MjModel, robot: RobotSpec) -> list[int]:
    """Ids of the robot's geoms that can touch something: from the gripper to the base, then those of idle arms."""
    base = model.body(robot.base_body).id
    idle = _idle_bodies(model, robot)
    found = [
        geom
        for geom in reversed(range(model.ngeom))
        if int(model.body_rootid[model.geom_bodyid[geom]]) == base
        and (model.geom_contype[geom] or model.geom_conaffinity[geom])
    ]
    return sorted(found, key=lambda geom: int(model.geom_bodyid[geom]) in idle)


def link_of_body(model: mujoco.MjModel, robot: RobotSpec) -> list[int]:
    """The link that each body of a model belongs to: that of the nearest joint of the chain that moves it.

    The head belongs to the torso, the fingers to the last link; BASE for the base and for what is not of the robot.
    """
    movers = {int(model.joint(link.joint).bodyid[0]): index for index, link in enumerate(robot.chain)}
    links: list[int] = []
    for body in range(model.nbody):  # parents have lower numbers than their children
        links.append(movers.get(body, links[int(model.body_parentid[body])] if body else BASE))
    return links


def _idle_bodies(model: mujoco.MjModel, robot: RobotSpec) -> set[int]:
    """The bodies of arms that are not active."""
    found = {int(model.jnt_bodyid[model.joint(arm.joints[0]).id]) for arm in robot.idle_arms}
    for body in range(model.nbody):
        if int(model.body_parentid[body]) in found:
            found.add(body)
    return found


@cache
def robot_arrays(robot: RobotSpec) -> RobotArrays:
    """The collision solids of a robot, with its head and idle arms in `robot.still_configuration`; read once.

    Raises:
        GeometryError: its MJCF has a collision geom that is no box, capsule, cylinder or sphere.
    """
    model = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    for joint, angle in zip(robot.still_joints, robot.still_configuration, strict=True):
        data.joint(joint).qpos = angle
    mujoco.mj_kinematics(model, data)
    geoms = collision_geoms(model, robot)
    links = link_of_body(model, robot)
    chain = ArmChain.from_robot(robot)
    link = np.array([links[int(model.geom_bodyid[geom])] for geom in geoms], dtype=np.int64)
    frames = _Frames.of(chain, data.body(robot.base_body))
    poses = [frames.pose_in(index, data.geom(geom)) for geom, index in zip(geoms, link, strict=True)]
    position = np.array([p for p, _ in poses])
    rotation = np.array([R for _, R in poses])
    core, half, radius, bound = _shapes(model, geoms)
    slide = _finger_directions(model, data, robot, geoms, frames.R[chain.size - 1])
    reach = bound + robot.max_finger_position * (slide != 0).any(axis=1)
    last = np.array([chain.size - 1])
    return RobotArrays(
        offsets=chain.offsets,
        axes=chain.axes,
        tip=chain.tip,
        ik=solver_arrays(chain),
        lower=chain.lower,
        upper=chain.upper,
        core=core,
        half=half,
        radius=radius,
        bound=bound,
        link=link,
        position=position,
        rotation=rotation,
        slides=(slide != 0).any(axis=1),
        slide=slide,
        gap=robot.finger_gap_closed,
        slide_end=robot.max_finger_position,
        self_pairs=_pairs_of_distant_links(link),
        held_from=int(np.argmax(link < chain.size - 1)),
        reach=_reach(chain, link, position, reach),
        tip_reach=_reach(chain, last, chain.tip[None, :3], np.zeros(1)),
    )


class _Frames(NamedTuple):
    """The frames of all links at zero, then that of the base, in the world: `R` (n + 1, 3, 3) and `p` (n + 1, 3)."""

    R: NDArray[np.float64]
    p: NDArray[np.float64]

    @classmethod
    def of(cls, chain: ArmChain, base: Any) -> _Frames:
        """Those of a chain on a base; `base` is a body's view of the data."""
        R, p = np.empty((chain.size + 1, 3, 3)), np.empty((chain.size + 1, 3))
        fk_frames(chain.offsets, chain.axes, chain.tip, np.zeros(chain.size), R, p)
        R[BASE], p[BASE] = np.eye(3), 0.0
        turn = base.xmat.reshape(3, 3)
        return cls(turn @ R, base.xpos + p @ turn.T)

    def pose_in(self, link: int, geom: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Position (3,) and orientation (3, 3) in a link, or the base, of a geom; `geom` is its view of the data."""
        R = self.R[link]
        return R.T @ (geom.xpos - self.p[link]), R.T @ geom.xmat.reshape(3, 3)


def _shapes(
    model: mujoco.MjModel, geoms: list[int]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Core, half extents, radius and bounding radius of each geom."""
    core, half, radius = [], [], []
    for geom in geoms:
        kind, size = int(model.geom_type[geom]), model.geom_size[geom]
        if kind not in _CORES:
            known = ", ".join(mujoco.mjtGeom(known).name for known in _CORES)
            raise GeometryError(f"geom {model.geom(geom).name!r} is none of {known}")
        is_round = _CORES[kind] == BOX and kind != int(mujoco.mjtGeom.mjGEOM_BOX)
        core.append(_CORES[kind])
        radius.append(size[0] if is_round else 0.0)
        if _CORES[kind] == CYLINDER:
            half.append([size[0], size[0], size[1]])
        else:
            half.append([0.0, 0.0, size[1]] if is_round else list(size))
    halves = np.array(half)
    diagonal = np.linalg.norm(halves, axis=1)
    round_diagonal = np.hypot(halves[:, 0], halves[:, 2])
    bound = np.where(np.array(core) == CYLINDER, round_diagonal, diagonal) + np.array(radius)
    return np.array(core, dtype=np.int64), halves, np.array(radius), bound


def _finger_directions(
    model: mujoco.MjModel, data: mujoco.MjData, robot: RobotSpec, geoms: list[int], gripper: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Motion of each geom in the last link per metre of the finger joint, (p, 3); 0 for geoms not on a finger.

    `gripper` (3, 3) is the orientation of the last link.
    """
    joints = {int(model.jnt_bodyid[joint]): joint for joint in (model.joint(name).id for name in robot.finger_joints)}
    slide = np.zeros((len(geoms), 3))
    for row, geom in enumerate(geoms):
        body = int(model.geom_bodyid[geom])
        if body in joints:
            slide[row] = gripper.T @ data.xaxis[joints[body]]
    return slide


def _pairs_of_distant_links(link: NDArray[np.int64]) -> NDArray[np.int64]:
    """Pairs of solids that are neither on the same link nor on neighbouring links."""
    pairs = [(i, j) for i in range(len(link)) for j in range(i + 1, len(link)) if abs(link[i] - link[j]) > 1]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def _reach(
    chain: ArmChain, link: NDArray[np.int64], position: NDArray[np.float64], bound: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Per joint, upper bound of the distance from its axis of any point that it turns; 1 for slides."""
    reach = np.ones(3 + chain.size)
    reach[2] = max(_leg_length(chain, BASE, 2, *leg) for leg in zip(link, position, bound, strict=True))
    for joint in range(1, chain.size):
        axis = int(chain.axes[joint])
        legs = [leg for leg in zip(link, position, bound, strict=True) if leg[0] >= joint]
        reach[3 + joint] = max(_leg_length(chain, joint, axis, *leg) for leg in legs)
    return reach


def _leg_length(
    chain: ArmChain, joint: int, axis: int, link: int, position: NDArray[np.float64], bound: float
) -> float:
    """[m] from the axis of a joint to the farthest point of a sphere on a later link, with the arm stretched out."""
    legs = [*chain.offsets[joint + 1 : link + 1, :3], position]
    across = np.delete(np.arange(3), axis)
    return float(np.linalg.norm(legs[0][across]) + sum(np.linalg.norm(leg) for leg in legs[1:]) + bound)
