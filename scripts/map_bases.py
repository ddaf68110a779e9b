"""x"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from assets.robots import RobotSpec
from clutter_env.reporting.progress import progress_bar
from clutter_env.scene.layout import LAYOUTS, TABLE_HEIGHT, Layout, furniture
from irm.cache import cached_map
from irm.chain import ArmChain
from irm.free_space import FreeSpace
from irm.inverse_map import InverseReachabilityMap
from irm.placement import BasePlacement
from irm.query_options import SEPARATION
from irm.solid_boxes import SolidBoxes
from irm.verification import Verified, tcp_poses, verify
from scripts.map_figures import PosedRobot

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


TRIED = 40
"""Number of bases of a target that are tried before no base is said to be valid."""
CLOSE = 0.05
"""[m] between these."""


class QueryKind(NamedTuple):
    """A kind of query: its `name`, the `offsets` (m, 3) of its TCP positions in the approach frame [m], the `pitch` of
    the TCP, and the `half_width` of the range of its approach yaws [rad]; π for any yaw."""

    name: str
    offsets: Floats
    pitch: float
    half_width: float


KINDS = (
    QueryKind("query", PATH[2:3], 0.0, np.pi),
    QueryKind("query_path", PATH, 0.0, np.pi),
    *(
        QueryKind(f"query_path, pitch {pitch:g}, ± 10°", PATH, pitch, float(np.radians(10)))
        for pitch in (0.0, 0.3, -0.2)
    ),
)
"""The kinds that are measured. A pitch of -0.2 rad lets the gripper rise: its wrist is lower than the TCP."""


@dataclass(frozen=True)
class Targets:
    """Counts of targets.

    Attributes:
        layout: of the table.
        query: name of the kind of query.
        targets: number of targets.
        answered: targets for which the map gives a base.
        verified_first: targets for which the best base is valid.
        verified: targets for which one of the best bases is valid.
        hopeless: answered targets for which none of the `TRIED` best bases is valid.
        wrong: targets whose best base is certain and not valid.
    """

    layout: str
    query: str
    targets: int
    answered: int
    verified_first: int
    verified: int
    hopeless: int
    wrong: int


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
        self._posed = PosedRobot(spec, robot)

    def is_free(self, base: Floats, q: Floats) -> bool:
        """Whether a base pose (3,) with a configuration (1 + n,) touches nothing, itself included."""
        model, data = self._posed.model, self._posed.data
        self._posed.put(base, q)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        return not data.ncon or float(data.contact.dist.min()) > -TOUCH


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


def solids_of(robot: RobotSpec, layout: Layout) -> SolidBoxes:
    """Table and other furniture, as obstacles of gripper and wrist."""
    return SolidBoxes.of(
        robot, [(*box.position, *(2 * half for half in box.half_extents)) for box in furniture(layout)]
    )


def measure_targets(robot: RobotSpec, layout_name: str, count: int, kind: QueryKind, seed: int) -> Targets:
    """Verify bases for TCP poses above the whole table, from grasp height to 0.25 m, each with one range of yaws.

    A base is valid if some arm configuration reaches the TCP pose with no collision, self-collision included. On a path
    this holds at every waypoint, with consecutive configurations close to each other. A target may have no valid base
    at all: the gripper of a pose itself, or its wrist, may be inside the table.
    """
    layout = LAYOUTS[layout_name]
    model, chain = CollisionModel(robot, layout), ArmChain.from_robot(robot)
    around = floor_of(robot, layout), solids_of(robot, layout)
    is_level = kind.half_width == np.pi
    parameters: dict[str, Any] = {"orientations": 266, "pitches": (0.0,), "heights": (0.7, 1.2)} if is_level else {}
    inverse_map = InverseReachabilityMap(cached_map(robot, **parameters))
    rng = np.random.default_rng(seed)
    half = np.array([layout.depth / 2 - EDGE, layout.width / 2 - EDGE])
    counts: Counter[str] = Counter()
    for _ in progress_bar(range(count), f"targets, {layout_name}, {kind.name}"):
        target = np.array([*rng.uniform(-half, half), TABLE_HEIGHT + rng.uniform(robot.grasp_height, HIGHEST)])
        yaw = 0.0 if is_level else rng.uniform(-np.pi, np.pi)
        counts += _verify_target(chain, inverse_map, model, around, target, (kind, yaw))
    columns = ("answered", "verified_first", "verified", "hopeless", "wrong")
    return Targets(layout_name, kind.name, count, *(counts[column] for column in columns))


def _verify_target(
    chain: ArmChain,
    inverse_map: InverseReachabilityMap,
    model: CollisionModel,
    around: tuple[FreeSpace, SolidBoxes],
    target: Floats,
    how: tuple[QueryKind, float],
) -> Counter[str]:
    """The counts of one target, with the middle of its range of yaws."""
    kind, yaw = how
    floor, solids = around
    keywords: dict[str, Any] = {"free_space": floor, "pitch": kind.pitch}
    keywords |= {"yaw_range": (yaw - kind.half_width, yaw + kind.half_width)}

    def place(k: int, separation: float) -> BasePlacement:
        if len(kind.offsets) > 1:
            about: dict[str, Any] = {"target": target, "solids": solids}
            return inverse_map.query_path(kind.offsets, k=k, separation=separation, **about, **keywords)
        return inverse_map.query(target, k=k, separation=separation, **keywords)

    def valid_rank(placement: BasePlacement, limit: int) -> int:
        """The first valid one of the best bases, `limit` if none is."""
        yaws = placement.approach_yaw

        def poses_of(rank: int) -> ArrayLike:
            """T_world_tcp of the path from the base of that rank."""
            return tcp_poses(target + _turned(kind.offsets, yaws[rank]), yaws[rank], kind.pitch)

        verified = verify(chain, placement, poses_of, model.is_free, limit=limit)
        return verified.rank if isinstance(verified, Verified) else limit

    placement = place(BEST, SEPARATION)
    if not len(placement):
        return Counter()
    rank = valid_rank(placement, BEST)
    is_hopeless = rank == BEST and valid_rank(place(TRIED, CLOSE), TRIED) == TRIED
    is_wrong = bool(placement.certain[0]) and rank > 0
    return Counter(answered=1, verified_first=rank == 0, verified=rank < BEST, hopeless=is_hopeless, wrong=is_wrong)


def _turned(offsets: Floats, yaw: float) -> Floats:
    c, s = np.cos(yaw), np.sin(yaw)
    turned: Floats = offsets @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return turned
