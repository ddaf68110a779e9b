"""One episode of the expert: plan, execute, and plan again after a deviation."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planners.collision.scene_arrays import robot_arrays
from planners.contact import StepLabel
from planners.execution.config import ExpertConfig
from planners.execution.controlled_env import ControlledEnv, num_disturbances
from planners.execution.errors import ExpertError
from planners.execution.executor import CONTROL_STEP, Command, Executor, Outcome, Step
from planners.execution.holding import ArmTargets, height_below, held_object
from planners.execution.monitor import Sensor
from planners.execution.recorder import Recorder
from planners.execution.report import EpisodeReport
from planners.execution.scene_planner import ScenePlanner, checked_outcome, floor_of_scene, warm_up
from planners.motion.arm import tcp_pose, unwrap_joints
from planners.scene import AsideObject, ParkedArm, RobotState, Scene, SceneError
from planners.strategies import Strategy
from planners.tamp.recording import Recording
from planners.tamp.solution import Infeasible, Solution, contacts

__all__ = ["Episode"]

Array = NDArray[np.float64]

_AT_START = 2
"""Control steps at the start of a new plan: it begins at the measured joint angles, not at those commanded last.

The difference together with the first motion would exceed the acceleration limit, and the joint would lag.
"""
_NEAR_HOME = 0.05
"""[m], [rad]: a configuration this near to home is planned from as if it were home; the controller closes the gap."""


class Episode:
    """The state of the expert in one episode of the environment.

    Attributes:
        target: name of the object to retrieve.
        done: whether the expert has finished or given up.
        solution: the result of the last solve.
    """

    def __init__(
        self,
        env: ControlledEnv,
        planner: ScenePlanner,
        strategy: Strategy,
        config: ExpertConfig,
        rng: np.random.Generator,
        target: str,
    ) -> None:
        """Read the scene and plan.

        Raises:
            UnknownObject: no object of the name `target`.
        """
        warm_up(planner)
        self._env, self._planner, self._strategy, self._config, self._rng = env, planner, strategy, config, rng
        self.target = target
        self.done = False
        self.solution: Solution | Infeasible | None = None
        self._data = env.data
        self._started = self._now = float(env.data.time)
        self._robots = {
            arm: env.robot if arm == env.robot.arm_name else env.robot.using(arm) for arm in env.robot.acting_arms
        }
        self._sensors = {
            arm: Sensor(env.model, env.data, robot, env.object_names) for arm, robot in self._robots.items()
        }
        self._report = EpisodeReport()
        self._recorder = Recorder(env, target)
        self._executor: Executor | None = None
        self._wait = 0
        scene = self._read_scene()
        self._stood_at = height_below(scene, scene.body(target))
        state, arm = scene.state, scene.robot.arm_name
        opening = env.robot.opening(state.finger_position)
        self._last = Command(self._sensors[arm].read().drive, opening, arm)
        self._targets = ArmTargets(env.robot, self._last)
        if config.with_floor:
            before = time.process_time()
            floor = floor_of_scene(planner, scene, target)
            self._report = replace(self._report, floor=floor, planning_s=time.process_time() - before)
        self._plan(scene)

    @property
    def phase(self) -> str:
        """The action and the phase of its motion; "" while the robot waits."""
        return "" if self._executor is None else self._executor.phase

    @property
    def step_label(self) -> StepLabel:
        """What the last action is part of; no phase and the present command while the robot waits."""
        label = None if self._executor is None else self._executor.label
        if label is not None:
            return label
        finger_position = self._env.robot.finger_position(self._last.opening)
        return StepLabel("", None, np.append(self._last.drive, finger_position))

    @property
    def report(self) -> EpisodeReport:
        """How the episode went, or how it stands: the environment may end before the plan does."""
        report = self._standing()
        disturbances = num_disturbances(self._env)
        return report if disturbances is None else replace(report, clean=report.scored and not disturbances)

    @property
    def recording(self) -> Recording:
        """All states, plans and deviations until now."""
        return self._recorder.recording()

    def _standing(self) -> EpisodeReport:
        """The report without the environment's judgement; while the episode goes on, as if it ended now."""
        if self.done:
            return self._report
        executor = self._executor
        cleared = [] if executor is None else executor.cleared
        report = replace(self._report.with_clearances(cleared), sim_s=self._elapsed)
        if not self._is_retrieved():
            return replace(report, failure=report.failure or "unfinished")
        is_executed = report.executed or (executor is not None and executor.deviation is None)
        return replace(report, executed=is_executed, scored=True, failure="")

    def act(self) -> Array:
        """The next action; after the end of the episode the robot holds its position.

        Raises:
            ExpertError: the environment has been reset since the episode began.
        """
        self._check_time()
        executor = self._executor
        if executor is not None:
            step = executor.advance(self._sensors[executor.arm].read())
            self._recorder.step(executor.action, executor.phase)
            if step.outcome is not Outcome.RUNNING:
                self._conclude(step)
            return self._action(step.command)
        self._recorder.step()
        if not self.done:
            self._wait -= 1
            if self._wait <= 0:
                self._check_result()
        return self._action(self._last)

    def _check_time(self) -> None:
        now = float(self._env.data.time)
        if self._env.data is not self._data or now < self._now:
            raise ExpertError("the environment was reset after the expert; call TampExpert.reset() again")
        self._now = now

    @property
    def _elapsed(self) -> float:
        return float(self._env.data.time) - self._started

    def _read_scene(self) -> Scene:
        """A snapshot with the arm active that is away from home; one near its home is taken to be exactly in it."""
        scenes = [self._near_home(self._measure(arm, self._held(arm))) for arm in self._robots]
        scene = max(scenes, key=lambda one: (not _is_at_home(one), one.held is not None))
        others = [one for one in scenes if one is not scene]
        if away := [one.robot.arm_name for one in others if not _is_at_home(one)]:
            raise SceneError(f"the arms {scene.robot.arm_name} and {', '.join(away)} are both away from home")
        held = [AsideObject(one.robot.arm_name, one.held) for one in others if one.held is not None]
        parked = [ParkedArm(one.robot.arm_name, one.state.q[1:]) for one in others]
        return replace(scene, aside=tuple(held), parked=tuple(parked))

    def _near_home(self, scene: Scene) -> Scene:
        home = unwrap_joints(robot_arrays(scene.robot), scene.state.q, np.array(scene.robot.home))
        if np.abs(scene.state.q - home).max() > _NEAR_HOME:
            home = scene.state.q
        return scene.with_state(RobotState(scene.state.base, home, scene.state.finger_position))

    def _measure(self, arm: str = "", held: str = "") -> Scene:
        """The scene as it is now, with an arm active and this object in its gripper."""
        env, robot = self._env, self._robots.get(arm, self._env.robot)
        return Scene.from_mujoco(env.model, env.data, robot, held, movable=env.object_names, support=env.support_name)

    def _held(self, arm: str) -> str:
        """The object that an arm's gripper holds; "" for none."""
        return held_object(self._measure(arm))

    def _is_retrieved(self) -> bool:
        """Whether the target is held, high enough above the support that it stood on for success."""
        height = self._measure().body(self.target).bottom - self._stood_at
        return height > self._env.lift_height and self.target in map(self._held, self._robots)

    def _plan(self, scene: Scene) -> None:
        """Solve and begin to execute, or end the episode with the reason for failure."""
        before = time.process_time()
        limit = self._config.planning_s
        try:
            outcome = self._planner.solve(scene, self.target, self._strategy, self._rng, limit)
        except SceneError as error:
            self._end(f"the scene is not valid for planning: {error}")
            return
        self.solution = solution = checked_outcome(outcome)
        self._recorder.solved(solution)
        spent = self._report.planning_s + time.process_time() - before
        self._report = replace(self._report, planned=isinstance(solution, Solution), planning_s=spent)
        self._report = self._report.with_contacts([contact.is_straight for contact in contacts(solution)])
        if isinstance(solution, Infeasible):
            self._end(f"{solution.cause}: {solution.detail}")
            return
        if not solution.actions:
            self._hold()
            return
        sensor, by_tcp = self._sensors[solution.actions[0].scene.robot.arm_name], self._env.control_mode == "ee"
        at_start = _AT_START if self._report.replans else 0
        self._executor = Executor(
            solution.actions, self._env.robot, sensor.names, sensor.read(), self._config.monitor, by_tcp, at_start
        )

    def _conclude(self, step: Step) -> None:
        """After the last step of a plan: hold the target up, or wait until the objects are at rest."""
        assert self._executor is not None
        self._report = self._report.with_clearances(self._executor.cleared)
        self._executor = None
        if step.outcome is Outcome.FINISHED:
            self._hold()
            return
        self._note(str(step.deviation))
        if self._may_replan(f"gave up after {self._report.replans} replans; last deviation: {step.deviation}"):
            self._wait = _steps(self._config.settle_s)

    def _hold(self) -> None:
        """Hold the target up; the plan is carried out to its end."""
        self._report = replace(self._report, executed=True)
        self._wait = _steps(self._config.hold_s)

    def _check_result(self) -> None:
        """After waiting: the episode is over if the target is held up; otherwise plan again."""
        if self._is_retrieved():
            self._report = replace(self._report, scored=True)
            self._end("")
            return
        if self._report.executed:
            self._report = replace(self._report, executed=False)
            self._note("target not held")
            if not self._may_replan("the target was not held at the end of the plan"):
                return
        self._replan()

    def _replan(self) -> None:
        """Plan from how things are now, if arms and objects are where a plan can begin."""
        try:
            scene = self._read_scene()
        except SceneError as error:
            self._end(f"the scene is not valid for planning: {error}")
            return
        self._plan(scene)

    def _note(self, deviation: str) -> None:
        self._report = replace(self._report, deviations=(*self._report.deviations, deviation))
        self._recorder.note(deviation)

    def _may_replan(self, failure: str) -> bool:
        """Count one more replan, or end the episode with a failure if there were too many."""
        if self._report.replans >= self._config.replans:
            self._end(failure)
            return False
        self._report = replace(self._report, replans=self._report.replans + 1)
        return True

    def _end(self, failure: str) -> None:
        self._report = replace(self._report, failure=failure, sim_s=self._elapsed)
        self._executor = None
        self.done = True

    def _action(self, command: Command) -> Array:
        """The environment's action for a command, in its own control mode."""
        self._last = command
        if self._env.control_mode == "joint":
            return np.asarray(self._env.joint_action(*self._targets.of(command)))
        state = RobotState(command.drive[:3], command.drive[3:], 0.0)
        return np.asarray(self._env.ee_action(command.drive[:3], tcp_pose(self._env.robot, state), command.opening))


def _is_at_home(scene: Scene) -> bool:
    """Whether the active arm is in its home configuration, but for whole turns."""
    home = unwrap_joints(robot_arrays(scene.robot), scene.state.q, np.array(scene.robot.home))
    return np.array_equal(scene.state.q, home)


def _steps(seconds: float) -> int:
    """Control steps in a time [s]; at least one, so that the simulation advances before the next look."""
    return max(round(seconds / CONTROL_STEP), 1)
