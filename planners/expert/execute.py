"""Execution of a plan in your own MuJoCo simulation, without a Gymnasium environment.

Example:
    scene = Scene.from_mujoco(model, data, FETCH, movable=["can", "box"], support="table")
    solution = solve(scene, "can")
    print(execute(solution, model, data))
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np

from assets.robots import RobotSpec
from planners.checking import check
from planners.expert.config import ExpertError, MonitorConfig
from planners.expert.executor import Command, Executor
from planners.expert.monitor import Deviation, Sensor
from planners.motion.trajectory import CONTROL_STEP
from planners.scene.findings import Reason
from planners.scene.mujoco_reading import RobotJoints
from planners.scene.prepare import COMMAND_STEP, ghosts
from planners.scene.robot_names import robot_prefix
from planners.tamp.solution import BoundAction, Solution

_SEGMENTS = round(CONTROL_STEP / COMMAND_STEP)
"""Steps in which the motor commands move within one control step."""
_BODY = mujoco.mjtObj.mjOBJ_BODY


@dataclass(frozen=True)
class ExecutionResult:
    """End of an execution.

    Attributes:
        finished: whether every action was executed. Read the scene again and call `Goal.holds` to test the goal.
        deviation: the deviation that stopped the plan, if any.
        cleared: names of the objects put aside, in order.
        sim_s: simulated time [s].
        why: findings of `planners.check` at the start about the object that deviated, or about objects that were to
            fall. "" for none.
    """

    finished: bool
    deviation: Deviation | None
    cleared: tuple[str, ...]
    sim_s: float
    why: str = field(default="", repr=False)

    def __str__(self) -> str:
        return f"{self!r}: {self.why}" if self.why else repr(self)


def execute(
    solution: Solution,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    on_step: Callable[[], None] | None = None,
    config: MonitorConfig | None = None,
) -> ExecutionResult:
    """Execute a plan in the simulation that its scene was read from. `data` is stepped.

    The robot's position actuators have the names of its joints, as in the MJCF of this package's robots. A deviation
    stops the plan after a retreat: an object slipped, toppled or was pushed, or the robot lags.

    Args:
        solution: the plan.
        model: the simulation.
        data: its state, from which the scene was read.
        on_step: called after every control step of 0.05 s, for example to draw.
        config: tolerances of the monitor.

    Raises:
        ExpertError: the model lacks an actuator of the robot, or its time step does not divide 0.01 s. The plan is for
            several arms, or the robot passes through one of its objects: see `planners.prepare`.
        SceneError: the model lacks the robot or an object of the plan.
    """
    if not solution.actions:
        return ExecutionResult(True, None, (), 0.0)
    scene = solution.actions[0].scene
    if len({action.scene.robot.arm_name for action in solution.actions}) > 1:
        raise ExpertError("a plan for several arms is executed by TampExpert alone; robot.using(arm) plans for one")
    bodies = {model.body(name).id: name for name in scene.names if mujoco.mj_name2id(model, _BODY, name) >= 0}
    if ghosts_found := ghosts(model, scene.robot, bodies):
        names = ", ".join(dict.fromkeys(bodies[int(model.geom_bodyid[geom])] for geom in ghosts_found))
        raise ExpertError(
            f"robot {scene.robot.name!r} passes through {names}: their contact bits do not meet its own; execute in "
            "planners.prepare(model, robot).model"
        )
    motors, started = _Motors(model, data, scene.robot), float(data.time)

    def step(command: Command) -> bool:
        motors.move_to(command)
        if on_step is not None:
            on_step()
        return False

    handle = "" if scene.pull is None else scene.pull.handle
    sensor = Sensor(model, data, scene.robot, [name for name in scene.names if name != handle])
    done = follow(solution.actions, scene.robot, sensor, step, config or MonitorConfig())
    cleared, lasted, stopped = tuple(done.cleared), float(data.time) - started, done.deviation
    if stopped is None:
        return ExecutionResult(True, None, cleared, lasted)
    report = check(scene)
    # a falling object may have pushed this one
    odd = report.about((stopped.object,)) or [one for one in report.findings if one.reason is Reason.FLOATING]
    return ExecutionResult(False, stopped, cleared, lasted, "; ".join(map(str, odd)))


def follow(
    actions: Sequence[BoundAction],
    robot: RobotSpec,
    sensor: Sensor,
    step: Callable[[Command], bool],
    config: MonitorConfig,
) -> Executor:
    """Follow motions to their end or to a deviation. Return the executor, whose `deviation` is None after success.

    Args:
        actions: the plan.
        robot: the robot that executes it.
        sensor: reads the world.
        step: executes the command of one control step, and returns True after the last possible one.
        config: tolerances of the monitor.
    """
    executor, is_over = Executor(actions, robot, sensor, config), False
    while not executor.is_over and not is_over:
        is_over = step(executor.advance(sensor.read()))
    return executor


class _Motors:
    """Position actuators of a robot. Their commands move linearly within a control step."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, robot: RobotSpec) -> None:
        prefix = robot_prefix(model, robot)
        drive, fingers = ([prefix + name for name in names] for names in (robot.drive_joints, robot.finger_joints))
        names = (*drive, *fingers)
        missing = [name for name in names if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, name) < 0]
        if missing:
            raise ExpertError(f"the model lacks position actuators of robot {robot.name!r}: {', '.join(missing)}")
        self._steps = round(CONTROL_STEP / _SEGMENTS / model.opt.timestep)
        if self._steps < 1 or not np.isclose(self._steps * model.opt.timestep * _SEGMENTS, CONTROL_STEP):
            raise ExpertError(
                f"a time step of {model.opt.timestep} s does not divide {COMMAND_STEP} s, after which commands change; "
                "execute in planners.prepare(model, robot).model"
            )
        self._model, self._data, self._robot = model, data, robot
        self._joints = RobotJoints.of(model, data, robot)
        self._drive = np.array([model.actuator(name).id for name in drive])
        self._fingers = np.array([model.actuator(name).id for name in fingers])
        # Closed beyond 0, the fingers press with full force: see prepare.
        self._closed = min(float(model.actuator_ctrlrange[self._fingers, 0].max()), 0.0)
        self._feedforward = np.array(robot.velocity_feedforward(model, tuple(drive)))
        self._last = self._joints.read(data)
        self._finger = float(np.mean([data.joint(name).qpos[0] for name in fingers]))
        head = [model.actuator(prefix + name).id for name in robot.still_joints]
        data.ctrl[head] = robot.still_configuration

    def move_to(self, command: Command) -> None:
        """Step the simulation for one control step towards a command."""
        start, start_finger = self._last, self._finger
        goal = np.array(command.drive)
        goal[2] += 2 * np.pi * np.round((start[2] - goal[2]) / (2 * np.pi))  # the shorter turn
        finger = self._robot.finger_position(command.opening) or self._closed
        velocity = (self._joints.positions(goal) - self._joints.positions(start)) / CONTROL_STEP
        for share in np.arange(1, _SEGMENTS + 1) / _SEGMENTS:
            drive = self._joints.positions(start + share * (goal - start))
            self._data.ctrl[self._drive] = drive + self._feedforward * velocity
            self._data.ctrl[self._fingers] = start_finger + share * (finger - start_finger)
            mujoco.mj_step(self._model, self._data, nstep=self._steps)
        mujoco.mj_kinematics(self._model, self._data)
        self._last, self._finger = goal, finger
