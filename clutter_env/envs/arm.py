"""`ArmReach` and `ArmPick`: goal environments with a fixed base and four actions, for stock learners. Also their arm.

They are the Fetch tasks of Gymnasium-Robotics (Plappert et al. 2018, arXiv:1802.09464) in this package's world. The
gripper points down, and an action moves it by up to 5 cm and opens or closes it. An episode has 50 steps. Rewards are 0
within 5 cm of the goal and -1 elsewhere. Only the arm's redundancy is not observed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from types import MappingProxyType
from typing import Any, ClassVar

import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from assets import RobotSpec
from clutter_env.config import REWARD_MODES, EnvConfig
from clutter_env.envs.base import BaseEnv
from clutter_env.envs.from_above import Standing
from clutter_env.envs.goal import GOAL_TOLERANCE, GoalEnv, clipped, distances
from clutter_env.envs.observation import POSITION_BOUND, VELOCITY_BOUND, Column, EntryLayout
from clutter_env.envs.reset_options import ResetOptions
from clutter_env.envs.staged_pick import pick_reward, pick_terms
from clutter_env.errors import ActionError, ConfigError, check_choice
from clutter_env.scene.layout import TABLE_HEIGHT
from clutter_env.scene.table_scene import TableScene
from clutter_env.simulation.control import CONTROL_STEP, checked_vector
from clutter_env.simulation.end_effector import EndEffectorController, TcpFollower

START_HEIGHT = 0.18
"""[m] of the TCP above the table at the start."""
START_BACK = 0.17
"""[m] of the TCP at the start behind where it is in `RobotSpec.in_front`."""
GOAL_RANGE = (0.12, 0.15, 0.12)
"""[m] Objects and goals are at most this far from the TCP at the start, along x, y and, for Reach, z."""
LOWEST = 0.03
"""[m] above the table to which actions move the TCP: the fingertips stay just above the table."""
ROOM = 0.08
"""[m] beyond the goals to which actions move it sideways and up."""
GOAL_LIFT = 0.25
"""[m] Largest height of a Pick goal above the object's start. Half of the goals are on the table."""

STEP = 0.05
"""[m] Distance ahead of the TCP at which a full action sets the pose to follow. The step covers 60% of it."""
FASTER, HARDER = 2.0, 4.0
"""Velocity and acceleration limits of the arm as multiples of the robot's own. With the robot's own
limits 50 steps would not suffice. The motors follow."""
FINGER_VELOCITY = 0.15
"""[m/s] of one finger: five steps from open to closed on an object."""

_ACTIONS = 4
_BRAKING = 0.06
"""[s] Time for which the arm moves on after the command to stop. `arm_action` allows for it."""
_EDGE = 0.06
"""[m] from the table's edges to where an object's axis may be, at least."""
_BASE_GAP = 0.01
"""[m] between the base and the table."""
_TURN_RATE = 3.0
"""[rad/s] at which the gripper is turned down before the first episode."""
_SETTLING_STEPS = 100
"""Control steps in which the arm arrives at a pose."""
_DOWN = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""Orientation of the TCP in the base frame. Its x axis, the approach, points down. The fingers move sideways."""

_METRES, _SPEED = ("m", POSITION_BOUND), ("m/s", VELOCITY_BOUND)
_GRIPPER = {
    "tcp_position": [Column(f"tcp_{axis}", *_METRES) for axis in "xyz"],
    "tcp_velocity": [Column(f"tcp_v{axis}", *_SPEED) for axis in "xyz"],
    "width": [Column("width", "m", 1.0)],
    "commanded_width": [Column("commanded_width", "m", 1.0)],
}
_OBJECT = {
    "object_position": [Column(f"object_{axis}", *_METRES) for axis in "xyz"],
    "tcp_to_object": [Column(f"tcp_to_object_{axis}", *_METRES) for axis in "xyz"],
    "object_quaternion": [Column(f"object_q{axis}", "", 1.0) for axis in "wxyz"],
    "object_velocity": [Column(f"object_v{axis}", *_SPEED) for axis in "xyz"],
    "object_angular_velocity": [Column(f"object_w{axis}", "rad/s", VELOCITY_BOUND) for axis in "xyz"],
    "half_extents": [Column(f"half_{axis}", "m", 1.0) for axis in "xyz"],
}
REACH_LAYOUT, PICK_LAYOUT = EntryLayout(_GRIPPER), EntryLayout({**_GRIPPER, **_OBJECT})
"""Layout of the entry "observation". Positions and goals have the axes of the base and their origin at the TCP's start.
`object_velocity` is relative to the TCP."""


class DownwardArm(BaseEnv):
    """Common part of environments with a fixed base in front of the table and the gripper pointing down.

    An action has four numbers in [-1, 1]. The first three are the motion of the TCP along x, y and z of the base, each
    a share of 0.05 m, from the TCP pose of the joint targets. The last is the opening of the gripper, -1 closed, 1
    open. Of the commands only the targets of joints and fingers outlast a step.

    Raises:
        ConfigError: the robot does not reach all goals, or the layout has shelves.
    """

    def _have_actions(self, size: int = _ACTIONS) -> None:
        """Set the number of entries of an action. To be called after the base class's constructor."""
        self.action_size = size
        self.action_space = spaces.Box(-1.0, 1.0, (size,), np.float32)
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, _DOWN.ravel())
        self._down: list[float] = quaternion.tolist()

    def arm_action(self, position: ArrayLike, gripper_width: float) -> NDArray[np.float64]:
        """The action (4,) that brings the TCP towards a position (3,) [m], in the coordinates of the goals.

        Raises:
            ActionError: not finite, the wrong shape, or `reset` has not been called.
        """
        self.check_started("arm_action()")
        step = checked_vector("arm_action's position", position, (3,)) - self.tcp - _BRAKING * self._tcp_velocity()
        grip = self.world.controller.grip_action(gripper_width)
        return np.append(step / max(STEP, float(np.abs(step).max())), grip)

    def ee_action(self, *_: object, **__: object) -> NDArray[np.float64]:
        """Raise ActionError, because actions here have four numbers, see `arm_action`."""
        raise ActionError("actions of this environment have four numbers; use arm_action")

    def _find_robot(self) -> RobotSpec:
        robot, layout = self.config.find_robot(), self.config.find_layout()
        self._tcp_at_start = _start_position(robot)
        room = np.add(GOAL_RANGE, ROOM)
        self._highest = self._tcp_at_start + room
        self._lowest = np.append(self._tcp_at_start[:2] - room[:2], TABLE_HEIGHT + LOWEST)
        if layout.board_height is not None:
            raise ConfigError(f"layout={layout.name!r} has shelves, under which no gripper points down")
        reach = float(self._tcp_at_start[0]) - robot.base_radius - _BASE_GAP
        if not GOAL_RANGE[0] + _EDGE <= reach <= layout.depth - GOAL_RANGE[0] - _EDGE:
            raise ConfigError(
                f"robot {robot.name!r} over layout {layout.name!r}: its gripper points down {reach:.2f} m behind the "
                f"front edge, which must be {GOAL_RANGE[0] + _EDGE:.2f} m from the front and the back edge"
            )
        return fast_arm(robot)

    def _place_base(self, scene: TableScene, x: float, y: float) -> TableScene:
        """The scene with the base in front of the table, so that the gripper starts at y [m], and x [m] if it can."""
        ahead, left, _ = self._tcp_at_start.tolist()
        front = -self.layout.depth / 2 - self.robot.base_radius - _BASE_GAP
        return replace(scene, base=np.array([min(front, x - ahead), y - left, 0.0]))

    @property
    def origin(self) -> NDArray[np.float64]:
        """Origin (3,) of the goals' coordinates in the world: where the TCP is at the start."""
        x, y, _ = self.world.scene.base.tolist()
        return self._tcp_at_start + (x, y, 0.0)

    @property
    def tcp(self) -> NDArray[np.float64]:
        """The TCP (3,) in the coordinates of the goals."""
        return np.asarray(self.data.site_xpos[self.world.index.tcp_site] - self.origin)

    def _tcp_velocity(self) -> NDArray[np.float64]:
        """(3,) [m/s]"""
        model, data, site = self.model, self.data, self.world.index.tcp_site
        # A physics step leaves velocities of bodies from where it started.
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        twist = np.empty(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, site, twist, 0)
        return twist[3:]

    def _joint_velocity(self, action: NDArray[np.float64]) -> NDArray[np.float64]:
        state, arm = self.world.controller.state, self._end_effector
        assert arm is not None
        q = state.target[3:]
        position = arm.position(q)
        wanted = np.minimum(np.maximum(position + STEP * action[:3], self._lowest), self._highest)
        arm.wanted = [*self._down, *wanted]
        velocity = arm.joint_velocity(np.zeros(6), q, state.velocity[3:])
        return np.concatenate((np.zeros(3), velocity))

    def _gripper(self) -> list[NDArray[np.float64]]:
        """Position and velocity of the TCP, width and commanded width of the gripper."""
        data, index = self.data, self.world.index
        width = float(data.qpos[index.finger_qpos[:2]].sum()) + self.robot.finger_gap_closed
        commanded = self.robot.opening(self.world.controller.state.fingers[0])
        return [self.tcp, self._tcp_velocity(), np.array([width, commanded])]


class ArmEnv(DownwardArm, GoalEnv):
    """A goal environment with such an arm."""

    config_type: ClassVar[type[EnvConfig]] = EnvConfig
    """Of the keyword arguments."""
    _num_objects: int
    _layout: EntryLayout

    def __init__(self, **keywords: Any) -> None:
        keywords = {"num_objects": self._num_objects, "control_mode": "ee", **keywords}
        check_choice("num_objects", keywords["num_objects"], (self._num_objects,))
        check_choice("control_mode", keywords["control_mode"], ("ee",))
        check_choice("head", keywords.get("head", "fixed"), ("fixed",))
        check_choice("base", keywords.get("base", "fixed"), ("holonomic", "fixed"))
        config = self.config_type.from_keywords(keywords)
        self._shown = self._layout if config.obs_mode == "state" else REACH_LAYOUT
        super().__init__(config)
        self._have_actions()

    @property
    def observation_layout(self) -> Mapping[str, EntryLayout]:
        """The layout of the entry "observation"."""
        return {"observation": self._shown}

    def _observe(self) -> dict[str, Any]:
        vector = np.concatenate(self._numbers())
        bounds = self._shown.bounds
        return {
            "observation": np.minimum(np.maximum(vector, -bounds), bounds).astype(np.float32),
            "achieved_goal": self._achieved().copy(),
            "desired_goal": self.goal,
            **self._rendering.observation(self.world),
        }

    def _numbers(self) -> list[NDArray[np.float64]]:
        return self._gripper()

    def _make_observation_space(self) -> spaces.Dict:
        bounds = self._shown.bounds.astype(np.float32)
        parts = dict(super()._make_observation_space().spaces)
        return spaces.Dict({**parts, "observation": spaces.Box(-bounds, bounds)})


class ArmReachEnv(ArmEnv):
    """Bring the TCP to a point around where it starts."""

    _num_objects, _layout = 0, REACH_LAYOUT

    def _draw_scene(self, options: ResetOptions) -> TableScene:
        return self._place_base(super()._draw_scene(options), 0.0, 0.0)

    def _achieved(self) -> NDArray[np.float64]:
        return clipped(self.tcp)

    def _draw_goal(self) -> NDArray[np.float64]:
        return self.np_random.uniform(-np.array(GOAL_RANGE), GOAL_RANGE)


@dataclass(frozen=True)
class ArmPickConfig(EnvConfig):
    """The keyword arguments of `ArmPickEnv`: those of `EnvConfig`. The reward may be "staged" too."""

    @property
    def reward_modes(self) -> tuple[str, ...]:
        """Values of `reward_mode` here."""
        return (*REWARD_MODES, "staged")


class ArmPickEnv(ArmEnv):
    """Bring a low object to a point above the table or on it. The object stands within reach, parallel to the
    gripper.

    With reward_mode="staged" the reward is that of `staged_pick`, and the info has its terms, `reward_terms`.
    """

    config_type: ClassVar[type[EnvConfig]] = ArmPickConfig
    task_modules: ClassVar[tuple[str, ...]] = ("clutter_env.envs.from_above", "clutter_env.envs.staged_pick")
    _num_objects, _layout = 1, PICK_LAYOUT
    _terms: Mapping[str, float] = MappingProxyType({})
    """Terms of the present state."""

    def __init__(self, **keywords: Any) -> None:
        super().__init__(**{"shapes": "box", "object_set": "low", **keywords})

    def compute_reward(self, achieved_goal: NDArray[Any], desired_goal: NDArray[Any], info: Any) -> Any:
        """Rewards (...,) of achieved and desired goals (..., 3), bit for bit those of `step`.

        Args:
            achieved_goal: (..., 3) [m].
            desired_goal: (..., 3) [m].
            info: of the step, or those of the steps (...,). Only the staged reward reads them.

        Raises:
            ActionError: the reward is staged, and an info has no "reward_terms".
        """
        if not self._is_staged:
            return super().compute_reward(achieved_goal, desired_goal, info)
        distance = distances(np.asarray(achieved_goal, np.float64), np.asarray(desired_goal, np.float64))
        infos = [info] if isinstance(info, Mapping) else list(np.ravel(info))
        if len(infos) != distance.size or not all("reward_terms" in each for each in infos):
            needed = "the info of each step, with its reward_terms (of HerReplayBuffer: copy_info_dict=True)"
            raise ActionError(f"the staged reward of other goals needs {needed}")
        pairs = zip(infos, distance.ravel().tolist(), strict=True)
        rewards = [pick_reward(each["reward_terms"], metres, GOAL_TOLERANCE) for each, metres in pairs]
        return np.reshape(rewards, distance.shape) if distance.ndim else rewards[0]

    @property
    def _is_staged(self) -> bool:
        return self.config.reward_mode == "staged"

    def _begin(self) -> None:
        super()._begin()
        self._follow_terms()

    def _advance(self) -> tuple[float, bool]:
        self._follow_terms()
        return float(self.compute_reward(self._achieved(), self._goal, {"reward_terms": self._terms})), False

    def _recall(self, bookkeeping: NDArray[np.float64]) -> None:
        super()._recall(bookkeeping)
        self._follow_terms()

    def _follow_terms(self) -> None:
        if self._is_staged:
            self._terms = self._measure_terms()

    def _measure_terms(self) -> dict[str, float]:
        scene, pose = self.world.scene, self.measurements.poses[:1]
        standing = Standing(pose[:, :2], scene.half_extents[:, 1], pose[:, 2] + scene.half_extents[:, 2] - TABLE_HEIGHT)
        x, y, z = self.data.site_xpos[self.world.index.tcp_site].tolist()
        width, tcp = float(self._gripper()[2][0]), (x, y, z - TABLE_HEIGHT)
        nearness = standing.nearness(0, LOWEST, tcp, width, self.robot.max_opening)
        return pick_terms(nearness, self.measurements.held == 0, float(distances(self._achieved(), self._goal)))

    def _info(self) -> dict[str, Any]:
        info = super()._info()
        return {**info, "reward_terms": dict(self._terms)} if self._is_staged else info

    def _draw_scene(self, options: ResetOptions) -> TableScene:
        scene = super()._draw_scene(options)
        x, y = self.np_random.uniform(-np.array(GOAL_RANGE[:2]), GOAL_RANGE[:2])
        if options.objects is None:
            scene = self._place_base(scene, 0.0, 0.0)
            position = scene.base[:2] + self._tcp_at_start[:2] + (x, y)
            return replace(scene, positions=position[None], yaws=np.zeros(1))
        return self._place_base(scene, *(scene.positions[scene.target] - (x, y)))

    def _achieved(self) -> NDArray[np.float64]:
        return clipped(self.measurements.poses[0, :3] - self.origin)

    def _draw_goal(self) -> NDArray[np.float64]:
        x, y = self.np_random.uniform(-np.array(GOAL_RANGE[:2]), GOAL_RANGE[:2])
        lift = self.np_random.uniform(0.0, GOAL_LIFT) * float(self.np_random.random() < 0.5)
        return np.array([x, y, self._achieved()[2] + lift])

    def _numbers(self) -> list[NDArray[np.float64]]:
        gripper = super()._numbers()
        if self._shown is REACH_LAYOUT:  # with images
            return gripper
        tcp, velocity, _ = gripper
        pose, twist = self.measurements.poses[0], self.data.qvel[self.world.index.object_dof]
        position, quaternion = pose[:3] - self.origin, pose[3:] * math.copysign(1.0, pose[3])
        moved = (position, position - tcp, quaternion, twist[:3] - velocity, twist[3:])
        return [*gripper, *moved, self.world.scene.half_extents[0]]


@cache
def fast_arm(robot: RobotSpec) -> RobotSpec:
    """A robot that starts with its gripper down over the table, and whose arm and fingers have the limits of here.

    Raises:
        ConfigError: it does not reach all goals with its gripper down.
    """
    fast = replace(
        robot,
        max_velocity=(*robot.max_velocity[:3], *[FASTER * limit for limit in robot.max_velocity[3:]]),
        max_acceleration=(*robot.max_acceleration[:3], *[HARDER * limit for limit in robot.max_acceleration[3:]]),
        max_tcp_velocity=(STEP / CONTROL_STEP, _TURN_RATE),
        max_finger_velocity=FINGER_VELOCITY,
    )
    fast = replace(fast, home=robot.in_front)
    start, ahead = _start_position(robot), np.array(fast.home)
    lower, upper = np.array([(link.lower, link.upper) for link in robot.chain]).T
    # Rounded, so that saved states name the same robot on every machine.
    down = np.clip(_settled(fast, ahead, start)[0].round(4), lower, upper)
    fast = replace(fast, home=tuple(down.tolist()))
    corners = (start + np.multiply(GOAL_RANGE, signs) for signs in product((-1, 1), repeat=3))
    if (error := max(_settled(fast, down, corner)[1] for corner in corners)) > GOAL_TOLERANCE / 2:
        raise ConfigError(f"robot {robot.name!r} misses goals by up to {error:.2f} m while its gripper points down")
    return fast


def _settled(robot: RobotSpec, q: NDArray[np.float64], position: NDArray[np.float64]) -> tuple[Any, float]:
    """The configuration (1 + n,) at which an arm arrives from `q`, with the gripper down at `position`, and its error
    [m]."""
    follower, pose = TcpFollower(robot), np.eye(4)
    follower.reset(q)
    pose[:3, :3], pose[:3, 3] = _DOWN, position
    for _ in range(_SETTLING_STEPS):
        follower.step(pose)
    return follower.q, float(np.linalg.norm(EndEffectorController(robot).position(follower.q) - position))


def _start_position(robot: RobotSpec) -> NDArray[np.float64]:
    """Start position (3,) [m] of a robot's TCP in the base frame."""
    x, y, _ = EndEffectorController(robot).position(np.array(robot.in_front)).tolist()
    return np.array([x - START_BACK, y, TABLE_HEIGHT + START_HEIGHT])
