"""`ArmRetrieve`: the retrieval task for learners: a fixed base, the gripper pointing down, four numbers, 100 steps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar

import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from assets import RobotSpec
from clutter_env.config import EnvConfig
from clutter_env.envs.arm import GOAL_RANGE, DownwardArm
from clutter_env.envs.from_above import Nearness, Standing
from clutter_env.envs.observation import POSITION_BOUND, VELOCITY_BOUND, Column, EntryLayout
from clutter_env.envs.relevance import OBJECT_ORDERS, StagedRetrieveEnv, relevance_order
from clutter_env.envs.reset_options import ResetOptions
from clutter_env.envs.staged_reward import stage_terms
from clutter_env.envs.success import HOLD_STEPS, LIFT_HEIGHT
from clutter_env.errors import ActionError, OptionError, check_choice
from clutter_env.scene.layout import TABLE_HEIGHT
from clutter_env.scene.table_scene import TableScene
from clutter_env.simulation.control import checked_vector

UNIT = 0.1
"""[m] Unit of the lengths in an observation: networks learn faster from numbers of the order of 1."""
TARGET_HEIGHT, OTHER_HEIGHT = (0.040, 0.046), (0.10, 0.12)
"""[m] The target is low and the others are high: what stands beside it is in the way, and can itself be taken first."""
GAP = 0.012
"""[m] between two objects at least."""
BLOCKED_SHARE = 0.5
"""Share of scenes with several objects in which one of them is in the way of the target. There are never two."""
CLOSING = 0.75
"""Share of the grasping term that fingers earn which have closed on the target and do not hold it yet."""
CLEAR_GAP, CLEAR_LIFT = 0.03, 0.10
"""[m] beside the grasp of the target at which an object is out of the way, and height above the table at which one in
the gripper begins to be put down."""
LOWEST = 0.04
"""[m] above the table to which actions move the TCP: at full speed the fingertips stop above the table."""
STEP = 0.03
"""[m] by which a full action moves the pose that the TCP follows in a step. The TCP is at most 0.05 m behind it."""
AGILE = 2.0
"""Acceleration limits of the arm as multiples of those of ArmPick: with these the TCP stays within 1.5 cm of a straight
line, otherwise within 3 cm."""
TURN = 0.25
"""[rad] by which a full action turns the gripper in a step, with `turns`."""

_MOST_DRAWS = 2000
_LENGTH = ("0.1 m", POSITION_BOUND / UNIT)
_GRIPPER = {
    "tcp_position": [Column(f"tcp_{axis}", *_LENGTH) for axis in "xyz"],
    "tcp_velocity": [Column(f"tcp_v{axis}", "m/s", VELOCITY_BOUND) for axis in "xyz"],
    "followed": [Column(f"followed_{axis}", *_LENGTH) for axis in "xyz"],
    "width": [Column("width", *_LENGTH)],
    "commanded_width": [Column("commanded_width", *_LENGTH)],
}
_TURNED = {"tcp_quaternion": [Column(f"tcp_q{axis}", "", 1.0) for axis in "wxyz"]}
_TASK = {"lift": [Column("lift", *_LENGTH)], "hold_progress": [Column("hold_progress", "", 1.0)]}
OBJECT_ROW = EntryLayout(
    {
        "present": [Column("present", "", 1.0)],
        "is_target": [Column("is_target", "", 1.0)],
        "from_tcp": [Column(f"from_tcp_{axis}", *_LENGTH) for axis in "xyz"],
        "from_target": [Column(f"from_target_{axis}", *_LENGTH) for axis in "xyz"],
        "axis": [Column(f"axis_{axis}", "", 1.0) for axis in "xyz"],
        "half_extents": [Column(f"half_{axis}", *_LENGTH) for axis in "xyz"],
        "is_box": [Column("is_box", "", 1.0)],
        "held": [Column("held", "", 1.0)],
    }
)
"""The numbers of one object: `from_tcp` and `from_target` its centre relative to the TCP and to the target (of the
target itself: to where the TCP is at the start); `axis` its own upward axis."""
ROLE_ROW = EntryLayout(
    {
        **{name: OBJECT_ROW.columns[place] for name, place in OBJECT_ROW.items()},
        "in_the_way": [Column("in_the_way", "", 1.0)],
    }
)
"""The same with `roles`: 1 if the object is in the way of the target, or in the gripper without being the target."""


def arm_retrieve_layout(num_objects: int, turns: bool = False, roles: bool = False) -> EntryLayout:
    """The layout of an observation: the gripper, the task, and a row for each object."""
    columns = (ROLE_ROW if roles else OBJECT_ROW).columns
    rows = {
        f"object_{row}": [column._replace(name=f"object_{row}.{column.name}") for column in columns]
        for row in range(num_objects)
    }
    return EntryLayout({**_GRIPPER, **(_TURNED if turns else {}), **_TASK, **rows})


@dataclass(frozen=True)
class ArmRetrieveConfig(EnvConfig):
    """The keyword arguments of `ArmRetrieveEnv`: those of `EnvConfig`, and three of its own.

    Raises:
        ConfigError: see `EnvConfig`, or a value that this environment fixes.
    """

    num_objects: int = 1
    control_mode: str = "ee"
    object_set: str = "low"
    """Widths and masses are those of "low" objects. Heights are `TARGET_HEIGHT` and `OTHER_HEIGHT`."""
    reward_mode: str = "staged"
    object_order: str = "relevance"
    """Order of the objects in an observation, one of `OBJECT_ORDERS`."""
    turns: bool = False
    """Whether an action has seven numbers: three more turn the gripper about the axes of the base."""
    roles: bool = False
    """Whether an observation says of each object if it is in the way of the target."""

    @property
    def reward_modes(self) -> tuple[str, ...]:
        """Values of `reward_mode` here."""
        return ("sparse", "staged")

    def __post_init__(self) -> None:
        fixed = {"control_mode": "ee", "object_set": "low", "head": "fixed", "obs_mode": "state", "obstructed": False}
        for name, value in {**fixed, "reality": 0.0}.items():
            check_choice(name, getattr(self, name), (value,))
        check_choice("base", self.base, ("holonomic", "fixed"))
        object.__setattr__(self, "base", "holonomic")  # which stands where it is put, since no action moves it
        check_choice("object_order", self.object_order, OBJECT_ORDERS)
        for name in ("turns", "roles"):
            check_choice(name, getattr(self, name), (False, True))
        super().__post_init__()


class ArmRetrieveEnv(DownwardArm, StagedRetrieveEnv):
    """Lift the target 0.10 m and hold it there for 0.5 s, from above, with a base that does not move.

    An action is that of `DownwardArm`, with `turns` three numbers more before the gripper's. A full action moves the
    pose that the TCP follows by `STEP`. That pose stays when the action is zero. The observation is one vector,
    `arm_retrieve_layout`, under "observation". Success, info and reset options are those of `RetrieveEnv`.
    `info["reward_terms"]` has the terms of the staged reward. The episode ends with success, and as soon as success has
    become impossible: with success="clean" when something has fallen, been disturbed or pressed too hard.

    Example:
        >>> import gymnasium as gym, clutter_env
        >>> env = gym.make("clutter_env/ArmRetrieve-o3-v0")
        >>> observation, info = env.reset(seed=0)
        >>> observation["observation"].shape, env.action_space.shape
        ((61,), (4,))
    """

    config: ArmRetrieveConfig
    config_type: ClassVar[type[EnvConfig]] = ArmRetrieveConfig
    task_modules: ClassVar[tuple[str, ...]] = tuple(
        f"clutter_env.envs.{name}" for name in ("from_above", "relevance", "staged_reward")
    )

    def __init__(self, **keywords: Any) -> None:
        super().__init__(**keywords)
        self._have_actions(7 if self.config.turns else 4)
        self._shown = arm_retrieve_layout(self.config.num_objects, self.config.turns, self.config.roles)

    @property
    def observation_layout(self) -> Mapping[str, EntryLayout]:
        """The layout of the observation, under "observation"."""
        return MappingProxyType({"observation": self._shown})

    def standing(self, scene: TableScene | None = None) -> Standing:
        """The objects of the present state as they stand, or those of a scene, with centres in the world."""
        if scene is None:
            scene, poses = self.world.scene, self.measurements.poses
            tops = poses[:, 2] + scene.half_extents[:, 2] - TABLE_HEIGHT
            tops = np.where(self.measurements.is_off, -1.0, tops)
            return Standing(poses[:, :2], _half_widths(scene), tops)
        return Standing(scene.positions, _half_widths(scene), 2 * scene.half_extents[:, 2])

    @property
    def in_the_way(self) -> list[int]:
        """Slots of the objects in the way of the target, what is held among them unless it is the target."""
        held = self.measurements.held
        found = self.standing().in_the_way(self.target_slot, LOWEST, self._heading())
        return [held, *(slot for slot in found if slot != held)] if held not in (-1, self.target_slot) else found

    @property
    def tcp_velocity(self) -> NDArray[np.float64]:
        """Velocity (3,) [m/s] of the TCP along the axes of the base."""
        return self._tcp_velocity()

    # The task.

    @cached_property
    def _kind(self) -> dict[str, Any]:
        return super()._kind  # which reads and hashes the robot's file, of a robot with other limits

    def _find_robot(self) -> RobotSpec:
        robot = super()._find_robot()
        self._lowest[2] = TABLE_HEIGHT + LOWEST
        limits = robot.max_acceleration
        return replace(robot, max_acceleration=(*limits[:3], *[AGILE * limit for limit in limits[3:]]))

    def _draw_scene(self, options: ResetOptions) -> TableScene:
        if options.obstructed is not None:
            raise OptionError("option 'obstructed' is of Retrieve; here half of the scenes have an object in the way")
        scene = super()._draw_scene(options)
        if options.objects is not None:
            centre = scene.positions[scene.target]
            return self._place_base(scene, *centre.tolist())
        scene = self._place_base(scene, 0.0, 0.0)
        is_target = np.arange(scene.num_objects) == scene.target
        low, high = np.where(is_target, *(np.array(limits)[:, None] for limits in (TARGET_HEIGHT, OTHER_HEIGHT)))
        half_extents = scene.half_extents.copy()
        half_extents[:, 2] = self.np_random.uniform(low, high) / 2
        scene = replace(scene, half_extents=half_extents, yaws=np.zeros(scene.num_objects))
        most = int(scene.num_objects > 1 and self.np_random.random() < BLOCKED_SHARE)
        for _ in range(_MOST_DRAWS):
            places = self._draw_places(scene)
            if places is None:
                continue
            drawn = replace(scene, positions=places)
            standing = self.standing(drawn)
            found = standing.in_the_way(scene.target, LOWEST)
            if len(found) == most and not any(standing.in_the_way(slot, LOWEST) for slot in found):
                return drawn
        raise OptionError(f"no scene was found in {_MOST_DRAWS} draws; ask for fewer objects")

    def _draw_places(self, scene: TableScene) -> NDArray[np.float64] | None:
        """Places (n, 2) in reach of the gripper, `GAP` apart. None if the draw has an overlap."""
        half = np.array(GOAL_RANGE[:2])
        places = self.origin_of(scene)[:2] + self.np_random.uniform(-half, half, (scene.num_objects, 2))
        distances = np.hypot(*(places[:, None] - places).transpose(2, 0, 1))
        widths = _half_widths(scene)
        is_close = distances < widths[:, None] + widths + GAP
        return None if np.count_nonzero(is_close) > scene.num_objects else places

    def origin_of(self, scene: TableScene) -> NDArray[np.float64]:
        """Position of the TCP at the start of a scene, (3,) [m] in the world."""
        x, y, _ = scene.base.tolist()
        return np.asarray(self._tcp_at_start + (x, y, 0.0))

    def _find_order(self) -> tuple[int, ...]:
        if self.config.object_order == "slots":
            return tuple(range(self.world.scene.num_objects))
        return relevance_order(self.measurements.poses, self.target_slot)

    def _is_over(self) -> bool:
        is_spoilt = self.config.success == "clean" and not self._monitor.is_clean
        return is_spoilt or super()._is_over()

    def _measure_terms(self) -> dict[str, float]:
        target, held, standing = self.target_slot, self.measurements.held, self.standing()
        in_the_way = self.in_the_way
        reach, around, closed = self._nearness(in_the_way[0] if in_the_way else target, standing)
        lift = min(max(self._monitor.lift / LIFT_HEIGHT, 0.0), 1.0) if held == target else 0.0
        hold = min(self._monitor.steps_held / HOLD_STEPS, 1.0)
        way, count = 1.0, len(in_the_way)
        if in_the_way:
            share = 0.2 * reach + 0.1 * around + 0.15 * closed
            if held == in_the_way[0]:
                gap = standing.gap(target, held, self._heading())
                raised = self.world.lowest_point(self.measurements, held) - TABLE_HEIGHT
                away = min(max(gap / CLEAR_GAP, 0.0), 1.0)
                down = min(max(1.0 - raised / CLEAR_LIFT, 0.0), 1.0)
                share = 0.5 + 0.1 * (1.0 - down) * (1.0 - away) + 0.2 * away + 0.3 * away * down
            way = 1.0 / (count + 1) + (1.0 / count - 1.0 / (count + 1)) * min(share, 0.999)
        grasp = 1.0 if held == target else CLOSING * closed
        return stage_terms(way, reach, around, grasp, lift, hold, self.world.scene.num_objects)

    def _nearness(self, slot: int, standing: Standing) -> Nearness:
        x, y, z = self.data.site_xpos[self.world.index.tcp_site].tolist()
        width = float(self._gripper()[2][0])
        return standing.nearness(slot, LOWEST, (x, y, z - TABLE_HEIGHT), width, self.robot.max_opening)

    # Observation, actions, saved states.

    def _heading(self) -> float:
        """[rad] of the gripper's own z axis, across which its fingers open, in the plane. 0 unless it is turned."""
        if not self.config.turns:
            return 0.0
        _, _, _, y_x, y_y, *_ = self.data.site_xmat[self.world.index.tcp_site].reshape(3, 3).T.ravel().tolist()
        return math.atan2(-y_x, y_y)

    def _observe(self) -> dict[str, Any]:
        scene, poses, origin = self.world.scene, self.measurements.poses, self.origin
        position, velocity, widths = self._gripper()
        parts = [position / UNIT, velocity, (self._followed() - position) / UNIT, widths / UNIT]
        if self.config.turns:
            quaternion = np.empty(4)
            mujoco.mju_mat2Quat(quaternion, self.data.site_xmat[self.world.index.tcp_site])
            parts.append(quaternion * math.copysign(1.0, quaternion[0]))
        hold = min(self._monitor.steps_held / HOLD_STEPS, 1.0)
        parts.append(np.array([self._monitor.lift / UNIT, hold]))
        columns = ROLE_ROW if self.config.roles else OBJECT_ROW
        rows = np.zeros((self.config.num_objects, columns.size))
        target, held = self.target_slot, self.measurements.held
        for row, slot in zip(rows, self._order, strict=False):  # explicit scenes may have fewer objects
            at, (w, x, y, z) = poses[slot, :3], poses[slot, 3:].tolist()
            row[OBJECT_ROW["present"]] = 1.0
            row[OBJECT_ROW["is_target"]] = slot == target
            row[OBJECT_ROW["from_tcp"]] = (at - origin - position) / UNIT
            row[OBJECT_ROW["from_target"]] = (at - (origin if slot == target else poses[target, :3])) / UNIT
            row[OBJECT_ROW["axis"]] = 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)
            row[OBJECT_ROW["half_extents"]] = scene.half_extents[slot] / UNIT
            row[OBJECT_ROW["is_box"]] = scene.is_box[slot]
            row[OBJECT_ROW["held"]] = slot == held
        if self.config.roles:
            rows[: len(self._order), ROLE_ROW["in_the_way"]] = np.isin(self._order, self.in_the_way)[:, None]
        vector, bounds = np.concatenate([*parts, rows.ravel()]), self._shown.bounds
        return {"observation": np.minimum(np.maximum(vector, -bounds), bounds).astype(np.float32)}

    def arm_action(self, position: ArrayLike, gripper_width: float) -> NDArray[np.float64]:
        """The action (4,) that moves the pose to follow towards a position (3,) [m], relative to the TCP's start.

        Raises:
            ActionError: not finite, the wrong shape, `turns`, or `reset` has not been called.
        """
        self.check_started("arm_action()")
        if self.config.turns:
            raise ActionError("arm_action has four numbers; this environment has seven")
        step = checked_vector("arm_action's position", position, (3,)) - self._followed()
        grip = self.world.controller.grip_action(gripper_width)
        return np.append(step / max(STEP, float(np.abs(step).max())), grip)

    def _followed(self) -> NDArray[np.float64]:
        """Position (3,) [m] of the pose to follow, relative to the TCP's start."""
        arm = self._end_effector
        assert arm is not None
        return np.array(arm.wanted[4:]) - self._tcp_at_start

    def _joint_velocity(self, action: NDArray[np.float64]) -> NDArray[np.float64]:
        arm, state = self._end_effector, self.world.controller.state
        assert arm is not None
        quaternion, wanted = self._down, np.array(arm.wanted[4:]) + STEP * action[:3]
        if self.config.turns:
            turned, turn, axis = np.empty(4), np.empty(4), action[3:6] * TURN
            mujoco.mju_axisAngle2Quat(turn, axis, mujoco.mju_normalize3(axis))
            mujoco.mju_mulQuat(turned, turn, np.array(arm.wanted[:4]))
            mujoco.mju_normalize4(turned)
            quaternion = turned.tolist()
        arm.wanted = [*quaternion, *np.minimum(np.maximum(wanted, self._lowest), self._highest)]
        velocity = arm.joint_velocity(np.zeros(6), state.target[3:], state.velocity[3:])
        return np.concatenate((np.zeros(3), velocity))

    def _make_observation_space(self) -> spaces.Dict:
        config = self.config
        bounds = arm_retrieve_layout(config.num_objects, config.turns, config.roles).bounds.astype(np.float32)
        return spaces.Dict({"observation": spaces.Box(-bounds, bounds)})


def _half_widths(scene: TableScene) -> NDArray[np.float64]:
    """(n,) [m] radius of the circle around each object, seen from above."""
    return np.where(scene.is_box, np.hypot(*scene.half_extents[:, :2].T), scene.half_extents[:, 0])
