"""Joint control: converts desired velocities to position and velocity commands of the motors.

The controller keeps a joint target that moves within the robot's velocity and acceleration limits. The motors, stiff
position servos with a velocity reference, follow this target. An action sets the velocity of the target.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from assets import ActingJoints, RobotSpec
from clutter_env.config import CONTROL_HZ
from clutter_env.errors import ActionError
from clutter_env.simulation.model import ModelIndex

CONTROL_STEP = 1 / CONTROL_HZ
"""[s]"""
SEGMENTS = 5
"""Motor commands in one control step (100 Hz)."""
BASE_RANGE = 4.0
"""[m] The base target stays within this distance of the table's centre along x and y."""

STILL: dict[str, tuple[int, ...]] = {"holonomic": (), "differential": (1,), "fixed": (0, 1, 2)}
"""Velocities that each kind of base lacks. The order is ahead, to the left, about the vertical."""
_SHARES = np.arange(1, SEGMENTS + 1)[:, None] / SEGMENTS

_REAL_KINDS = "fiub"
"""NumPy's kinds of real numbers: floating, signed, unsigned, bool."""

HEAD_VELOCITY = 1.57
"""[rad/s] of the head's joints at full action: the limit of Fetch's."""

_BASE_LEAD = 0.10
_TORSO_LEAD = 0.03
_ARM_LEAD = 0.15
"""[m], [m], [rad]: largest lead of the target over a blocked joint. It is at most twice the lead that saturates the
motor."""

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class ControlState:
    """The state of the controller between two control steps.

    In a robot that acts with several arms, joints and fingers of the active arm come first.

    Attributes:
        target: (4 + n,) whole-body configuration.
        velocity: (4 + n,) of the target in the world frame.
        fingers: [m] of each gripper.
        head: [rad] of its joints.
    """

    target: Vector
    velocity: Vector
    fingers: tuple[float, ...]
    head: tuple[float, ...]


def checked_action(action: ArrayLike, size: int) -> NDArray[np.float32]:
    """The action, clipped to [-1, 1], as float32. Recordings store this executed action.

    Raises:
        ActionError: not a finite numeric vector of shape (size,).
    """
    vector = checked_vector("the action", action, (size,))
    values = vector.tolist()  # NumPy is slower on short vectors
    if max(values) > 1.0 or min(values) < -1.0:
        vector = np.minimum(np.maximum(vector, -1.0), 1.0)
    return vector.astype(np.float32)


def checked_vector(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Vector:
    """The value as a float64 array.

    Raises:
        ActionError: not finite numbers of this shape.
    """
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):  # lists of unequal length, and the like
        array = np.empty(0, object)
    # NumPy itself would also turn text, dates and complex numbers into floats.
    if array.dtype.kind not in _REAL_KINDS:
        raise ActionError(f"{name} must be {math.prod(shape)} finite numbers, not {value!r}")
    if array.shape != shape:
        raise ActionError(f"{name} must have shape {shape}, not {array.shape}")
    vector = array.astype(np.float64)
    if not all(map(math.isfinite, vector.ravel().tolist())):  # faster than NumPy on short vectors
        raise ActionError(f"{name} must be {math.prod(shape)} finite numbers; it holds NaN or infinity: {vector}")
    return vector


class JointController:
    """Controller of "joint" actions: base vx, vy (in the base's frame), yaw rate, torso and arm joint rates, opening.

    The value 1 of a rate is the joint's maximum velocity. The opening of the fingers is -1 closed, 1 open. The
    fingers move there at their own speed. In a robot that acts with several arms, the joint rates of the other arms
    come after those of the active arm, and the openings of all grippers come last.
    """

    def __init__(self, model: mujoco.MjModel, index: ModelIndex, robot: RobotSpec) -> None:
        self._index = index
        self._robot = robot
        self._still_base = STILL[robot.base_drive]
        acting = ActingJoints.of(robot)
        self.num_grippers = acting.num_grippers
        arm = len(acting.lower) - 1
        self.max_velocity = np.array(acting.velocity)
        self._loaded_velocity = self.max_velocity.copy()
        self._loaded_velocity[2] = min(self.max_velocity[2], robot.max_loaded_yaw_rate)
        self._max_change = np.array(acting.acceleration) * CONTROL_STEP
        self._limits, self._loaded_limits = self.max_velocity.tolist(), self._loaded_velocity.tolist()
        self._changes = self._max_change.tolist()
        lower = (-BASE_RANGE, -BASE_RANGE, -math.inf, *acting.lower)
        upper = (BASE_RANGE, BASE_RANGE, math.inf, *acting.upper)
        lead = (_BASE_LEAD, _BASE_LEAD, _ARM_LEAD, _TORSO_LEAD, *[_ARM_LEAD] * arm)
        self._bounds = list(zip(lower, upper, lead, self._limits, strict=True))
        self._feedforward = np.array(robot.velocity_feedforward(model, acting.names))
        self._still_command, self._moving_command = np.zeros((2, model.nu))
        self._still_command[index.still_actuators] = robot.still_configuration
        self._head_actuators = index.still_actuators[: len(robot.head_joints)]  # idle arms come after the head
        self._actuators = np.concatenate((index.drive_actuators, self._head_actuators, index.finger_actuators))
        self.head_range = [model.joint(name).range.tolist() for name in robot.head_joints]
        self.state = ControlState(
            np.zeros(4 + arm), np.zeros(4 + arm), (0.0,) * self.num_grippers, robot.head_configuration
        )
        self._commanded: ControlState | None = None
        self._command = self._still_command

    @property
    def action_size(self) -> int:
        """Length of a "joint" action."""
        return len(self.max_velocity) + self.num_grippers

    def reset(self, data: mujoco.MjData) -> None:
        """Take the present configuration as the target, at rest."""
        fingers = data.qpos[self._index.finger_qpos].reshape(-1, 2).tolist()
        self.state = ControlState(
            target=data.qpos[self._index.drive_qpos].copy(),
            velocity=np.zeros_like(self.max_velocity),
            fingers=tuple(sum(pair) / 2 for pair in fingers),
            head=self._robot.head_configuration,
        )
        data.ctrl[:] = self._position_command(self.state)

    def advance(
        self, data: mujoco.MjData, velocity: Vector, grips: Sequence[float], is_loaded: bool, head: Sequence[float] = ()
    ) -> Vector:
        """Move the target at `velocity` for one control step, as far as the limits allow.

        Args:
            data: the physics before the step.
            velocity: (4 + n,) desired, base x and y in the base's frame.
            grips: wanted finger position of each gripper, -1 closed to 1 open.
            is_loaded: whether something is held.
            head: rates of the head's joints, each a share of `HEAD_VELOCITY`. () if the head stays still.

        Returns:
            The motor commands (`SEGMENTS`, nu), for equal parts of the step.
        """
        before = self._position_command(self.state)
        self.move_target(data, velocity, grips, is_loaded, head)
        after = self._position_command(self.state)
        commands: Vector = before + _SHARES * (after - before)
        self._moving_command[self._index.drive_actuators] = self._feedforward * self.state.velocity
        commands += self._moving_command
        return commands

    def action_towards(self, q_target: ArrayLike, gripper_width: ArrayLike, is_loaded: bool) -> Vector:
        """The action that brings the target to `q_target` (4 + n,) in the next control step.

        If the limits do not allow that in one step, the action approaches it and leaves distance to brake. It may
        overshoot a fixed goal by the braking distance of one step (3 cm, 0.05 rad).

        Raises:
            ActionError: `q_target` or `gripper_width` [m] is not finite or has the wrong shape.
        """
        goal = checked_vector("q_target", q_target, (len(self.max_velocity),))
        velocity = self.velocity_towards(goal, is_loaded)
        widths = checked_vector("gripper_width", np.atleast_1d(gripper_width), (self.num_grippers,))
        grips = [self.grip_action(width) for width in widths.tolist()]
        return np.append(np.clip(velocity / self.max_velocity, -1.0, 1.0), grips)

    def velocity_towards(self, goal: Vector, is_loaded: bool) -> Vector:
        """Velocity (4 + n,) for one step towards the whole-body configuration `goal`, base part in the base's frame."""
        cosine, sine = math.cos(self.state.target[2]), math.sin(self.state.target[2])
        error = np.array(_turned((goal - self.state.target).tolist(), cosine, -sine))
        present = np.array(_turned(self.state.velocity.tolist(), cosine, -sine))
        wanted = error / CONTROL_STEP
        limit = self._loaded_velocity if is_loaded else self.max_velocity
        tolerance = 1 + 1e-9
        is_reachable = (np.abs(wanted) <= limit * tolerance) & (
            np.abs(wanted - present) <= self._max_change * tolerance
        )
        half = self._max_change / 2
        braking = np.sqrt(half**2 + 2 * self._max_change * np.abs(error) / CONTROL_STEP) - half
        return np.where(is_reachable, wanted, np.sign(error) * np.minimum(np.minimum(braking, np.abs(wanted)), limit))

    def head_action(self, head_target: ArrayLike) -> Vector:
        """Action (2,) of the head that moves its joints towards these angles [rad]."""
        goal = checked_vector("head_target", head_target, (len(self.state.head),))
        return np.clip((goal - self.state.head) / (HEAD_VELOCITY * CONTROL_STEP), -1.0, 1.0)

    def grip_action(self, gripper_width: float) -> float:
        """The action's last number for pads `gripper_width` [m] apart.

        Raises:
            ActionError: not a finite number.
        """
        width = float(checked_vector("gripper_width", [gripper_width], (1,))[0])
        return 2 * self._robot.finger_position(width) / self._robot.max_finger_position - 1

    def move_target(
        self, data: mujoco.MjData, velocity: Vector, grips: Sequence[float], is_loaded: bool, head: Sequence[float]
    ) -> None:
        """Move the targets of joints and fingers by one control step, as far as the limits allow.

        The loop treats each joint separately. NumPy's functions on such short vectors take several times as long.
        """
        state = self.state
        cosine, sine = math.cos(state.target[2]), math.sin(state.target[2])
        present = _turned(state.velocity.tolist(), cosine, -sine)
        limits = self._loaded_limits if is_loaded else self._limits
        allowed = []
        for wanted, now, limit, change in zip(velocity.tolist(), present, limits, self._changes, strict=True):
            speed = limit if wanted > limit else -limit if wanted < -limit else wanted
            most, least = now + change, now - change
            allowed.append(most if speed > most else least if speed < least else speed)
        for still in self._still_base:
            allowed[still] = 0.0
        allowed = _turned(allowed, cosine, sine)
        targets, actual = [], data.qpos[self._index.drive_qpos].tolist()
        rows = zip(state.target.tolist(), actual, allowed[:], self._bounds, strict=True)
        for joint, (start, position, speed, (lower, upper, lead, limit)) in enumerate(rows):
            target = start + speed * CONTROL_STEP
            most, least = position + lead, position - lead
            bounded = most if target > most else least if target < least else target
            bounded = upper if bounded > upper else lower if bounded < lower else bounded
            # A blocked joint moves only as far as its target did, so that it does not jerk after it is freed.
            if bounded != target:
                moved = (bounded - start) / CONTROL_STEP
                allowed[joint] = limit if moved > limit else -limit if moved < -limit else moved
            targets.append(bounded)
        step = self._robot.max_finger_velocity * CONTROL_STEP
        fingers = []
        for grip, finger in zip(grips, state.fingers, strict=True):
            wanted = (grip + 1) / 2 * self._robot.max_finger_position
            fingers.append(finger + min(max(wanted - finger, -step), step))
        turned, turn = state.head, HEAD_VELOCITY * CONTROL_STEP
        if head:
            parts = zip(state.head, head, self.head_range, strict=True)
            turned = tuple(min(max(angle + rate * turn, lower), upper) for angle, rate, (lower, upper) in parts)
        self.state = ControlState(np.array(targets), np.array(allowed), tuple(fingers), turned)

    def _position_command(self, state: ControlState) -> Vector:
        """Motor commands (nu,) for targets at rest. The last state's command is cached."""
        if state is not self._commanded:
            command = self._still_command.copy()
            fingers = [finger for finger in state.fingers for _ in range(2)]
            command[self._actuators] = [*state.target.tolist(), *state.head, *fingers]
            self._commanded, self._command = state, command
        return self._command


def _turned(drive: list[float], cosine: float, sine: float) -> list[float]:
    """Whole-body configuration with its base part rotated by the angle of this cosine and sine."""
    x, y, *others = drive
    return [cosine * x - sine * y, sine * x + cosine * y, *others]
