"""The scripted expert: plans, executes in physics, watches, and replans when the world is not as expected."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.collision.robot_model import robot_arrays
from planners.execution.executor import CONTROL_STEP, Command, Execution, Outcome, Step
from planners.execution.monitor import MonitorConfig, Sensor
from planners.motion.arm import tcp_pose, unwrap_joints
from planners.motion.tcp_following import TcpFollower
from planners.planner import Planner
from planners.scene import RobotState, Scene, SceneError
from planners.strategies import strategy as find_strategy
from planners.tamp.solution import Infeasible, Solution

__all__ = ["EpisodeReport", "ExpertConfig", "TampExpert"]

Array = NDArray[np.float64]

_NEARLY_HOME = 0.05
"""[m], [rad]: joints this near to the home configuration are taken to be in it; the controller closes the gap."""
_OFF_TABLE = 0.01
"""[m] above the table: what is lower may still stand on it."""
_LIFTED = 0.10
"""[m] above the table: the environment's mark for success."""


class ControlledEnv(Protocol):
    """What the expert needs of an environment (`env.unwrapped`)."""

    model: mujoco.MjModel
    data: mujoco.MjData
    robot: RobotSpec

    def joint_action(self, q_target: Array, gripper_width: float) -> Array: ...

    def tcp_follower(self) -> TcpFollower: ...

    def ee_action(self, base_target: Array, T_world_tcp: Array, gripper_width: float) -> Array: ...


@dataclass(frozen=True)
class ExpertConfig:
    """How the expert goes about it.

    Attributes:
        replans: new plans at most after deviations in one episode.
        planning_s: [s] for one solve.
        settle_s: [s] to wait before looking at the scene again after a surprise.
        hold_s: [s] to hold the target up in the end.
        with_floor: whether the report says how many clearances were needed at least.
        monitor: what counts as a surprise.
    """

    replans: int = 6
    planning_s: float = 30.0
    settle_s: float = 0.5
    hold_s: float = 0.8
    with_floor: bool = True
    monitor: MonitorConfig = field(default_factory=MonitorConfig)


@dataclass(frozen=True)
class EpisodeReport:
    """How an episode went.

    Attributes:
        planned: a plan was found (the last one, if there were several).
        executed: the last plan was carried out to its end.
        scored: the target is held up.
        failure: why not, "" for success.
        clearances: objects put aside in physics, in order.
        duplicated: those put aside more than once.
        replans: plans made after the first one.
        floor: the fewest objects any plan must clear, None if not asked for or not proved.
        planning_s: CPU time [s] spent planning.
        sim_s: simulated time [s] since reset.
        deviations: what made the expert replan, in words.
    """

    planned: bool = False
    executed: bool = False
    scored: bool = False
    failure: str = ""
    clearances: tuple[str, ...] = ()
    duplicated: tuple[str, ...] = ()
    replans: int = 0
    floor: int | None = None
    planning_s: float = 0.0
    sim_s: float = 0.0
    deviations: tuple[str, ...] = ()


class TampExpert:
    """A policy for `clutter_env/Retrieve-…` that plans with exact knowledge of all object poses (privileged).

    Example:
        env = gymnasium.make("clutter_env/Retrieve-o15-v0")
        _, info = env.reset(seed=0)
        expert = TampExpert(env)
        expert.reset(info["target"])
        while not expert.done:
            env.step(expert.act())
        print(expert.report)
    """

    def __init__(
        self, env: Any, strategy: str = "lookahead", *, seed: int = 0, config: ExpertConfig | None = None
    ) -> None:
        """Make an expert for an environment.

        Args:
            env: a Gymnasium environment of this package, wrapped or not.
            strategy: how to clear; see `planners.strategies`.
            seed: of the planner's sampling.
            config: limits and tolerances.

        Raises:
            UnknownStrategy: no strategy of that name.
        """
        find_strategy(strategy)
        self._env: Any = env.unwrapped
        self._strategy = strategy
        self._seed = seed
        self._config = config or ExpertConfig()
        follower = self._env.tcp_follower() if self._env.config.control_mode == "ee" else None
        self._planner = Planner(self._env.robot, follower=follower)
        self._report = EpisodeReport()
        self.done = True
        self.solution: Solution | Infeasible | None = None

    def reset(self, target: str | None = None) -> None:
        """Look at the scene and plan, from any state of the environment.

        Args:
            target: the object to retrieve; the environment's own target if not given.
        """
        self._target = target or self._env.world.names[self._env.target_slot]
        self._rng = np.random.default_rng(self._seed)
        self._started = float(self._env.data.time)
        self._report = EpisodeReport()
        self.done = False
        self._wait = 0
        self._execution: Execution | None = None
        scene = Scene.from_mujoco(self._env.model, self._env.data, self._env.robot)
        self._sensor = Sensor(self._env.model, self._env.data, self._env.robot, scene.names)
        state = scene.state
        opening = self._env.robot.finger_gap_closed + 2 * state.finger_position
        self._last = Command(np.concatenate((state.base, state.q)), opening)
        self._plan(self._read_scene())

    @property
    def report(self) -> EpisodeReport:
        """How the episode went, or how it stands: at success the environment may end before the plan does."""
        if self.done or self._execution is None or self._execution.deviation is not None:
            return self._report
        lifted = self._held() == self._target and self._is_lifted()
        if not lifted:
            return replace(self._report, failure=self._report.failure or "unfinished", sim_s=self._elapsed)
        clearances = (*self._report.clearances, *self._execution.cleared)
        return replace(self._with_clearances(clearances), executed=True, scored=True, failure="", sim_s=self._elapsed)

    @property
    def _elapsed(self) -> float:
        return float(self._env.data.time) - self._started

    def _with_clearances(self, clearances: tuple[str, ...]) -> EpisodeReport:
        duplicated = tuple(sorted({name for name in clearances if clearances.count(name) > 1}))
        return replace(self._report, clearances=clearances, duplicated=duplicated)

    @property
    def target(self) -> str:
        """The object to retrieve."""
        return self._target

    @property
    def phase(self) -> str:
        """What the robot is doing, for example "PickUp object_03: lift"; "" while it waits."""
        return "" if self._execution is None else self._execution.phase

    def act(self) -> Array:
        """The next action; call it once per step, and step with it."""
        if self._execution is not None:
            step = self._execution.advance(self._sensor.read())
            if step.outcome is not Outcome.RUNNING:
                self._conclude(step)
            return self._action(step.command)
        if self._wait > 0:
            self._wait -= 1
            if self._wait == 0:
                self._look_again()
        return self._action(self._last)

    def _read_scene(self) -> Scene:
        """A snapshot, the robot taken to be in its exact home configuration if it nearly is."""
        env = self._env
        held = self._held()
        scene = Scene.from_mujoco(env.model, env.data, env.robot, held)
        home = unwrap_joints(robot_arrays(env.robot), scene.state.q, np.array(env.robot.home))
        if np.abs(scene.state.q - home).max() > _NEARLY_HOME:
            home = scene.state.q
        return scene.with_state(RobotState(scene.state.base, home, scene.state.finger_position))

    def _held(self) -> str:
        """The object between the fingers that stands on nothing; "" for none."""
        now = self._sensor.read()
        scene = Scene.from_mujoco(self._env.model, self._env.data, self._env.robot)
        for index, body in enumerate(scene.objects):
            away = np.abs(now.in_hand(index))
            is_near = max(away[0], away[1]) < self._config.monitor.slip and away[2] < body.half_extents[2]
            if is_near and body.bottom > scene.support.top + _OFF_TABLE:
                return body.name
        return ""

    def _plan(self, scene: Scene) -> None:
        """Solve from here and start to execute, or end with the reason why not."""
        before = time.process_time()
        if self._config.with_floor and self._report.floor is None and self._report.replans == 0:
            floor = self._planner.clearance_floor(scene, self._target)
            self._report = replace(self._report, floor=floor.count if floor.proved else None)
        try:
            self.solution = self._planner.solve(scene, self._target, self._strategy, self._rng, self._config.planning_s)
        except SceneError as error:
            self._end(f"the scene cannot be planned in: {error}")
            return
        spent = self._report.planning_s + time.process_time() - before
        planned = isinstance(self.solution, Solution)
        self._report = replace(self._report, planned=planned, planning_s=spent)
        if isinstance(self.solution, Infeasible):
            self._end(f"{self.solution.cause}: {self.solution.detail}")
            return
        self._execution = Execution(
            self.solution,
            self._env.robot,
            self._sensor.names,
            self._sensor.read(),
            self._config.monitor,
            by_tcp=self._env.config.control_mode == "ee",
        )

    def _conclude(self, step: Step) -> None:
        """After the last step of a plan: hold the target up, or look again and replan."""
        assert self._execution is not None
        self._report = self._with_clearances((*self._report.clearances, *self._execution.cleared))
        self._last = step.command
        self._execution = None
        if step.outcome is Outcome.FINISHED:
            self._report = replace(self._report, executed=True)
            self._wait = round(self._config.hold_s / CONTROL_STEP)
            return
        self._report = replace(self._report, deviations=(*self._report.deviations, str(step.deviation)))
        if self._report.replans >= self._config.replans:
            self._end(f"gave up after {self._report.replans} replans; last surprise: {step.deviation}")
            return
        self._report = replace(self._report, replans=self._report.replans + 1)
        self._wait = round(self._config.settle_s / CONTROL_STEP)

    def _look_again(self) -> None:
        """After waiting: the episode is over if the target is held up; otherwise plan anew."""
        if self._held() == self._target and self._is_lifted():
            self._report = replace(self._report, scored=True)
            self._end("")
        elif self._report.executed:
            self._report = replace(
                self._report, executed=False, deviations=(*self._report.deviations, "target not held")
            )
            if self._report.replans >= self._config.replans:
                self._end("the target was not in the hand in the end")
                return
            self._report = replace(self._report, replans=self._report.replans + 1)
            self._plan(self._read_scene())
        else:
            self._plan(self._read_scene())

    def _is_lifted(self) -> bool:
        scene = Scene.from_mujoco(self._env.model, self._env.data, self._env.robot)
        return scene.body(self._target).bottom > scene.support.top + _LIFTED

    def _end(self, failure: str) -> None:
        self._report = replace(self._report, failure=failure, sim_s=self._elapsed)
        self._execution = None
        self._wait = 0
        self.done = True

    def _action(self, command: Command) -> Array:
        """The environment's action for a command, in its own control mode."""
        self._last = command
        if self._env.config.control_mode == "joint":
            return np.asarray(self._env.joint_action(command.drive, command.opening))
        state = RobotState(command.drive[:3], command.drive[3:], 0.0)
        return np.asarray(self._env.ee_action(command.drive[:3], tcp_pose(self._env.robot, state), command.opening))
