"""Execution of a plan, one control step at a time. It retreats and stops if the world deviates from the plan."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.collision.opened import riding
from planners.contact import StepLabel, contact_of, label_of
from planners.expert.config import MonitorConfig
from planners.expert.monitor import (
    Deviation,
    DeviationKind,
    Sensor,
    Snapshot,
    object_moved,
    tracking_error,
    turn_between,
)
from planners.facts import AJAR, LACKS
from planners.goals import has_yaw
from planners.motion.arm import tcp_pose
from planners.motion.tcp_following import ON_THE_WAY, PATIENCE, allowed, is_behind
from planners.motion.trajectory import CONTROL_STEP, Trajectory, is_contact
from planners.scene import HeldObject, RobotState
from planners.tamp.solution import BoundAction

Array = NDArray[np.float64]

_GRIP_DELAY = 4
"""Samples after the fingers have closed until the position of the object in the gripper is recorded."""
_RATE_CHANGE = 0.05
"""Change of speed per sample when the robot slows down after a deviation, or turns back. A stop takes 1 s."""
_HURRIED = 2
"""Samples that the next one waits for a TCP that has not arrived within `PATIENCE`."""
_LAG, _CATCHING_UP = 0.25, 0.5
"""Share of the tolerated tracking error from which on the plan runs slower, and its speed then."""
_LAST_LOOK = 1.0, 0.5
"""Time span [s] before an approach in which the object is checked again, so that the robot can stop before it."""
_BESIDE = 0.15
"""Distance [m] of object centres within which the open gripper would touch both, if they are perceived wrongly."""
_ROUNDING = 1e-6
"""Tolerance of a number of samples."""


class Command(NamedTuple):
    """Set points of one control step.

    Attributes:
        drive: (11,) whole-body configuration [m, rad].
        opening: gripper opening [m].
        arm: name of the arm.
        head: (2,) pan and tilt [rad]. None leaves them as they are.
    """

    drive: Array
    opening: float
    arm: str = ""
    head: Array | None = None


class Executor:
    """Follows the trajectories of a plan, one control step at a time.

    A deviation stops the plan. Near a grasp or a release, the gripper first leaves the objects along its straight line,
    forwards or back in time. Then the robot slows down on its path until it rests, and the execution is over.

    Attributes:
        action: index of the present action. After the last one, the number of actions.
        is_over: whether the plan was executed to its end or, with a `deviation`, stopped.
        deviation: the deviation that stops the plan, if any.
        cleared: names of the objects put down so far, in order.
        stop: drawer or door that did not move as far as planned, and its position [m] or [rad] then. None otherwise.
    """

    def __init__(
        self,
        actions: Sequence[BoundAction],
        robot: RobotSpec,
        sensor: Sensor,
        config: MonitorConfig,
        by_tcp: bool = False,
        at_start: int = 0,
        dt: float = CONTROL_STEP,
        latency: int = 0,
        unsure: Collection[str] = (),
        line_tolerance: float = ON_THE_WAY,
    ) -> None:
        """Begin to execute a plan.

        Args:
            actions, robot, config: the plan, the robot that executes it, and tolerances.
            sensor: reads the start. Later snapshots are for the arm `arm`, with objects in the same order.
            by_tcp: whether the robot's controller may lag, or choose other joint angles for the same TCP pose. Then the
                executor waits until the TCP arrives, and does not compare joint angles with the plan.
            at_start: samples at the start of the plan before the robot moves along it.
            dt: time [s] between calls of `advance`. Samples are `CONTROL_STEP` apart.
            latency: further calls of `advance`, after the first, until a snapshot shows a command's effect.
            unsure: names of objects with uncertain poses. The plan stops before their approach.
            line_tolerance: lag [m] allowed for the TCP on straight lines to and from an object, with `by_tcp`.
        """
        self._actions, self._robot, self._names, self._config = tuple(actions), robot, sensor.names, config
        self._unsure, self._line_tolerance = frozenset(unsure), line_tolerance
        self._by_tcp, self._stride = by_tcp, dt / CONTROL_STEP
        self._tick, self._rate, self._waited = -float(at_start), 1.0, 0.0
        self._given_up = math.inf
        self._expected = sensor.read()
        self._grip: Array | None = None
        self._closed_for = 0.0
        self._sent: deque[Command] = deque(maxlen=latency + 1)
        self.action, self.is_over = 0, False
        self.deviation: Deviation | None = None
        self.stop: tuple[str, float] | None = None
        self.cleared: list[str] = []

    def advance(self, now: Snapshot) -> Command:
        """Compare the world with the plan, and return the next command."""
        if self.deviation is None and not self._is_at_end:
            self._deviate(self._compare(now), now)
        if not self._has_to_wait(now):
            self._move_on(now)
        self.is_over = self._is_at_end or (self.deviation is not None and self._has_stopped())
        return self._command()

    @property
    def phase(self) -> str:
        """Action and phase of its motion, for example "PickUp object_03: lift". "" after the last action."""
        if self._is_at_end:
            return ""
        action = self._actions[self.action]
        return f"{f'{action.name} {action.target}'.rstrip()}: {action.trajectory.phase(self._time).name}"

    @property
    def label(self) -> StepLabel | None:
        """Label of the last command. None after the last action, and once a deviation stops the plan."""
        if self._is_at_end or self.deviation is not None:
            return None
        following = (contact_of(action) for action in self._actions[self.action :])
        return label_of(self._trajectory, self._time, next((found for found in following if found is not None), None))

    @property
    def arm(self) -> str:
        """Name of the arm that moves now and was commanded last."""
        return self._present.scene.robot.arm_name

    @property
    def _is_at_end(self) -> bool:
        return self.action >= len(self._actions)

    @property
    def _present(self) -> BoundAction:
        """Present action. After the last action, the last one."""
        return self._actions[min(self.action, len(self._actions) - 1)]

    @property
    def _trajectory(self) -> Trajectory:
        return self._present.trajectory

    @property
    def _time(self) -> float:
        """Time [s] in the present trajectory. After the last action, its end."""
        if self._is_at_end:
            return self._trajectory.duration
        return min(max(self._tick * CONTROL_STEP, 0.0), self._trajectory.duration)

    @property
    def _samples(self) -> int:
        return round(self._trajectory.duration / CONTROL_STEP)

    def _deviate(self, deviation: Deviation | None, now: Snapshot) -> None:
        """Take over a deviation, if there is one. One in the middle of a pull tells where the drawer or door stopped.

        The gripper then goes back, and the part with it: afterwards it is not seen any more.
        """
        self.deviation, action = deviation, self._present
        if deviation is None or not _is_pull(action) or action.target not in now.openings:
            return
        if deviation.kind is DeviationKind.NOT_OPENED or action.trajectory.phase(self._time).name == "pull":
            self.stop = action.target, now.openings[action.target]

    # Time in the plan: it runs slower if the robot lags, and stops or runs back after a deviation.

    def _move_on(self, now: Snapshot) -> None:
        """Go to the next sample, or to the first one of the next action."""
        wanted: float = _CATCHING_UP if self._lags(now) else 1.0
        if self.deviation is not None:
            wanted = self._retreat_direction()
        change = _RATE_CHANGE * self._stride
        self._rate += min(max(wanted - self._rate, -change), change)
        self._tick += self._rate * self._stride
        while not self._is_at_end and self._tick > (samples := self._samples) + _ROUNDING:
            self._tick -= samples
            self._expected = now
            if self.deviation is None:
                self._deviate(_not_opened(self._present, now), now)
            if self._present.is_put_down:
                self.cleared.append(self._present.target)
            self.action += 1
        while self._tick < 0 and self.action > 0:
            self.action -= 1
            self._tick += self._samples

    def _lags(self, now: Snapshot) -> bool:
        """Whether a joint-controlled robot lags by a certain part of the tolerated tracking error."""
        if self._by_tcp or not self._sent:
            return False
        part = replace(self._config, base=_LAG * self._config.base, arm=_LAG * self._config.arm)
        return tracking_error(self._sent[0].drive, now.drive, part) is not None

    def _has_to_wait(self, now: Snapshot) -> bool:
        """Whether the TCP has not reached the last commanded pose.

        The wait is limited to `PATIENCE` samples. After that it is limited to `_HURRIED`, until the TCP has arrived or
        the tolerance becomes smaller. An arm that is then farther away than allowed on free paths is stuck. That is a
        deviation: no other pose will free it.
        """
        if not self._by_tcp or not self._sent:
            return False
        due = self._sent[0].drive
        wanted = tcp_pose(self._present.scene.robot, RobotState(due[:3], due[3:], 0.0))
        near = CONTROL_STEP * max(self._stride, 1.0)
        tolerance = allowed(self._trajectory, self._time, self._line_tolerance, near)
        if not is_behind(wanted, now.T_world_tcp, tolerance):
            self._waited, self._given_up = 0.0, math.inf
            return False
        if self._waited >= (PATIENCE if tolerance < self._given_up else _HURRIED):
            self._waited, self._given_up = 0.0, tolerance
            if self.deviation is None and is_behind(wanted, now.T_world_tcp, ON_THE_WAY):
                self._deviate(Deviation(DeviationKind.ARM_TRACKING_ERROR), now)
                self._rate = 0.0
            return False
        self._waited += self._stride
        return True

    def _has_stopped(self) -> bool:
        return self._tick <= 0 or (self._retreat_direction() == 0 and abs(self._rate) < _RATE_CHANGE * self._stride / 2)

    def _retreat_direction(self) -> int:
        """Direction in time in which the gripper leaves the objects.

        -1 (back) before it closes or opens, 1 (forwards) afterwards, 0 away from grasps and releases.
        """
        phases = self._trajectory.phases
        at = phases.index(self._trajectory.phase(self._time))
        if is_contact(phases[at]):
            return 1 if at > 0 and phases[at - 1].held else -1
        if at + 1 < len(phases) and is_contact(phases[at + 1]):
            return -1
        return int(at > 0 and is_contact(phases[at - 1]))

    def _command(self) -> Command:
        """Sample at the present time. The gripper opens if it retreats without an object or has missed it.

        After a slip, the object may still be between the fingers, so these stay closed.
        """
        sample = self._trajectory.sample(self._time)
        drive = np.concatenate((sample.base, sample.q))
        opening = self._robot.opening(sample.finger_position)
        if self.deviation is not None:
            is_empty_retreat = self._retreat_direction() < 0 and not sample.phase.held and not _pushes(self._present)
            if is_empty_retreat or self.deviation.kind is DeviationKind.GRASP_MISSED:
                opening = self._robot.max_opening
        self._sent.append(Command(drive, opening, self.arm))
        return self._sent[-1]

    # Comparison of the world with the plan.

    def _compare(self, now: Snapshot) -> Deviation | None:
        """First deviation found: grip, other objects, joints, then the object to grasp."""
        action = self._actions[self.action]
        phase = action.trajectory.phase(self._time)
        deviation = self._check_grip(now, phase.touched if phase.held else None)
        touched = phase.held or (action.target if action.name != "MoveBase" else "")
        ignore = {touched, *(one.held.name for one in action.scene.aside)}
        ignore |= {*riding(action.scene)} if _is_pull(action) else set()
        ignore &= {*self._names}
        deviation = deviation or object_moved(self._expected, now, self._names, self._config, ignore)
        if deviation is None and self._sent:
            due = self._sent[0].drive
            expected = now.drive.copy() if self._by_tcp else due.copy()
            expected[:3] = due[:3]
            deviation = tracking_error(expected, now.drive, self._config)
        if deviation is None and action.name == "PickUp" and not phase.held:
            # The approach leads to the object's former position.
            index = self._names.index(action.target)
            away = float(np.linalg.norm(now.positions[index] - self._expected.positions[index]))
            starts = [one.start for one in action.trajectory.phases if one.name == "approach"]
            is_near = any(start - _LAST_LOOK[0] <= self._time < start - _LAST_LOOK[1] for start in starts)
            if is_near and action.target in self._unsure:
                return Deviation(DeviationKind.OBJECT_UNSURE, action.target)
            if away > self._config.displacement or (is_near and self._is_off_aim(now)):
                return Deviation(DeviationKind.OBJECT_MOVED, action.target)
        return deviation

    def _is_off_aim(self, now: Snapshot) -> bool:
        """Whether the object to grasp has turned since the plan, or it or a neighbour is perceived elsewhere."""
        planned = {body.name: body.position for body in self._present.scene.objects}
        body = self._present.scene.body(self._present.target)
        turned = turn_between(body.quaternion, now.quaternions[self._names.index(body.name)])
        target = body.position
        return (has_yaw(body) and abs(turned) > self._config.turn) or any(
            np.linalg.norm(seen - planned[name]) > self._config.aim
            for name, seen in zip(self._names, now.positions, strict=True)
            if name in planned and np.hypot(*(planned[name] - target)[:2]) < _BESIDE
        )

    def _check_grip(self, now: Snapshot, held: HeldObject | None) -> Deviation | None:
        """Deviation if the object was not grasped as planned, or has moved between the fingers since."""
        if held is None:
            self._grip, self._closed_for = None, 0.0
            return None
        self._closed_for += self._stride
        in_hand = now.in_hand(self._names.index(held.name))
        if self._closed_for < _GRIP_DELAY:
            return None
        if self._grip is None:
            self._grip = in_hand
            offset = float(np.linalg.norm(in_hand - held.T_tcp_object[:3, 3]))
            return Deviation(DeviationKind.GRASP_MISSED, held.name) if offset > 2 * self._config.slip else None
        slipped_by = float(np.linalg.norm(in_hand - self._grip))
        return Deviation(DeviationKind.SLIPPED, held.name) if slipped_by > self._config.slip else None


def _is_pull(action: BoundAction) -> bool:
    return action.scene.pull is not None and action.target == action.scene.pull.opening


def _pushes(action: BoundAction) -> bool:
    """Whether an action pushes something with closed fingers."""
    return _is_pull(action) and action.scene.pull is not None and action.scene.pull.pushes


def _not_opened(action: BoundAction, now: Snapshot) -> Deviation | None:
    """Deviation if a part is not where the action was to move it: the handle slipped, or the part jams."""
    pull = action.scene.pull
    if pull is None or not _is_pull(action) or pull.opening not in now.openings:
        return None
    opening = action.scene.opening(pull.opening)
    lacks = abs(now.openings[pull.opening] - pull.position) / abs(opening.open - opening.shut)
    most = AJAR if math.isclose(pull.position, opening.shut) else LACKS  # as for `closed`
    return Deviation(DeviationKind.NOT_OPENED, pull.opening) if lacks > most else None
