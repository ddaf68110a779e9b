"""A scripted side grasp with end-effector actions: drive before the target, reach, close, lift, drive away."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.scene.layout import TABLE_HEIGHT

STANDOFF = 0.85
PRE_GRASP = 0.14
CORRIDOR = 0.115
LIFT = 0.155
GRASP_SHARE = 0.6
"""Where on the object: high enough for the forearm to clear the table."""
DRIVE = 1.0
OPEN, CLOSED = 0.10, 0.0


@dataclass(frozen=True)
class GraspResult:
    """`lift` [m] of the target's lowest point, `slip` [m] of the target in the gripper since it closed."""

    lift: float
    is_held: bool
    slip: float
    warnings: int


def free_targets(env: RetrieveEnv) -> list[str]:
    """Objects that the gripper reaches from the front without touching another."""
    positions, radii = env.world.scene.positions, env.world.scene.half_extents[:, 1]
    free = []
    for slot, (x, y) in enumerate(positions):
        others = np.arange(len(positions)) != slot
        before = positions[others, 0] - radii[others] < x + 0.05
        beside = np.abs(positions[others, 1] - y) < CORRIDOR + radii[others]
        if x < 0.25 and not (before & beside).any():
            free.append(env.world.names[slot])
    return free


def reset_to_free_target(env: RetrieveEnv, first_seed: int = 0, farthest: float = math.inf) -> int:
    """Reset to the first scene that has a free target whose x is less than `farthest` [m]; its seed."""
    for seed in range(first_seed, first_seed + 60):
        env.reset(seed=seed)
        x = dict(zip(env.world.names, env.world.scene.positions[:, 0], strict=True))
        if near := [name for name in free_targets(env) if x[name] < farthest]:
            env.reset(seed=seed, options={"target": near[seed % len(near)]})
            return seed
    raise AssertionError("no scene has a free target")


class SideGrasp:
    """Runs the script on a freshly reset environment in "ee" mode; `record` holds what its steps returned.

    The base stops `standoff` [m] before the target, which is then `side` [m] to the left of its centre. The target is
    lifted by `lift` [m], and driven back by `drive` [m].
    """

    def __init__(
        self,
        env: RetrieveEnv,
        standoff: float = STANDOFF,
        side: float = 0.0,
        lift: float = LIFT,
        drive: float = DRIVE,
    ) -> None:
        self.env, self.standoff, self.side, self.lift, self.drive = env, standoff, side, lift, drive
        self.record: list[Any] = []
        self.controller = env.world.controller
        self.base = self.controller.state.target[:3].copy()
        self.point = env.data.site_xpos[env.world.index.tcp_site].copy()
        self.yaw, self.roll = float(self.base[2]), 0.0
        self.width = OPEN

    def run(self) -> GraspResult:
        env, slot = self.env, self.env.target_slot
        x, y = env.world.scene.positions[slot]
        height = 2 * env.world.scene.half_extents[slot, 2]
        grasp = np.array([x, y, TABLE_HEIGHT + max(env.robot.grasp_height, GRASP_SHARE * height)])
        away = np.array([PRE_GRASP, 0, 0])
        self.drive_to(np.array([self.base[0], y - self.side, 0.0]))
        self.drive_to(np.array([x - self.standoff, y - self.side, 0.0]))
        self.reach((grasp - away) + (0, 0, 0.25))
        self.reach(grasp - away)
        self.reach(grasp)
        self.width = CLOSED
        self.wait(1.0)
        before = self.object_in_gripper()
        self.reach(grasp + (0, 0, self.lift))
        lift = env.world.lowest_point(env.measurements, slot) - TABLE_HEIGHT
        self.drive_to(self.base - (self.drive, 0, 0))
        self.wait(0.5)
        slip = float(np.linalg.norm(self.object_in_gripper() - before))
        warnings = int(sum(w.number for w in env.data.warning))
        return GraspResult(lift, env.measurements.held == slot, slip, warnings)

    def object_in_gripper(self) -> NDArray[np.float64]:
        """Position (3,) of the target's centre in the TCP frame."""
        data, site = self.env.data, self.env.world.index.tcp_site
        offset = self.env.measurements.poses[self.env.target_slot, :3] - data.site_xpos[site]
        return data.site_xmat[site].reshape(3, 3).T @ offset

    def drive_to(self, goal: NDArray[np.float64], speed: float = 0.5) -> None:
        """Move the base, the gripper with it."""
        start, point, yaw = self.base.copy(), self.point.copy(), self.yaw
        rotate = _rotation(start[2]).T
        local = rotate @ (point - (start[0], start[1], 0))
        distance = max(np.linalg.norm(goal[:2] - start[:2]) / speed, abs(goal[2] - start[2]) / 0.4)
        for share in _profile(distance):
            self.base = start + share * (goal - start)
            self.point = _rotation(self.base[2]) @ local + (self.base[0], self.base[1], 0)
            self.yaw = yaw + self.base[2] - start[2]
            self.step()
        self.wait(0.4)

    def reach(self, goal: NDArray[np.float64], speed: float = 0.12) -> None:
        """Move the gripper on a straight line, level and straight ahead."""
        start, yaw = self.point.copy(), self.yaw
        for share in _profile(np.linalg.norm(goal - start) / speed):
            self.point, self.yaw = start + share * (goal - start), (1 - share) * yaw
            self.step()
        self.wait(0.4)

    def wait(self, seconds: float) -> None:
        for _ in range(round(seconds * 20)):
            self.step()

    def step(self) -> None:
        pose = np.eye(4)
        cosine, sine = np.cos(self.roll), np.sin(self.roll)
        about_approach = np.array([[1.0, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
        pose[:3, :3], pose[:3, 3] = _rotation(self.yaw) @ about_approach, self.point
        self.record.append(self.env.step(self.env.ee_action(self.base, pose, self.width)))


def _rotation(yaw: float) -> NDArray[np.float64]:
    cosine, sine = np.cos(yaw), np.sin(yaw)
    return np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1.0]])


def _profile(seconds: float) -> NDArray[np.float64]:
    """Shares 0 to 1 of a motion that starts and stops smoothly; the mean speed is two thirds of the top speed."""
    t = np.linspace(0, 1, max(round(1.5 * seconds * 20), 4) + 1)[1:]
    return t * t * (3 - 2 * t)
