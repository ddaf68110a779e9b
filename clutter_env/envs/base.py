"""The base of all environments of the package: actions, observations, rendering, saved states."""

from __future__ import annotations

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, fields
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import gymnasium as gym
import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from assets import RobotSpec, UnknownRobot, robot as find_robot
from clutter_env.config import CONTROL_HZ, RENDER_MODES, EnvConfig
from clutter_env.envs.observation import EntryLayout, Observer
from clutter_env.envs.reality import Senses
from clutter_env.envs.reset_options import ResetOptions, draw_scene
from clutter_env.envs.success import LIFT_HEIGHT, OPENED_SHARE, SuccessMonitor, checked_memory
from clutter_env.errors import ActionError, ConfigError, OptionError, StateError
from clutter_env.rendering.cameras import EnvRenderer
from clutter_env.rendering.renderer import has_display
from clutter_env.scene.household import as_household
from clutter_env.scene.layout import LAYOUTS, Layout, supports_of
from clutter_env.scene.table_scene import TableScene
from clutter_env.simulation.control import STILL, ControlState, checked_action, checked_vector
from clutter_env.simulation.pressing import REMEMBERED, Pressing, total_slide
from clutter_env.simulation.robot_check import check_robot
from clutter_env.simulation.saved_state import (
    Fields,
    capture_physics,
    check_generator,
    check_quaternions,
    pack,
    read_physics,
    restore_physics,
    unpack,
)
from clutter_env.simulation.world import Grip, Measurements, World

if TYPE_CHECKING:
    from clutter_env.simulation.end_effector import EndEffectorController, TcpFollower

_BASE, _TWIST = 3, 6
"""Numbers of an "ee" action before the gripper's: base velocity, TCP velocity."""
_MEMORY = ("task", "monitor", "grip", "pressing", "target", "velocity", "fingers", "end_effector", "rng")
"""Entries of a saved state's memory: variables of task, success monitor, controller and environment besides the
physics."""
_PICKLED = ("spec", "action_space", "observation_space", "_np_random", "_np_random_seed")
"""Attributes of gym.Env that a pickle keeps unchanged. The spaces have random generators of their own."""


class BaseEnv(gym.Env[dict[str, Any], NDArray[np.float32]], ABC):
    """A robot, a table and objects. Subclasses define the task by the abstract methods.

    All numbers of an action are in [-1, 1]. "joint": base forward, left, yaw rate, torso and arm joint rates, each a
    share of the maximum. "ee": base forward, left, yaw rate, then linear and angular TCP velocity in the base frame.
    Then comes the opening of each gripper and, with head="commanded", the rates of the head's joints. Both modes result
    in joint velocities for `JointController.advance`.

    Attributes:
        world: the simulated world. Explicit scenes may have another.
        measurements: of the present state.
        action_size: length of an action.

    Raises:
        ConfigError: the robot's data do not fit its MJCF file.
    """

    measurements: Measurements
    _monitor: SuccessMonitor

    has_target: ClassVar[bool] = True
    """Whether one of the objects, if there are any, is the target."""
    opens: ClassVar[tuple[str | None, ...]] = (None,)
    """Drawers or doors that the layouts of this task may have: values of `Layout.opens`."""
    _shows_goal: ClassVar[bool] = True
    """Whether the target's goal is part of the observation."""
    task_modules: ClassVar[tuple[str, ...]] = ()
    """Modules whose code decides what the task is, beside those of the class and its bases."""
    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": CONTROL_HZ}  # noqa: RUF012
    """An instance on a machine without a display leaves out "human": checkers try every mode that is listed."""

    def __init__(self, config: EnvConfig) -> None:
        self.config = config
        if not has_display():
            modes = [mode for mode in RENDER_MODES if mode != "human"]
            self.metadata = {**type(self).metadata, "render_modes": modes}
        self.render_mode = config.render_mode
        self.robot: RobotSpec = self._find_robot()
        self.layout: Layout = config.find_layout()
        if self.layout.opens not in self.opens:
            known = ", ".join(name for name, layout in LAYOUTS.items() if layout.opens in self.opens)
            raise ConfigError(f"layout={self.layout.name!r} is not one for this environment; valid names: {known}")
        self._rendering = EnvRenderer(config)
        check_robot(self.robot)
        show_meshes = config.render_mode is not None or config.obs_mode != "state"
        self._make_world = partial(
            World, self.robot, self.layout, image_size=self._rendering.largest, show_meshes=show_meshes
        )
        self.world = self._home_world = self._make_world(shapes=config.slot_shapes)
        self._end_effector: EndEffectorController | None = None
        if config.control_mode == "ee":
            # It imports mink, which takes as long as all else here; "joint" control does without.
            from clutter_env.simulation.end_effector import EndEffectorController

            self._end_effector = EndEffectorController(self.robot)
        shares = config.find_reality()
        self._senses = Senses(shares, self._make_world) if any(shares.values()) else None
        self._has_started = False
        self._actions: list[NDArray[np.float32]] = []
        self.action_size = _BASE + _TWIST + 1 if self._end_effector else self.world.controller.action_size
        self._num_head = len(self.robot.head_joints) if config.head == "commanded" else 0
        self.action_size += self._num_head
        self._lacking = list(STILL[self.robot.base_drive])  # indices of numbers that actions of this base lack
        self.action_size -= len(self._lacking)
        shows_objects = config.obs_mode == "state" and config.num_objects > 0  # which images show in their place
        self._observer = Observer(
            self.world,
            config.num_objects,
            shows_objects=shows_objects,
            shows_goal=shows_objects and self._shows_goal,
            shows_head=self._num_head > 0,
            shows_kinds=bool(config.find_object_set().kinds),
        )
        self.action_space = spaces.Box(-1.0, 1.0, (self.action_size,), np.float32)
        self.observation_space = self._make_observation_space()

    # The Gymnasium surface.

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode. Its first state is a function of seed and options alone.

        A refused reset leaves everything unchanged, including the random generator.

        Raises:
            OptionError: an unknown or invalid option.
            StateError: the option `state` is not a saved state of this environment.
        """
        checked = self._check_options(options)
        with restored_generator(self):
            super().reset(seed=seed)
            if checked.state is not None:
                self.restore_state(checked.state)
            else:
                self._start(self._stand(self._draw_scene(checked), checked))
                self._monitor = SuccessMonitor(self.world, self.measurements, self.target_slot)
                self._begin()
        self._actions = []
        if self.render_mode == "human":
            self.render()
        return self._observe(), self._info()

    def step(self, action: ArrayLike) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Execute one control step of 0.05 s.

        Raises:
            ActionError: the action is not a finite vector of the right shape. The state is unchanged.
        """
        recorded = checked_action(action, self.action_size)
        self.check_started("step()")
        self._actions.append(recorded)
        checked = recorded.astype(np.float64)
        if self._senses:
            checked = self._senses.late(checked, self._still_action())
        grips, head = self._parts(checked)
        self.measurements = self.world.advance(self.measurements, self._joint_velocity(checked), grips, head)
        if self._senses:
            self._senses.observe(self.world, self.measurements)
        self._monitor.update(self.measurements)
        reward, terminated = self._advance()
        if self.render_mode == "human":
            self.render()
        info = self._info()
        return self._observe(), reward, terminated, info["unstable"], info

    def render(self) -> NDArray[Any] | None:
        """An image (height, width, 3) uint8, a depth image (height, width) float32 [m], or None (shown in a window).

        Raises:
            ActionError: `reset` has not been called.
            RenderingUnavailable: no OpenGL, or no display for a window.
        """
        self.check_started("render()")
        if self.render_mode is None:
            gym.logger.warn(
                "render() without a render mode shows nothing: gym.make(…, render_mode='rgb_array') gives images, "
                "'human' opens a window"
            )
        return self._rendering.render(self.world)

    def close(self) -> None:
        """Free the OpenGL resources."""
        self._rendering.close()

    def wait_for_window(self) -> None:
        """With render_mode="human": keep the window open until its user closes it."""
        self._rendering.wait_for_window()

    # Beyond Gymnasium.

    @property
    def model(self) -> mujoco.MjModel:
        """The MuJoCo model, for reading only."""
        return self.world.model

    @property
    def data(self) -> mujoco.MjData:
        """The MuJoCo data, for reading only."""
        return self.world.data

    @property
    def perceived(self) -> World:
        """The world as the robot knows it, with `model` and `data`. At reality=0 it is the true world."""
        return self.world if self._senses is None or self._senses.world is None else self._senses.world

    @property
    def latency(self) -> int:
        """Control steps by which actions and observations together are late."""
        return self._senses.latency if self._senses else 0

    @property
    def pose_accuracy(self) -> float:
        """Error [m] that the objects' perceived poses seldom exceed, 0 at reality=0."""
        return self._senses.pose_accuracy if self._senses else 0.0

    @property
    def control_mode(self) -> str:
        """Meaning of the numbers of an action, "joint" or "ee"."""
        return self.config.control_mode

    @property
    def target(self) -> str:
        """Name of the target object, "" without one.

        Raises:
            ActionError: `reset` has not been called.
        """
        self.check_started("target")
        return self.world.names[self.target_slot] if self.target_slot >= 0 else ""

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of the objects' bodies."""
        return self.world.names

    @property
    def support_name(self) -> str:
        """Name of the geom on whose top face the objects stand. For a drawer: its floor."""
        return supports_of(self.layout)[0]

    @property
    def lift_height(self) -> float:
        """[m] between the support and the lowest point of the target from which the target is regarded as lifted."""
        return LIFT_HEIGHT

    @property
    def info(self) -> dict[str, Any]:
        """The info of the present state. Raise ActionError before `reset`."""
        self.check_started("info")
        return self._info()

    @property
    def is_gentle(self) -> bool:
        """Whether the robot has kept the force limits since the reset. Raise ActionError before it."""
        self.check_started("is_gentle")
        return self._monitor.is_gentle

    @property
    def observation_layout(self) -> Mapping[str, EntryLayout]:
        """Slices and columns of the observation's entries, by name. See `observation_layout`."""
        return self._observer.layout

    @property
    def target_slot(self) -> int:
        """Index of the target among the objects."""
        return self.world.scene.target

    @property
    def actions(self) -> list[NDArray[np.float32]]:
        """The actions since the reset, or since a state was restored: they replay the episode bit for bit."""
        return list(self._actions)

    def joint_action(
        self, q_target: ArrayLike, gripper_width: ArrayLike, head_target: ArrayLike | None = None
    ) -> NDArray[np.float64]:
        """The action after which the motors' targets are `q_target`, as far as the limits allow.

        A trajectory sampled at 20 Hz is followed exactly if it keeps the robot's velocity and acceleration limits (of
        the base: those of its own axes). A goal farther away is approached as fast as braking before it allows.

        Args:
            q_target: (4 + n,) base x, y [m], yaw [rad] in the world, torso [m], arm [rad], then other arms that act.
            gripper_width: [m] between the pads. For several arms that act: one number for each.
            head_target: (2,) pan and tilt [rad] of a commanded head. None: it stays still.

        Raises:
            ActionError: not finite, the wrong shape, or this environment's control mode is "ee".
        """
        if self._end_effector:
            raise ActionError("joint_action needs control_mode='joint'; this environment has 'ee', use ee_action")
        self.check_started("joint_action()")
        controller, is_holding = self.world.controller, self.measurements.grip.is_holding
        present = controller.state
        for on_the_way in self._senses.on_the_way if self._senses else ():  # starts from where those will have led
            parts = self._parts(on_the_way)
            controller.move_target(self.data, self._joint_velocity(on_the_way), parts[0], is_holding, parts[1])
        action = controller.action_towards(q_target, gripper_width, is_holding)
        controller.state = present
        return self._with_own_parts(action, head_target)

    def ee_action(
        self,
        base_target: ArrayLike,
        T_world_tcp: ArrayLike,
        gripper_width: float,
        head_target: ArrayLike | None = None,
    ) -> NDArray[np.float64]:
        """The "ee" action that brings base and TCP targets to these, or as near as one step allows.

        Args:
            base_target: (3,) x, y [m], yaw [rad].
            T_world_tcp: (4, 4) TCP pose in the world once the base is at its target.
            gripper_width: [m] between the pads.
            head_target: as of `joint_action`.

        Raises:
            ActionError: not finite, the wrong shape, or this environment's control mode is "joint".
        """
        if not self._end_effector:
            raise ActionError("ee_action needs control_mode='ee'; this environment has 'joint', use joint_action")
        self.check_started("ee_action()")
        controller = self.world.controller
        base = checked_vector("ee_action's base_target", base_target, (3,))
        pose = checked_vector("ee_action's T_world_tcp", T_world_tcp, (4, 4))
        goal = np.concatenate((base, controller.state.target[_BASE:]))
        velocity = controller.velocity_towards(goal, self.measurements.grip.is_holding)[:_BASE]
        drive = np.clip(velocity / controller.max_velocity[:_BASE], -1.0, 1.0)
        T_world_base = np.eye(4)
        cosine, sine = np.cos(base[2]), np.sin(base[2])
        T_world_base[:2, :2] = ((cosine, -sine), (sine, cosine))
        T_world_base[:2, 3] = base[:2]
        twist = self._end_effector.twist_towards(np.linalg.inv(T_world_base) @ pose)
        action = np.concatenate((drive, twist, [controller.grip_action(gripper_width)]))
        return self._with_own_parts(action, head_target)

    def _with_own_parts(self, action: NDArray[np.float64], head_target: ArrayLike | None) -> NDArray[np.float64]:
        """An action without the motions that this base lacks, with the numbers for the head."""
        if head_target is not None and not self._num_head:
            raise ActionError("head_target needs head='commanded'")
        head = np.zeros(self._num_head) if head_target is None else self.world.controller.head_action(head_target)
        return np.append(np.delete(action, self._lacking), head)

    def tcp_follower(self) -> TcpFollower:
        """A model of how the joints follow "ee" actions, for planners. It is independent of this environment's
        state."""
        from clutter_env.simulation.end_effector import TcpFollower

        return TcpFollower(self.robot)

    def save_state(self) -> bytes:
        """Everything that the next steps depend on: physics, controller, task, random generator."""
        self.check_started("save_state()")
        if self._senses:
            raise StateError("states are saved at reality=0: what is late, and the errors of the episode, are no part")
        scene, control, arm = self.world.scene, self.world.controller.state, self._end_effector
        memory = {
            "task": self._memory(),
            "monitor": self._monitor.memory(),
            "grip": asdict(self.measurements.grip),
            "pressing": [self.world.on_furniture.memory(), self.world.on_itself.memory()],
            "target": control.target.tolist(),
            "velocity": control.velocity.tolist(),
            "fingers": control.fingers,
            "end_effector": {"wanted_tcp": arm.wanted, "ik_failures": arm.failures} if arm else None,
            "rng": self.np_random.bit_generator.state,
        }
        if self._num_head:
            memory["head"] = list(control.head)
        return pack(self._kind, scene, capture_physics(self.world), memory)

    def restore_state(self, state: bytes) -> None:
        """Continue from a saved state, bit for bit, also in another process.

        Raises:
            StateError: not a valid saved state of an environment like this one. Nothing has changed.
        """
        if self._senses:
            raise StateError("states are restored at reality=0")
        scene, saved_physics, remembered = unpack(
            state, self._kind, self.has_target, len(self.world.index.opening_qpos)
        )
        scene = as_household(scene) if self.config.find_object_set().kinds else scene
        world, arm = self._world_for(scene), self._end_effector
        size, grippers = len(world.controller.state.target), world.controller.num_grippers
        memory = Fields(remembered, "memory", (*_MEMORY, *["head"] * (self._num_head > 0)))
        wanted_tcp, ik_failures = np.empty(0), 0
        if arm:
            followed = Fields(memory["end_effector"], "memory end_effector", ("wanted_tcp", "ik_failures"))
            wanted_tcp, ik_failures = followed.numbers("wanted_tcp", (7,)), followed.integer("ik_failures", 0, 2**31)
            check_quaternions("memory wanted_tcp", wanted_tcp[:4])
        elif memory["end_effector"] is not None:
            raise StateError("memory: end_effector of the state must be null in control mode 'joint'")
        physics = read_physics(world, saved_physics)
        control = ControlState(
            memory.numbers("target", (size,)),
            memory.numbers("velocity", (size,)),
            tuple(memory.numbers("fingers", (grippers,), 0.0, 1.001 * self.robot.max_finger_position).tolist()),
            tuple(memory.numbers("head", (self._num_head,)).tolist())
            if self._num_head
            else self.robot.head_configuration,
        )
        if (np.abs(control.velocity) > 2 * world.controller.max_velocity).any():  # of the base, each axis of the world
            raise StateError("memory: velocity of the state must be at most twice what the robot's joints reach")
        gripped = Fields(memory["grip"], "memory grip", [entry.name for entry in fields(Grip)])
        grip = Grip(
            held=tuple(gripped.integers("held", grippers, -1, scene.num_objects - 1).tolist()),
            is_carried=tuple(gripped.flags("is_carried", grippers).tolist()),
            is_touching=bool(gripped.flags("is_touching")),
        )
        if any(slot < 0 and is_carried for slot, is_carried in zip(grip.held, grip.is_carried, strict=True)):
            raise StateError("memory grip: is_carried of the state must be false where nothing is held")
        pressing = memory.numbers("pressing", (2, REMEMBERED), 0.0).tolist()
        if not all(map(Pressing.is_memory, pressing)):
            raise StateError("memory: pressing of the state has forces, impulses and slides that do not agree")
        check_generator(self.np_random, memory["rng"])
        watched = checked_memory(memory["monitor"], scene.num_objects, grippers)
        bookkeeping = self._read_memory(memory["task"], scene)
        restore_physics(world, scene, physics)  # the last that may refuse the state
        self.world = world
        world.on_furniture, world.on_itself = map(Pressing.recall, pressing)
        world.controller.state = control
        if arm:
            arm.wanted, arm.failures = wanted_tcp.tolist(), ik_failures
        self.measurements = world.measure_objects(grip)
        self._has_started = True
        self._monitor = SuccessMonitor.recall(watched, world, self.measurements, self.target_slot)
        self._recall(bookkeeping)
        self._actions = []
        self.np_random.bit_generator.state = memory["rng"]

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the content of `save_state`, because MuJoCo's own pickles forget which bodies sleep."""
        saved = self.save_state() if self._has_started and not self._senses else None
        attributes = {name: self.__dict__[name] for name in _PICKLED if name in self.__dict__}
        return _unpickled, (type(self), vars(self.config), attributes, saved)

    # What a task defines.

    def _find_robot(self) -> RobotSpec:
        """The robot that the configuration names, as this task uses it."""
        return self.config.find_robot()

    def _check_options(self, options: object) -> ResetOptions:
        """Check the options of a reset. Raise OptionError."""
        return ResetOptions.of(options)

    def _draw_scene(self, options: ResetOptions) -> TableScene:
        """The scene of a new episode."""
        return draw_scene(self.np_random, self.layout, self.config, options)

    def _stand(self, scene: TableScene, options: ResetOptions) -> TableScene:
        """The scene with a base that does not move where it is to stand."""
        if options.base is not None:
            raise OptionError("option 'base' says where a robot stands that cannot move, in Retrieve, Skill, Rearrange")
        return scene

    @abstractmethod
    def _begin(self) -> None:
        """Start the task's bookkeeping. The world and `measurements` are those of the first state."""

    @abstractmethod
    def _advance(self) -> tuple[float, bool]:
        """Bookkeeping after a step: the reward, and whether the episode has ended."""

    @abstractmethod
    def _observe(self) -> dict[str, Any]:
        """The observation."""

    @abstractmethod
    def _is_success(self) -> bool:
        """Whether the task is done in the present state."""

    def _memory(self) -> dict[str, Any]:
        """The task's bookkeeping as JSON values. Empty if it follows from the present state."""
        return {}

    def _read_memory(self, memory: Any, scene: TableScene) -> Any:  # noqa: ARG002  of the saved state
        """Check the bookkeeping that `_memory` returned, for `_recall`. StateError if it is invalid."""
        return Fields(memory, "memory task", ())

    @abstractmethod
    def _recall(self, bookkeeping: Any) -> None:
        """Restore the bookkeeping that `_read_memory` returned."""

    # Inside.

    def check_started(self, call: str) -> None:
        """Raise ActionError unless an episode has begun. `call` is the method that needs an episode."""
        if not self._has_started:
            raise ActionError(f"call reset() before {call}")

    def _start(self, scene: TableScene) -> None:
        """Begin an episode with the robot at rest in its home configuration."""
        self.world = self._world_for(scene)
        if self._senses:  # the generator is that of the scene, after it
            rng = np.random.default_rng(self.np_random.integers(2**63))
            scene = self._senses.begin(self.world, scene, rng)
        self.world.reset(scene)
        if self._end_effector:
            self._end_effector.reset(self.world.controller.state.target[_BASE:])
        self.measurements = self.world.measure()
        if self._senses:
            self._senses.observe(self.world, self.measurements)
        self._has_started = True

    def _world_for(self, scene: TableScene) -> World:
        """A world for a scene: explicit scenes may have fewer objects or other shapes than the environment's own."""
        for world in (self.world, self._home_world):
            if scene.shapes == world.shapes:
                return world
        return self._make_world(shapes=scene.shapes)

    def _joint_velocity(self, action: NDArray[np.float64]) -> NDArray[np.float64]:
        """Velocities (4 + n,) that an action asks for, base x and y in the base's frame."""
        controller = self.world.controller
        state, limit = controller.state, controller.max_velocity
        for index in self._lacking:
            action = np.insert(action, index, 0.0)
        if not self._end_effector:
            return action[: len(limit)] * limit
        base, twist = action[:_BASE] * limit[:_BASE], action[_BASE : _BASE + _TWIST]
        arm = self._end_effector.joint_velocity(twist, state.target[_BASE:], state.velocity[_BASE:])
        return np.concatenate((base, arm))

    def _parts(self, action: NDArray[np.float64]) -> tuple[list[float], list[float]]:
        """The numbers of an action for the grippers, and for the head."""
        end = self.action_size - self._num_head
        return action[end - self.world.controller.num_grippers : end].tolist(), action[end:].tolist()

    def _still_action(self) -> NDArray[np.float64]:
        """The action that moves nothing."""
        still, controller = np.zeros(self.action_size), self.world.controller
        end = self.action_size - self._num_head
        widths = [controller.grip_action(self.robot.opening(finger)) for finger in controller.state.fingers]
        still[end - controller.num_grippers : end] = widths
        return still

    @property
    def _kind(self) -> dict[str, Any]:
        """Properties that a saved state and the environment that restores it must share, as JSON values."""
        robot = f"{self.robot.name}{' fixed' * (self.robot.base_drive == 'fixed')}"
        if robot_identity(self.robot) != self.robot.name:
            content = json.dumps(asdict(self.robot)).encode() + self.robot.mjcf_path.read_bytes()
            robot += f" {hashlib.sha256(content).hexdigest()[:16]}"
        return {
            "task": type(self).__name__,
            "mujoco": mujoco.__version__,
            "num_objects": int(self.config.num_objects),
            "layout": layout_identity(self.layout),
            "robot": robot,
            "control_mode": self.config.control_mode,
        }

    def _info(self) -> dict[str, Any]:
        """The info dictionary, with the same keys in all environments. Image observations add their cameras'
        calibration."""
        monitor, all_held = self._monitor, self.measurements.grip.held
        held = self.target_slot if self.target_slot >= 0 and self.target_slot in all_held else max(all_held)
        return {
            "is_success": self._is_success(),
            "lifted": monitor.lifted,
            "target": self.target,
            "held": self.world.names[held] if held >= 0 else "",
            "num_fallen": monitor.num_fallen,
            "num_disturbed": monitor.num_disturbed,
            "num_cleared": monitor.num_cleared,
            "furniture_force": self.world.on_furniture.force,
            "furniture_impulse": self.world.on_furniture.impulse,
            "self_force": self.world.on_itself.force,
            "self_impulse": self.world.on_itself.impulse,
            "total_slide": total_slide(self.world.on_furniture, self.world.on_itself),
            "total_path": monitor.total_path,
            **self._opening_info(),
            "unstable": self.world.is_unstable,
            "ik_failures": self._end_effector.failures if self._end_effector else 0,
            **self._rendering.calibration(self.perceived),
        }

    def _opening_info(self) -> dict[str, Any]:
        """Entries of the info for drawers and doors, empty without them."""
        world = self.world
        if not world.openings:
            return {}
        positions = self.data.qpos[world.index.opening_qpos].tolist()
        return {
            "num_opened": sum(share >= OPENED_SHARE for share in world.opened_shares),
            "joint_positions": {one.joint: at for one, at in zip(world.openings, positions, strict=True)},
        }

    def observe_world(self, target: int, hold_progress: float, lift_left: float) -> dict[str, Any]:
        """The observation that the configuration selects, see `Observer.observe`."""
        measurements = self._senses.measurements if self._senses else self.measurements
        vectors = self._observer.observe(self.perceived, measurements, target, hold_progress, lift_left)
        images = self._rendering.images(self.world)
        if self._senses:
            images = self._senses.arriving(images)
        return {**vectors, **self._rendering.observation(self.perceived, images)}

    def _make_observation_space(self) -> spaces.Dict:
        """The space of `observe_world`'s observations."""
        return spaces.Dict({**self._observer.space.spaces, **self._rendering.observation_spaces()})


@contextmanager
def restored_generator(env: gym.Env) -> Iterator[None]:
    """If the block raises, restore the environment's random generator, its state and its seed. They may be None."""
    generator, seed = env._np_random, env._np_random_seed
    state = {} if generator is None else generator.bit_generator.state
    try:
        yield
    except BaseException:
        env._np_random, env._np_random_seed = generator, seed
        if generator is not None:
            generator.bit_generator.state = state
        raise


def layout_identity(layout: Layout) -> Any:
    """The name of a known layout, all fields of another layout, as JSON values."""
    if LAYOUTS.get(layout.name) == layout:
        return layout.name
    return json.loads(json.dumps(asdict(layout)))


def robot_identity(robot: RobotSpec) -> Any:
    """The name of a known robot, all fields of another robot, as JSON values."""
    try:
        if find_robot(robot.name) == robot:
            return robot.name
    except UnknownRobot:
        pass
    return json.loads(json.dumps(asdict(robot)))


def _unpickled(
    make: Callable[..., BaseEnv], keywords: dict[str, Any], attributes: dict[str, Any], saved: bytes | None
) -> BaseEnv:
    """The environment of a pickle. `saved` is None if `reset` had not been called."""
    env = make(**keywords)
    env.__dict__.update(attributes)
    if saved is not None:
        env.restore_state(saved)
    return env
