"""What the head camera sees at the grasp, with and without a preference for visible targets; MuJoCo's rays decide."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from clutter_env.reporting.progress import progress_bar
from irm.arm.chain_arrays import chain_arrays
from irm.arm.kinematics import ArmChain, inverse
from irm.checks.verification import tcp_poses
from irm.floor.free_space import FreeSpace
from irm.floor.robot_outline import robot_radius
from irm.maps.cache import cached_map
from irm.queries.inverse import InverseReachabilityMap
from irm.queries.placement import BasePlacement
from irm.visibility.map import OPENING, TARGET, VisibilityMap, cached_visibility
from irm.visibility.robot_view import read_view
from irm.visibility.sight_kernel import seen_points

__all__ = ["CameraRays", "Visibility", "measure_visibility"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_TABLE = (0.8, 1.6, 0.75)
"""[m] size and height of the table in the paper's experiment."""
_HALF_RANGE = 1e-6
"""[rad] The approach yaw of a target is a random one: the planner asks so."""
_ROLLS = 36
"""Upper-arm rolls for which configurations are computed: the map has other ones."""


class CameraRays:
    """MuJoCo's answer: is a point in a camera's image, and does no geom of the robot cut the line between the two?

    A ray that begins in a geom leaves it without a hit at its beginning, so rays go both ways.
    """

    def __init__(self, robot: RobotSpec, camera: str, opening: float) -> None:
        self._model = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
        self._data = mujoco.MjData(self._model)
        self._robot, self._camera = robot, camera
        for name, angle in zip(robot.still_joints, robot.still_configuration, strict=True):
            self._data.joint(name).qpos = angle
        for name in robot.finger_joints:
            self._data.joint(name).qpos = robot.finger_position(opening)

    def seen(self, q: Floats, points: Floats) -> Bools:
        """Whether each of the points (m, 3) [m] in the base frame is seen in the configuration q (1 + n,)."""
        return self.in_image(q, points) & ~self.are_hidden(q, points)

    def in_image(self, q: Floats, points: Floats) -> Bools:
        """Whether each point is in the image, whatever is in front of it."""
        self._move(q)
        eye = self._data.camera(self._camera)
        right, up, back = eye.xmat.reshape(3, 3).T @ (points - eye.xpos).T
        half = np.radians(self._model.camera(self._camera).fovy[0]) / 2
        return (back < 0) & (np.maximum(abs(np.arctan2(right, -back)), abs(np.arctan2(up, -back))) <= half)

    def are_hidden(self, q: Floats, points: Floats) -> Bools:
        """Whether a geom is between the camera and each point, in the image or not."""
        self._move(q)
        eye = self._data.camera(self._camera).xpos.copy()
        return np.array([self._hits(eye, point) or self._hits(point, eye) for point in points], dtype=bool)

    def _move(self, q: Floats) -> None:
        for link, value in zip(self._robot.chain, q, strict=True):
            self._data.joint(link.joint).qpos = value
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)

    def _hits(self, start: Floats, end: Floats) -> bool:
        geom = np.zeros(1, dtype=np.int32)
        distance = mujoco.mj_ray(self._model, self._data, start, end - start, None, True, -1, geom, None)
        return bool(0.0 <= distance <= 1.0)


@dataclass(frozen=True)
class Visibility:
    """Bases for level grasps of random targets on a table, by μ alone and with preference for visible targets.

    Attributes:
        targets: for which a base was found.
        rays: pairs of a configuration and a target point that were compared; `disagreements` with MuJoCo's rays.
        seen, seen_preferred: share of the target's points that are seen by these rays, over the configurations of the
            best base, on average over the targets.
        mostly, mostly_preferred: targets of which more than half is seen.
        mu_ratio: μ of the preferred base over that of the best one, on average.
    """

    targets: int
    rays: int
    disagreements: int
    seen: float
    seen_preferred: float
    mostly: int
    mostly_preferred: int
    mu_ratio: float


def measure_visibility(robot: RobotSpec, targets: int, seed: int) -> Visibility:
    """Random targets on the paper's table; the base outside of the table's outline, grown by the robot's radius."""
    rm = cached_map(robot)
    inverse_map, preferred = InverseReachabilityMap(rm), cached_visibility(rm, robot)
    rng, width, depth, height = np.random.default_rng(seed), *_TABLE
    floor = FreeSpace.from_boxes([(0.0, 0.0, width, depth)], robot_radius(robot, 0.0, height) + 0.01)
    witness = _Witness(robot)
    shares, ratios = [], []
    for _ in progress_bar(range(targets), "visibility"):
        cup = rng.uniform((-width / 2, -depth / 2, height + 0.05), (width / 2, depth / 2, height + 0.15))
        yaw = rng.uniform(-np.pi, np.pi)
        answers = [_placed(inverse_map, cup, yaw, floor, prefer) for prefer in (None, preferred)]
        if all(answers):
            shares.append([witness.share(cup, answer) for answer in answers])
            ratios.append(answers[1].manipulability[0] / answers[0].manipulability[0])
    table = np.array(shares)
    mean, mostly = table.mean(axis=0), np.sum(table > 0.5, axis=0)
    return Visibility(
        targets=len(table),
        rays=witness.rays,
        disagreements=witness.disagreements,
        seen=float(mean[0]),
        seen_preferred=float(mean[1]),
        mostly=int(mostly[0]),
        mostly_preferred=int(mostly[1]),
        mu_ratio=float(np.mean(ratios)),
    )


def _placed(
    inverse_map: InverseReachabilityMap, cup: Floats, yaw: float, floor: FreeSpace, prefer: VisibilityMap | None
) -> BasePlacement:
    """The exact best base for a target, approached at a yaw."""
    around = (yaw - _HALF_RANGE, yaw + _HALF_RANGE)
    return inverse_map.query(cup, yaw_range=around, free_space=floor, exact=True, prefer=prefer)


class _Witness:
    """MuJoCo's rays for grasps, compared with the kernel's answers on the way."""

    def __init__(self, robot: RobotSpec) -> None:
        self.rays = self.disagreements = 0
        self._chain = ArmChain.from_robot(robot)
        self._view = read_view(robot, "head", OPENING)
        self._rays = CameraRays(robot, "head", OPENING)

    def share(self, cup: Floats, answer: BasePlacement) -> float:
        """Share of the target's points seen from the best base, on average over the arm's configurations."""
        x, y, yaw = answer.poses[0]
        c, s = np.cos(yaw), np.sin(yaw)
        offset = c * (cup[0] - x) + s * (cup[1] - y), c * (cup[1] - y) - s * (cup[0] - x), cup[2]
        T_base_tcp = tcp_poses(offset, answer.approach_yaw[0] - yaw)[0]
        rolls = np.linspace(-np.pi, np.pi, _ROLLS, endpoint=False)
        points = np.array(TARGET) + offset
        seen, total = np.empty(len(points), dtype=bool), []
        for q in inverse(self._chain, T_base_tcp, [float(answer.torso[0])], rolls):
            seen_points(chain_arrays(self._chain), self._view, q, points, seen)
            truth = self._rays.seen(q, points)
            self.rays += len(points)
            self.disagreements += int(np.sum(seen != truth))
            total.append(truth.mean())
        return float(np.mean(total)) if total else 0.0
