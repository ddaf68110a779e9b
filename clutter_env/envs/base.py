"""What all environments of the package share: actions, observations, pictures, saved states."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from assets.robots import RobotSpec
from assets.robots import robot as find_robot
from clutter_env.config import CONTROL_HZ, RENDER_MODES, EnvConfig
from clutter_env.envs.observation import EntryLayout, Observer
from clutter_env.envs.reset_options import ResetOptions
from clutter_env.errors import ActionError
from clutter_env.rendering.cameras import Pictures
from clutter_env.rendering.renderer import has_display
from clutter_env.scene.layout import LAYOUTS, TableScene, slot_shapes
from clutter_env.simulation.control import ControlState, checked_action
from clutter_env.simulation.ee_control import EndEffectorController, TcpFollower
from clutter_env.simulation.saved_state import SavedState, capture_physics, pack, restore_physics, unpack
from clutter_env.simulation.world import Measurements, World

__all__ = ["BaseEnv"]

_PICKLED = ("spec", "action_space", "observation_space", "_np_random", "_np_random_seed")
"""Attributes of gym.Env that a pickle takes along as they are; the spaces have random generators of their own."""
_BASE, _TWIST = 3, 6
"""Numbers of an "ee" action before the gripper's: base velocity, TCP velocity."""


class BaseEnv(gym.Env[dict[str, Any], NDArray[np.float32]], ABC):
    """A robot, a table, objects; subclasses say what the task is."""

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": CONTROL_HZ}  # noqa: RUF012
    """Of an instance on a machine without a display, "human" is left out: checkers try every mode that is listed."""

    def __init__(self, config: EnvConfig) -> None:
        self.config = config
        if not has_display():
            modes = [mode for mode in RENDER_MODES if mode != "human"]
            self.metadata = {**type(self).metadata, "render_modes": modes}
        self.render_mode = config.render_mode
        self.robot: RobotSpec = find_robot(config.robot)
        self.layout = LAYOUTS[config.layout]
        self._pictures = Pictures(config)
        self._home_world = self._make_world(slot_shapes(config.shapes, config.num_objects))
        self.world = self._home_world
        self._end_effector = EndEffectorController(self.robot) if config.control_mode == "ee" else None
        self._observer = self._make_observer()
        self._has_started = False
        self.measurements: Measurements
        self.action_space = spaces.Box(-1.0, 1.0, (self.action_size,), np.float32)
        self.observation_space = self._make_observation_space()

    # What a task defines.

    @abstractmethod
    def _draw_scene(self, options: ResetOptions) -> TableScene:
        """The scene of a new episode."""

    @abstractmethod
    def _begin(self) -> None:
        """Start the task's bookkeeping; the world and `measurements` are those of the first state."""

    @abstractmethod
    def _advance(self) -> tuple[float, bool]:
        """Bookkeeping after a step: the reward, and whether the episode has ended."""

    @abstractmethod
    def _observe(self) -> dict[str, Any]:
        """The observation."""

    @abstractmethod
    def _info(self) -> dict[str, Any]:
        """The info dictionary."""

    @abstractmethod
    def _memory(self) -> dict[str, Any]:
        """The task's bookkeeping as JSON values."""

    @abstractmethod
    def _recall(self, memory: dict[str, Any]) -> None:
        """Take up bookkeeping that `_memory` returned."""

    def _make_observer(self) -> Observer:
        """What makes the vectors of the observations; images come without the objects' states."""
        shows_objects = self.config.obs_mode == "state"
        return Observer(self.world, self.config.num_objects, shows_objects, shows_goal=shows_objects)

    def _start_posture(self) -> tuple[float, ...]:
        """Torso and arm at the start."""
        return self.robot.home

    # The Gymnasium surface.

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode; what it starts from is a function of seed and options alone.

        Raises:
            OptionError: an unknown or invalid option.
            StateError: the option `state` is not a saved state of this environment.
        """
        checked = ResetOptions.of(options)
        super().reset(seed=seed)
        if checked.state is not None:
            self.restore_state(checked.state)
        else:
            self._start(self._draw_scene(checked))
        if self.render_mode == "human":
            self.render()
        return self._observe(), self._info()

    def step(self, action: ArrayLike) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """One control step of 0.05 s.

        Raises:
            ActionError: the action is not a finite vector of the right shape; nothing has changed.
        """
        checked = checked_action(action, self.action_size)
        self._check_started("step()")
        self.measurements = self._drive(checked)
        reward, terminated = self._advance()
        if self.render_mode == "human":
            self.render()
        return self._observe(), reward, terminated, False, self._info()

    def render(self) -> NDArray[Any] | None:
        """A picture (height, width, 3) uint8, a depth image (height, width) float32 [m], or None: a window.

        Raises:
            RenderingUnavailable: no OpenGL, or no display for a window.
        """
        return self._pictures.render(self.world)

    def close(self) -> None:
        """Free the graphics."""
        self._pictures.close()

    # Ours.

    @property
    def model(self) -> mujoco.MjModel:
        """The MuJoCo model. Read it; do not write it."""
        return self.world.model

    @property
    def data(self) -> mujoco.MjData:
        """The MuJoCo data. Read it; do not write it."""
        return self.world.data

    @property
    def control_mode(self) -> str:
        """What the numbers of an action mean, "joint" or "ee"."""
        return self.config.control_mode

    @property
    def target(self) -> str:
        """Name of the target object, "" without one.

        Raises:
            ActionError: `reset` has not been called.
        """
        self._check_started("target")
        return self.world.names[self.target_slot] if self.target_slot >= 0 else ""

    @property
    def observation_layout(self) -> Mapping[str, EntryLayout]:
        """Slices and columns of the observation's entries, by name; see `observation_layout`."""
        return self._observer.layout

    @property
    def target_slot(self) -> int:
        """Index of the target among the objects."""
        assert self.world.scene is not None
        return self.world.scene.target

    @property
    def action_size(self) -> int:
        """Numbers in an action."""
        return self.world.controller.size if self.config.control_mode == "joint" else _BASE + _TWIST + 1

    def joint_action(self, q_target: ArrayLike, gripper_width: float) -> NDArray[np.float64]:
        """The action after which the motors' targets are `q_target`, as far as the limits allow.

        A trajectory sampled at 20 Hz that keeps the robot's velocity and acceleration limits (of the base: those of its
        own axes) is followed exactly; a goal farther away is approached as fast as it can be, with room to brake.

        Args:
            q_target: (4 + n,) base x, y [m], yaw [rad] in the world, torso [m], arm [rad].
            gripper_width: [m] between the pads.

        Raises:
            ActionError: not finite, the wrong shape, or this environment's control mode is "ee".
        """
        if self._end_effector is not None:
            raise ActionError("joint_action needs control_mode='joint'; this environment has 'ee', use ee_action")
        self._check_started("joint_action()")
        return self.world.controller.action_towards(q_target, gripper_width, self._is_loaded)

    def ee_action(self, base_target: ArrayLike, T_world_tcp: ArrayLike, gripper_width: float) -> NDArray[np.float64]:
        """The "ee" action that brings base and TCP targets to these, or as near as one step allows.

        Args:
            base_target: (3,) x, y [m], yaw [rad].
            T_world_tcp: (4, 4) TCP pose in the world once the base is at its target.
            gripper_width: [m] between the pads.

        Raises:
            ActionError: not finite, the wrong shape, or this environment's control mode is "joint".
        """
        if self._end_effector is None:
            raise ActionError("ee_action needs control_mode='ee'; this environment has 'joint', use joint_action")
        base, pose = np.asarray(base_target, float), np.asarray(T_world_tcp, float)
        if base.shape != (3,) or pose.shape != (4, 4) or not (np.isfinite(base).all() and np.isfinite(pose).all()):
            raise ActionError("ee_action takes base_target (3,) and T_world_tcp (4, 4), all finite")
        self._check_started("ee_action()")
        controller = self.world.controller
        goal = np.concatenate((base, controller.state.target[_BASE:]))
        velocity = controller.velocity_towards(goal, self._is_loaded)[:_BASE]
        drive = np.clip(velocity / self.robot.max_velocity[:_BASE], -1.0, 1.0)
        twist = self._end_effector.twist_towards(np.linalg.inv(_planar_pose(base)) @ pose)
        return np.concatenate((drive, twist, [controller.grip_action(gripper_width)]))

    def tcp_follower(self) -> TcpFollower:
        """A model of how the joints follow "ee" actions, for planners; independent of this environment's state."""
        return TcpFollower(self.robot)

    def save_state(self) -> bytes:
        """Everything the future depends on: physics, controller, task, random generator."""
        self._check_started("save_state()")
        scene, control = self.world.scene, self.world.controller.state
        assert scene is not None
        memory = {
            "task": self._memory(),
            "held": self.measurements.held,
            "is_touching": self.measurements.is_touching,
            "target": control.target.tolist(),
            "velocity": control.velocity.tolist(),
            "finger": control.finger,
            "wanted_tcp": None if self._end_effector is None else self._end_effector.wanted.tolist(),
            "rng": self.np_random.bit_generator.state,
        }
        return pack(SavedState(self._kind, scene, capture_physics(self.world), memory))

    def restore_state(self, state: bytes) -> None:
        """Continue from a saved state, bit for bit, also in another process.

        Raises:
            StateError: not a saved state of an environment like this one.
        """
        saved = unpack(state, self._kind)
        self._choose_world(saved.scene)
        restore_physics(self.world, saved)
        memory = saved.memory
        self.world.controller.state = ControlState(
            np.array(memory["target"]), np.array(memory["velocity"]), memory["finger"]
        )
        if self._end_effector is not None:
            self._end_effector.wanted = np.array(memory["wanted_tcp"])
        self.np_random.bit_generator.state = memory["rng"]
        self.measurements = self.world.measure_objects(memory["held"], memory["is_touching"])
        self._recall(memory["task"])
        self._has_started = True

    def __getstate__(self) -> dict[str, Any]:
        """Pickling keeps what `save_state` does; MuJoCo's own pickles forget which bodies sleep."""
        return {
            "keywords": asdict(self.config),
            "saved": self.save_state() if self._has_started else None,
            "rest": {name: self.__dict__[name] for name in _PICKLED if name in self.__dict__},
        }

    def __setstate__(self, pickled: dict[str, Any]) -> None:
        self.__init__(**pickled["keywords"])  # type: ignore[misc]
        self.__dict__.update(pickled["rest"])
        if pickled["saved"] is not None:
            self.restore_state(pickled["saved"])

    # Inside.

    @property
    def _kind(self) -> dict[str, Any]:
        """What a saved state must have in common with the environment that takes it up."""
        shared = {name: getattr(self.config, name) for name in ("num_objects", "layout", "robot", "control_mode")}
        return {"task": type(self).__name__, "mujoco": mujoco.__version__, **shared}

    def _check_started(self, call: str) -> None:
        if not self._has_started:
            raise ActionError(f"call reset() before {call}")

    @property
    def _is_loaded(self) -> bool:
        return self.measurements.held >= 0

    def _make_world(self, shapes: tuple[str, ...]) -> World:
        show_meshes = self.config.render_mode is not None or self.config.obs_mode == "rgbd"
        return World(self.robot, self.layout, shapes, self._pictures.largest, show_meshes)

    def _choose_world(self, scene: TableScene) -> None:
        """Explicit scenes may have fewer objects or other shapes than the environment's own."""
        if scene.shapes == self.world.shapes:
            return
        is_home = scene.shapes == self._home_world.shapes
        self.world = self._home_world if is_home else self._make_world(scene.shapes)

    def _start(self, scene: TableScene) -> None:
        self._choose_world(scene)
        self.world.reset(scene, self._start_posture())
        if self._end_effector is not None:
            self._end_effector.reset(self.world.controller.state.target[_BASE:])
        self.measurements = self.world.measure()
        self._has_started = True
        self._begin()

    def _drive(self, action: NDArray[np.float64]) -> Measurements:
        """Advance the physics by one control step."""
        grip = float(action[-1])
        if self._end_effector is None:
            return self.world.advance(self.measurements, action[:-1] * self.robot.max_velocity, grip)
        state = self.world.controller.state
        base = action[:_BASE] * self.robot.max_velocity[:_BASE]
        twist = action[_BASE : _BASE + _TWIST]
        arm = self._end_effector.joint_velocity(twist, state.target[_BASE:], state.velocity[_BASE:])
        return self.world.advance(self.measurements, np.concatenate((base, arm)), grip)

    def observe_world(self, target: int, hold_progress: float, lift_left: float) -> dict[str, Any]:
        """The observation that the configuration asks for; see `Observer.observe`."""
        observation: dict[str, Any] = dict(
            self._observer.observe(self.world, self.measurements, target, hold_progress, lift_left)
        )
        if self.config.obs_mode == "rgbd":
            observation |= self._pictures.observation(self.world)
        return observation

    def _make_observation_space(self) -> spaces.Dict:
        parts = dict(self._observer.space.spaces)
        if self.config.obs_mode == "rgbd":
            parts |= self._pictures.observation_spaces()
        return spaces.Dict(parts)


def _planar_pose(base: NDArray[np.float64]) -> NDArray[np.float64]:
    """T_world_base (4, 4) of a base at x, y, yaw."""
    pose = np.eye(4)
    cosine, sine = np.cos(base[2]), np.sin(base[2])
    pose[:2, :2] = ((cosine, -sine), (sine, cosine))
    pose[:2, 3] = base[:2]
    return pose
