"""Where a robot's level gripper reaches, and home configurations from which it gets there with little motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from clutter_env.scene.layout import TABLE_HEIGHT
from irm.chain import ArmChain
from irm.ik.solutions import arm_solutions, free_angles, solver_arrays
from irm.kinematics import fk_frames
from planners.collision.world import CollisionWorld
from planners.scene import RobotState, Scene

__all__ = ["HomeCandidate", "LevelReach", "home_candidates", "level_reach", "touches_itself"]

Array = NDArray[np.float64]

STEP = 0.05
"""[m] between gripper positions that are tried."""
_TORSOS, _ANGLES = 6, 18
"""Values of the free parameters that are tried."""
_HOME_HEIGHTS = (1.10, 1.15, 1.20)
"""[m] of the TCP at home: above the objects on a table, with one in the gripper."""
_ELBOW_ABOVE = 0.05
"""[m] An elbow that much above the TCP keeps the forearm off the table."""
_TORSO_WEIGHT = 5.0
"""[rad/m] What a metre of the torso counts beside a radian of a joint."""


class LevelReach(NamedTuple):
    """TCP positions before the robot that a level gripper, yaw 0, reaches without the robot touching itself.

    Attributes:
        x, y, z: (nx,), (ny,), (nz,) [m] in the base frame.
        reached: (nx, ny, nz).
    """

    x: Array
    y: Array
    z: Array
    reached: NDArray[np.bool_]


class HomeCandidate(NamedTuple):
    """A configuration `q` (1 + n,) with a level gripper, and its mean distance to grasps [rad]."""

    q: Array
    distance: float


class _Arm:
    """All configurations of a robot for a TCP pose, without those in which it touches itself."""

    def __init__(self, robot: RobotSpec) -> None:
        self.chain = ArmChain.from_robot(robot)
        self.solver = solver_arrays(self.chain)
        self.angles = free_angles(self.chain, _ANGLES)
        self.torsos = np.unique(np.linspace(self.chain.lower[0], self.chain.upper[0], _TORSOS))
        state = RobotState(np.zeros(3), np.array(robot.home), robot.max_finger_position)
        self.world = CollisionWorld.from_scene(Scene(robot, state, (), ()))
        self.opening = robot.max_opening
        self._found = np.empty((8, self.chain.size))

    def configurations(self, x: float, y: float, z: float, pitch: float = 0.0, yaw: float = 0.0) -> Array:
        """(k, 1 + n) for a TCP at a place [m] with a pitch and a yaw [rad]."""
        c, s, d, level = np.cos(yaw), np.sin(yaw), np.sin(pitch), np.cos(pitch)
        R = np.array([[c * level, -s, c * d], [s * level, c, s * d], [-d, 0.0, level]])
        p, rows = np.array([x, y, z]), [np.empty((0, self.chain.size))]
        for torso in self.torsos:
            for angle in self.angles:
                count = arm_solutions(self.solver, R, p, float(torso), float(angle), self._found)
                rows.append(self._found[:count].copy())
        return np.concatenate(rows)

    def free(self, Q: Array) -> NDArray[np.bool_]:
        """(k,) whether the robot does not touch itself or the floor in configurations (k, 1 + n)."""
        return np.asarray(self.world.hits_many(np.zeros(3), Q, self.opening) == 0)

    def elbow_heights(self, Q: Array) -> Array:
        """(k,) [m] of the elbow above the TCP."""
        n = self.chain.size
        R, p, heights = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3)), np.empty(len(Q))
        for k, q in enumerate(Q):
            fk_frames(self.chain.offsets, self.chain.axes, self.chain.tip, q, R, p)
            heights[k] = p[self.solver.elbow, 2] - p[n, 2]
        return heights


def touches_itself(robot: RobotSpec) -> tuple[str, ...]:
    """What the robot touches in its home configuration, on an empty floor."""
    arm = _Arm(robot)
    return arm.world.names_of(arm.world.hits(np.zeros(3), robot.home, robot.max_opening))


def level_reach(robot: RobotSpec) -> LevelReach:
    """Where the level gripper of a robot reaches straight ahead."""
    arm = _Arm(robot)
    height = TABLE_HEIGHT + robot.grasp_height
    x, y = np.arange(0.3, 1.301, STEP), np.arange(-0.8, 0.801, 2 * STEP)
    z = np.array([height - 0.4, height - 0.2, height, height + 0.2, height + 0.4])
    reached = np.zeros((x.size, y.size, z.size), dtype=np.bool_)
    for i, j, k in np.ndindex(reached.shape):
        found = arm.configurations(float(x[i]), float(y[j]), float(z[k]))
        reached[i, j, k] = bool(len(found)) and bool(arm.free(found).any())
    return LevelReach(x, y, z, reached)


def home_candidates(robot: RobotSpec, count: int = 3) -> list[HomeCandidate]:
    """Configurations for `home`, best first: near to the grasps of objects on a table, with a high elbow.

    The present home of the robot does not matter.
    """
    arm = _Arm(robot)
    goals, table = [], TABLE_HEIGHT + robot.grasp_height
    for pitch, height in ((0.0, table), (np.pi / 3, table + 0.06), (np.pi / 2, table + 0.08)):
        for x in (0.6, 0.75, 0.9):
            for yaw in (-0.5, 0.0, 0.5):
                found = arm.configurations(x, 0.0, height, pitch, yaw)
                found = found[arm.elbow_heights(found) > _ELBOW_ABOVE]
                if len(found):
                    goals.append(_wrapped(found, arm.chain))
    candidates = []
    for x in np.arange(0.45, 0.76, STEP):
        for z in _HOME_HEIGHTS:
            found = arm.configurations(float(x), 0.0, z)
            found = found[arm.elbow_heights(found) > _ELBOW_ABOVE]
            candidates += list(_wrapped(found[arm.free(found)], arm.chain)) if len(found) else []
    weight = np.array([_TORSO_WEIGHT, *[1.0] * (arm.chain.size - 1)])
    rated = [
        HomeCandidate(q, float(np.mean([np.linalg.norm((goal - q) * weight, axis=1).min() for goal in goals])))
        for q in (candidates if goals else [])
    ]
    return sorted(rated, key=lambda candidate: candidate.distance)[:count]


def _wrapped(Q: Array, chain: ArmChain) -> Array:
    """Configurations with joints that go round in [-π, π]."""
    turned = (Q + np.pi) % (2 * np.pi) - np.pi
    goes_round = chain.upper - chain.lower > 2 * np.pi
    return np.asarray(np.where(goes_round, turned, Q))
