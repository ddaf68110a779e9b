"""The reality dial: the robot's knowledge differs from the world, and its commands arrive late.

`reality=1` is a mobile manipulator without special care, values between scale every effect (`LEVELS`). All are drawn
from the seed, after the scene, which stays that of `reality=0`. Rewards, success and info say the truth.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from clutter_env.scene.household import HouseholdScene
from clutter_env.scene.table_scene import TableScene
from clutter_env.simulation.world import Measurements, World


@dataclass(frozen=True)
class Levels:
    """Sizes of the effects at `reality=1`: standard deviations unless stated otherwise. See
    docs/environments/reality.md.

    Attributes:
        pose: [m] of an object's position along x and y, in every frame. Heights are those of the support.
        yaw: [rad] of an object's heading, in every frame.
        camera: [m] of the camera's position along each axis, in every episode.
        camera_angle: [rad] of its orientation about each axis, in every episode.
        joint_zero: [rad] and [m] of the zero of each joint, in every episode.
        joint: [rad] and [m] of each joint reading.
        base: [m] and [rad] of the base's own pose, in every step.
        velocity: [rad/s], [m/s] of each joint velocity.
        observation_delay, action_delay: control steps.
        dropped: probability that a frame of the cameras is dropped. The last frame is then repeated.
        friction: largest relative error of an object's sliding friction, in the hand as on the table, uniform.
        mass, size: the same of an object's mass and of its half extents.
    """

    pose: float = 0.005
    yaw: float = 0.1
    camera: float = 0.005
    camera_angle: float = math.radians(0.5)
    joint_zero: float = 0.003
    joint: float = 0.001
    base: float = 0.002
    velocity: float = 0.01
    observation_delay: float = 2.0
    action_delay: float = 1.0
    dropped: float = 0.1
    friction: float = 0.3
    mass: float = 0.5
    size: float = 0.05


LEVELS = Levels()
_GATE = 4.0
"""Standard deviations of a position within which an object is taken to stand where it stood."""
_FRAMES = 20
"""Frames of which a mean is taken: one second."""


class Senses:
    """The robot's knowledge: the world with nominal sizes, as measured by its sensors, with a delay.

    Attributes:
        world: the known world. Its model has nominal sizes and camera poses, its data the last measurements.
        measurements: the last measurements of the objects.
    """

    measurements: Measurements

    def __init__(self, shares: Mapping[str, float], make_world: Callable[..., World]) -> None:
        """Make the senses of one environment.

        Args:
            shares: of the effects, by name, 0 to 1.
            make_world: makes a world for given `shapes`.
        """
        self._shares, self._make_world = shares, make_world
        self.world: World | None = None

    def begin(self, world: World, scene: TableScene, rng: np.random.Generator) -> TableScene:
        """Start an episode: draw its errors, and set up friction and cameras. Return the true scene."""
        self._rng, size = rng, scene.num_objects
        if self.world is None or self.world.shapes != world.shapes:
            self.world = self._make_world(shapes=world.shapes)
        known = self.world
        known.reset(scene)
        sizes = 1 + rng.uniform(-1, 1, size) * self._level("size", "size")
        masses = 1 + rng.uniform(-1, 1, size) * self._level("mass", "mass")
        frictions = 1 + rng.uniform(-1, 1, size) * self._level("friction", "friction")
        shift, turn = rng.normal(size=(2, 3))
        self._shift, self._turn = shift * self._level("camera", "camera"), turn * self._level("camera", "camera_angle")
        drives = len(known.index.drive_qpos)
        self._zeros = np.append(np.zeros(3), rng.normal(size=drives - 3)) * self._level("joints", "joint_zero")
        self._write_model(world.model, known.model, world, frictions)
        delay, wait = self._delays
        self._states: deque[tuple[Any, ...]] = deque(maxlen=delay + 1)
        self._images: deque[Any] = deque(maxlen=delay + 1)
        self._actions: deque[Any] = deque(maxlen=wait + 1)
        self._seen_poses: NDArray[np.float64] | None = None
        self._shown: Any = None
        self._is_dropped = False
        self._means, self._counts = np.zeros((size, 2)), np.zeros(size)
        if isinstance(scene, HouseholdScene):  # sizes and masses are those of the kinds
            return scene
        return replace(scene, half_extents=scene.half_extents * sizes[:, None], masses=scene.masses * masses)

    def late(self, action: NDArray[np.float64], still: NDArray[np.float64]) -> NDArray[np.float64]:
        """The delayed action that arrives now. Before the first arrives it is `still`, which changes nothing."""
        self._actions.append(action)
        return np.asarray(self._actions[0] if len(self._actions) == self._actions.maxlen else still)

    @property
    def on_the_way(self) -> list[NDArray[np.float64]]:
        """The actions that have been chosen and not yet arrived."""
        chosen = list(self._actions)
        return chosen[1:] if len(chosen) == self._actions.maxlen else chosen

    def observe(self, world: World, measurements: Measurements) -> None:
        """Measure: `world` and `measurements` of these senses are those of the frame that arrives now."""
        known, data = self.world, world.data
        assert known is not None
        lowest = [world.lowest_point(measurements, slot) for slot in range(known.index.num_objects)]
        self._states.append((data.qpos.copy(), data.qvel.copy(), measurements, lowest, world.controller.state))
        qpos, qvel, old, lowest, control = self._states[0]
        index, rng = known.index, self._rng
        drive = qpos[index.drive_qpos]
        noise = rng.normal(size=(2, len(drive)))
        levels = [*[self._level("joints", "base")] * 3, *[self._level("joints", "joint")] * (len(drive) - 3)]
        known.data.qpos[:], known.data.qvel[:] = qpos, qvel
        known.data.qpos[index.drive_qpos] = drive + self._zeros + noise[0] * levels
        known.data.qvel[index.drive_dof] += noise[1] * self._level("joints", "velocity")
        poses = self._noisy_poses(old.poses, qpos[index.drive_qpos[:3]], known.data.qpos[index.drive_qpos[:3]])
        self._is_dropped = bool(rng.random() < self._level("frames", "dropped"))
        if self._seen_poses is None or not self._is_dropped:
            self._seen_poses = poses
            seen = replace(old, poses=poses)
            for slot, low in enumerate(lowest):  # so that it stands as high with the size that it is thought to have
                poses[slot, 2] += low - known.lowest_point(seen, slot)
        seen = replace(old, poses=self._seen_poses)
        known.data.qpos[index.object_qpos] = self._tracked(seen).ravel()
        known.data.time = data.time
        known.controller.state = control
        mujoco.mj_kinematics(known.model, known.data)
        self.measurements = seen

    @property
    def latency(self) -> int:
        """Control steps by which actions and observations together are late."""
        return sum(self._delays)

    @property
    def pose_accuracy(self) -> float:
        """[m] Error of tracked object poses that is seldom exceeded."""
        return 3 * self._level("camera", "camera") + self._level("poses", "pose") + 2 * self._level("joints", "base")

    @property
    def _delays(self) -> tuple[int, int]:
        """Control steps by which observations and actions are late."""
        names = ("observation_delay", "action_delay")
        observation, action = (math.floor(self._level(name, name) + 0.5) for name in names)
        return observation, action

    def _tracked(self, seen: Measurements) -> NDArray[np.float64]:
        """Poses (n, 7) for planners: the mean of the last frames for objects at rest, otherwise the last measured
        poses.

        An object in the gripper, or seen farther from its mean than noise explains, has moved.
        """
        poses, gate = seen.poses.copy(), _GATE * self._level("poses", "pose")
        away = np.hypot(*(poses[:, :2] - self._means).T)
        is_new = (away > gate) | (self._counts == 0)
        is_new[[slot for slot in seen.grip.held if slot >= 0]] = True
        self._counts = np.where(is_new, 1, np.minimum(self._counts + (not self._is_dropped), _FRAMES))
        self._means += np.where(is_new, 1.0, 1 / self._counts)[:, None] * (poses[:, :2] - self._means)
        poses[:, :2] = self._means
        return poses

    def arriving(self, images: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """The delayed images that arrive now, if `images` are the present images. The caller owns the result."""
        self._images.append(images)
        if self._shown is None or not self._is_dropped:
            self._shown = self._images[0]
        return {name: image.copy() for name, image in self._shown.items()}

    def _level(self, effect: str, name: str) -> float:
        return float(self._shares[effect] * getattr(LEVELS, name))

    def _noisy_poses(self, poses: NDArray[np.float64], base: Any, known_base: Any) -> NDArray[np.float64]:
        """World poses (n, 7) as the camera gives them: relative to the base, which itself is not exactly known."""
        rng, noisy = self._rng, poses.copy()
        noise = rng.normal(size=(len(poses), 3))
        yaws = noise[:, 2] * self._level("poses", "yaw") + self._turn[2] + known_base[2] - base[2]
        relative = _rotated(poses[:, :2] - base[:2], -base[2])
        seen = _rotated(relative, self._turn[2]) + self._shift[:2] + noise[:, :2] * self._level("poses", "pose")
        noisy[:, :2] = known_base[:2] + _rotated(seen, known_base[2])
        for row, half in zip(noisy, yaws / 2, strict=True):
            mujoco.mju_mulQuat(row[3:], np.array((math.cos(half), 0.0, 0.0, math.sin(half))), row[3:].copy())
        return noisy

    def _write_model(
        self, model: mujoco.MjModel, known: mujoco.MjModel, world: World, frictions: NDArray[np.float64]
    ) -> None:
        """Write this episode's friction and camera poses into the true model. Every entry is written every time."""
        objects = world.index.object_geoms
        model.geom_friction[:, 0] = known.geom_friction[:, 0]
        model.geom_friction[objects, 0] *= frictions[world.index.geom_slots]
        model.cam_pos[:] = known.cam_pos + self._shift
        angle, turn = float(np.linalg.norm(self._turn)), np.array((1.0, 0.0, 0.0, 0.0))
        if angle > 0:
            mujoco.mju_axisAngle2Quat(turn, self._turn / angle, angle)
        for camera in range(model.ncam):
            mujoco.mju_mulQuat(model.cam_quat[camera], known.cam_quat[camera], turn)


def _rotated(points: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    """Points (n, 2) turned by an angle."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return points @ np.array(((cosine, sine), (-sine, cosine)))
