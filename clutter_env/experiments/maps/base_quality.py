"""Quality of the bases: random targets above a table, verified by exact kinematics and by MuJoCo's collision check."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from tqdm import tqdm

from assets.robots import RobotSpec
from clutter_env.scene.layout import LAYOUTS, TABLE_HEIGHT, Layout, furniture
from irm.arm.kinematics import ArmChain
from irm.checks.verification import NotVerified, Verified, tcp_poses, verify
from irm.floor.free_space import FreeSpace
from irm.maps.cache import cached_map
from irm.queries.inverse import InverseReachabilityMap

__all__ = ["PATH", "CollisionModel", "Targets", "floor_of", "measure_targets"]

Floats = NDArray[np.float64]

PATH = np.array([(-0.10, 0, 0), (-0.05, 0, 0), (0, 0, 0), (0, 0, 0.05), (0, 0, 0.10)])
"""[m] Approach, grasp and lift, in the approach frame."""
TOUCH = 0.001
"""[m] of penetration that counts as a collision."""
BEST = 5
"""Number of bases that are verified."""
FLOOR_MARGIN = 0.01
"""[m] between base and furniture."""
FLOOR_SIZE = 2.5
"""[m] from the table's centre to the edges of the floor."""
HIGHEST = 0.25
"""[m] Largest height of targets above the table; the smallest is the robot's grasp height."""
EDGE = 0.05
"""[m] between targets and the table's edge."""


@dataclass(frozen=True)
class Targets:
    """Counts of targets.

    Attributes:
        layout: of the table.
        query: "query" or "query_path".
        targets: number of targets.
        answered: targets for which the map gives a base.
        verified_first: targets for which the best base is valid.
        verified: targets for which one of the best bases is valid.
    """

    layout: str
    query: str
    targets: int
    answered: int
    verified_first: int
    verified: int


class CollisionModel:
    """Robot, floor and furniture in a MuJoCo model of its own; the robot may collide with itself."""

    def __init__(self, robot: RobotSpec, layout: Layout) -> None:
        spec = mujoco.MjSpec.from_file(str(robot.mjcf_path))
        for geom in spec.geoms:
            if geom.contype or geom.conaffinity:
                geom.contype, geom.conaffinity = 1, 3
        _let_neighbours_touch(spec, robot)
        world, bits = spec.worldbody, {"contype": 2, "conaffinity": 0}
        world.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], **bits)
        for box in furniture(layout):
            world.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=box.position, size=box.half_extents, **bits)
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._columns = [self._model.joint(name).qposadr[0] for name in robot.drive_joints]
        for joint in robot.finger_joints:
            self._data.joint(joint).qpos = robot.max_finger_position
        for joint, angle in zip(robot.head_joints, robot.head_configuration, strict=True):
            self._data.joint(joint).qpos = angle

    def is_free(self, base: Floats, q: Floats) -> bool:
        """Whether a base pose (3,) with a configuration (1 + n,) touches nothing, itself included."""
        self._data.qpos[self._columns] = np.concatenate([base, q])
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_collision(self._model, self._data)
        return not self._data.ncon or float(self._data.contact.dist.min()) > -TOUCH


def _let_neighbours_touch(spec: mujoco.MjSpec, robot: RobotSpec) -> None:
    """Exclude contacts between bodies on the same or on neighbouring links of the arm."""
    model = spec.compile()
    link = np.zeros(model.nbody, dtype=int)
    for body in range(1, model.nbody):
        link[body] = link[model.body_parentid[body]]
        names = [model.joint(int(j)).name for j in range(model.njnt) if model.jnt_bodyid[j] == body]
        link[body] += any(name in (robot.torso_joint, *robot.arm_joints) for name in names)
    for first in range(1, model.nbody):
        for second in range(first + 1, model.nbody):
            if abs(link[first] - link[second]) <= 1:
                spec.add_exclude(bodyname1=model.body(first).name, bodyname2=model.body(second).name)


def floor_of(robot: RobotSpec, layout: Layout) -> FreeSpace:
    """Where the base may stand around a table; the floor ends at the wall, if there is one."""
    boxes = [(*box.position[:2], *(2 * half for half in box.half_extents[:2])) for box in furniture(layout)]
    back = layout.depth / 2 if layout.is_front_only else FLOOR_SIZE
    bounds = (-FLOOR_SIZE, -FLOOR_SIZE, back, FLOOR_SIZE)
    return FreeSpace.from_boxes(boxes, robot.base_radius + FLOOR_MARGIN, bounds)


def measure_targets(robot: RobotSpec, layout_name: str, count: int, with_path: bool, seed: int) -> Targets:
    """Verify bases for level TCP poses above the whole table, from grasp height to 0.25 m, with any approach yaw.

    A base is valid if some arm configuration reaches the TCP pose with no collision, self-collision included. With the
    path this holds at five waypoints, with consecutive configurations close to each other.
    """
    layout = LAYOUTS[layout_name]
    model, floor, chain = CollisionModel(robot, layout), floor_of(robot, layout), ArmChain.from_robot(robot)
    inverse_map = InverseReachabilityMap(cached_map(robot, orientations=266, pitches=(0.0,), heights=(0.7, 1.2)))
    rng = np.random.default_rng(seed)
    half = np.array([layout.depth / 2 - EDGE, layout.width / 2 - EDGE])
    offsets = PATH if with_path else PATH[2:3]
    answered = first = verified = 0
    for _ in tqdm(range(count), f"targets, {layout_name}{', path' if with_path else ''}"):
        target = np.array([*rng.uniform(-half, half), TABLE_HEIGHT + rng.uniform(robot.grasp_height, HIGHEST)])
        if with_path:
            placement = inverse_map.query_path(offsets, target=target, free_space=floor, k=BEST)
        else:
            placement = inverse_map.query(target, free_space=floor, k=BEST)
        answered += len(placement) > 0
        yaws = placement.approach_yaw

        def poses_of(rank: int, target: Floats = target, yaws: Floats = yaws) -> ArrayLike:
            """T_world_tcp of the path from the base of that rank."""
            return tcp_poses(target + _turned(offsets, yaws[rank]), yaws[rank])

        match verify(chain, placement, poses_of, model.is_free, limit=BEST):
            case Verified(rank=rank):
                verified += 1
                first += rank == 0
            case NotVerified():
                pass
    return Targets(layout_name, "query_path" if with_path else "query", count, answered, first, verified)


def _turned(offsets: Floats, yaw: float) -> Floats:
    c, s = np.cos(yaw), np.sin(yaw)
    turned: Floats = offsets @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return turned
