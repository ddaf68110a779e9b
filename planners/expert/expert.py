"""The scripted expert: it plans, executes in the simulation, watches for deviations, and plans again.

plan -> execute, one control step an action -> hold the target up -> success
  ^       | deviation: retreat, stop              | not held
  +-- settle -------------------------------------+
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planners.collision.scene_arrays import robot_arrays
from planners.contact import StepLabel, contacts
from planners.expert.config import ExpertConfig, ExpertError
from planners.expert.executor import Command, Executor
from planners.expert.interfaces import ScenePlanner, controlled_env, planner_for
from planners.expert.monitor import Sensor, held_object
from planners.expert.report import EpisodeReport, Recorder, Recording
from planners.goals import Goal, GoalError, height_below, holding
from planners.grasping.families import Grasps
from planners.motion.arm import tcp_pose, unwrap_joints
from planners.motion.tcp_following import ON_THE_WAY
from planners.motion.trajectory import CONTROL_STEP
from planners.placing.surfaces import Supports
from planners.planner import Planner
from planners.scene import AsideObject, ParkedArm, RobotState, Scene, SceneError
from planners.strategies import Strategy, find_strategy
from planners.tamp.solution import Infeasible, Solution

if TYPE_CHECKING:
    from planners.drawing.page.live import LivePage

Array = NDArray[np.float64]

_AT_START = 2
"""Control steps at the start of a new plan: it begins at the measured joint angles, not at those commanded last.

The difference together with the first motion would exceed the acceleration limit, and the joint would lag.
"""
_AIM = 1 / 3
"""Share of the accuracy of poses by which what is grasped may seem to have moved once the robot has come near: more is
seen wrongly from where the plan was made, and is planned again from here."""
_LEAST_AIM = 0.004
"""[m]"""
_NEAR_HOME = 0.05
"""[m], [rad]: a configuration this near to home is planned from as if it were home; the controller closes the gap."""


class TampExpert:
    """A policy for `clutter_env/Retrieve-…` that plans with exact knowledge of all object poses (privileged).

    Before `reset`, all that tells of an episode raises `ExpertError`.

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
        self,
        env: Any,
        strategy: str | Strategy = "lookahead",
        *,
        planner: ScenePlanner | None = None,
        grasps: Grasps | None = None,
        supports: Supports = None,
        canonical: bool | None = None,
        seed: int = 0,
        config: ExpertConfig | None = None,
    ) -> None:
        """Make an expert for an environment; call `reset` to begin an episode.

        Args:
            env: `clutter_env/Retrieve-…`, wrapped or not, or any environment with the `ControlledEnv` protocol. Its
                action space must not be changed by a wrapper.
            strategy: how to clear: a name of `planners.STRATEGIES`, or a `Strategy`.
            planner: a `Planner`, or any object with `solve(scene, target, strategy, rng, time_limit)`, which gets the
                `Strategy`; a new `Planner` if not given.
            grasps: the grasp set to choose from: "side", "tilted", "top", "all", or a tuple of `GraspFamily`; that of
                the planner if not given, which is "all" for a new one.
            supports: where objects may be put, as for `solve`; for a `Planner` only.
            canonical: whether to plan canonically: the same grasps and releases in similar scenes, without random
                numbers, every phase ending at rest, so that plans can be learned; as the planner does if not given.
                `report` says where it fell back.
            seed: of the planner's sampling; every `reset` starts from it.
            config: limits, tolerances, and whether an obstacle may be held aside.

        Raises:
            ExpertError: an environment, planner or config that cannot be used; the message says why.
            UnknownStrategy: neither the name of a strategy nor a `Strategy`.
            UnknownGraspSet: neither the name of a grasp set nor families.
            ArmsError: `config.hold_aside` with a robot that acts with one arm.
        """
        if not isinstance(config, ExpertConfig | None):
            raise ExpertError(f"config={config!r} is not valid; it must be an ExpertConfig")
        self._env = controlled_env(env)
        self._strategy = find_strategy(strategy)
        self._config = config or ExpertConfig()
        self._planner = planner_for(
            self._env, planner, grasps, supports, canonical=canonical, hold_aside=self._config.hold_aside
        )
        self._seed = seed
        self._dt = float(getattr(self._env, "dt", CONTROL_STEP))
        robot = self._env.robot
        self._robots = {arm: robot if arm == robot.arm_name else robot.using(arm) for arm in robot.acting_arms}
        monitor, accuracy = self._config.monitor, float(getattr(self._env, "pose_accuracy", 0.0))
        self._tolerances = replace(monitor, displacement=monitor.displacement + accuracy, slip=monitor.slip + accuracy)
        if accuracy > 0:
            self._tolerances = replace(self._tolerances, aim=max(accuracy * _AIM, _LEAST_AIM))
        self._has_begun = False
        self._solution: Solution | Infeasible | None = None

    def reset(self, goal: str | Goal | None = None) -> None:
        """Read the scene and plan; the environment may be in any state after its own reset.

        Args:
            goal: name of the object to retrieve, a `planners.goals.Goal` or its PDDL text; the environment's own if not
                given: its `planning_goal`, or `goal`, if it has one, else its target.

        Raises:
            ExpertError: the environment has not been reset, or no goal is given and its own is none for a planner.
            UnknownObject: no object of that name; the episode before goes on.
            GoalError: the goal means nothing in the scene; the episode before goes on.
        """
        env, planner = self._env, self._planner
        try:
            named = [name for name in ("planning_goal", "goal") if hasattr(type(env), name)]
            own = getattr(env, named[0]) if named else holding(env.target)
        except ValueError as error:
            raise ExpertError(f"reset the environment before the expert: {error}") from error
        if goal is None and not isinstance(own, Goal):
            raise ExpertError(f"the goal of {type(env).__name__} is no planners.goals.Goal; say which: reset(goal)")
        if isinstance(planner, Planner):
            planner.warmup()  # compiles kernels before any clock is started
        scene = self._read_scene()
        wanted = own if goal is None else Goal.of(goal)
        if wanted.target:
            scene.index(wanted.target)
        wanted.check(scene)
        # From here on this is another episode.
        self._has_begun, self._done, self._solution = False, False, None
        self._goal, self._start_scene = wanted, scene
        self._rng = np.random.default_rng(self._seed)
        self._recorder = Recorder(env, wanted.target)
        model, self._data = self._perceived.model, self._perceived.data
        self._started = self._now = float(env.data.time)
        self._sensors = {arm: Sensor(model, self._data, one, env.object_names) for arm, one in self._robots.items()}
        self._report = EpisodeReport()
        # While there is an executor, a plan is carried out. Otherwise the robot waits for `_wait` control steps, to
        # hold the target up or for objects to settle, and what comes next is decided after that.
        self._executor: Executor | None = None
        self._wait = 0
        arm = scene.robot.arm_name
        self._arm_targets = {one.name: np.array(one.home) for one in env.robot.arms}
        self._last = Command(self._sensors[arm].read().drive, env.robot.opening(scene.state.finger_position), arm)
        self._arm_targets[arm] = self._last.drive[4:]
        if self._config.with_floor and wanted.target:
            before = time.process_time()
            bounding = planner if isinstance(planner, Planner) else Planner(scene.robot)
            floor = bounding.clearance_floor(scene, wanted.target)
            count = floor.count if floor.proved else None
            self._report = EpisodeReport(floor=count, planning_s=time.process_time() - before)
        self._plan(scene)
        self._has_begun = True

    def act(self) -> Array:
        """The next action; call it once before every step of the environment.

        Raises:
            ExpertError: `reset` has not been called since the expert was made or since the environment was reset.
        """
        self._check_begun("act()")
        now = float(self._env.data.time)
        if self._perceived.data is not self._data or now < self._now:
            raise ExpertError("the environment was reset after the expert; call TampExpert.reset() again")
        self._now = now
        executor = self._executor
        if executor is None:
            self._recorder.add_frame()
            self._wait -= 1
            if not self._done and self._wait <= 0:
                self._check_result()
            return self._action(self._last)
        command = executor.advance(self._sensors[executor.arm].read())
        self._recorder.add_frame(executor.action, executor.phase)
        if not executor.is_over:
            return self._action(command)
        self._report = self._report.with_clearances(executor.cleared)
        self._executor = None
        if executor.deviation is None:
            self._hold()
        else:
            deviation = str(executor.deviation)
            self._note(deviation)
            if self._may_replan(f"gave up after {self._report.replans} replans; last deviation: {deviation}"):
                self._wait = self._steps(self._config.settle_s)
        return self._action(command)

    @property
    def done(self) -> bool:
        """Whether the expert has finished or given up."""
        self._check_begun("done")
        return self._done

    @property
    def report(self) -> EpisodeReport:
        """How the episode went, or how it stands."""
        self._check_begun("report")
        report, executor = self._report, self._executor
        if not self._done:
            report = report.with_clearances([] if executor is None else executor.cleared)
            report = replace(report, sim_s=float(self._env.data.time) - self._started)
            is_retrieved, unknown = self._result()
            if is_retrieved:
                is_executed = report.executed or (executor is not None and executor.deviation is None)
                report = replace(report, executed=is_executed, scored=True, failure="")
            else:
                report = replace(report, failure=report.failure or unknown or "unfinished")
        counts = getattr(self._env, "info", None) or {}
        if not {"num_fallen", "num_disturbed"} <= counts.keys():
            return report
        return replace(report, clean=report.scored and not (counts["num_fallen"] or counts["num_disturbed"]))

    @property
    def target(self) -> str:
        """Name of the object to retrieve, "" if the goal is another one."""
        self._check_begun("target")
        return self._goal.target

    @property
    def goal(self) -> Goal:
        """The goal of the episode."""
        self._check_begun("goal")
        return self._goal

    @property
    def phase(self) -> str:
        """Action and phase of the motion, for example "PickUp object_03: lift"; "" while the robot waits."""
        self._check_begun("phase")
        return "" if self._executor is None else self._executor.phase

    @property
    def step_label(self) -> StepLabel:
        """Label of the last action: phase, grasp or release, and the keyframe at the end of the phase."""
        self._check_begun("step_label")
        finger_position = self._env.robot.finger_position(self._last.opening)
        waiting = StepLabel("", None, np.append(self._last.drive, finger_position))
        return (self._executor and self._executor.label) or waiting

    @property
    def solution(self) -> Solution | Infeasible | None:
        """The result of the last solve; None before `reset`, or if the scene was not valid for planning."""
        return self._solution

    @property
    def recording(self) -> Recording:
        """States, plans and deviations of the episode until now."""
        self._check_begun("recording")
        return self._recorder.recording()

    def to_html(self, path: str | Path, rows: Mapping[str, str] | None = None, result: str = "") -> None:
        """Write the episode until now as one page for a browser, which needs no network: its motions on a time line.

        Beside the motions: the actions, negative goal regions and candidates of each clearance, base poses of the
        reachability map, planned paths of the gripper, plans after deviations, the report.

        Args:
            path: of the file.
            rows: names and values of the report on the page; those of `report` if not given.
            result: "success" or "failure"; that of `report` if not given.

        Raises:
            OSError: the file cannot be written.
        """
        # Drawing is built on the expert's recordings, and planning must not import it.
        from planners.drawing.page.page import write_page

        self._check_begun("to_html()")
        report = self.report
        rows = {"result": report.result, **report.rows()} if rows is None else rows
        write_page(Path(path), self.recording, rows, result or ("success" if report.result == "success" else "failure"))

    def live_page(self, port: int = 0) -> LivePage:
        """Serve the running episode to browsers of this machine; see `LivePage` for how it is kept up to date.

        Raises:
            OSError: the port is taken.
        """
        from planners.drawing.page.live import LivePage

        return LivePage(self.recording, port)

    def _check_begun(self, call: str) -> None:
        if not self._has_begun:
            raise ExpertError(f"call TampExpert.reset() before {call}")

    # Steps of the loop.

    def _plan(self, read: Scene | None = None) -> None:
        """Solve, as things are or were read, and begin to execute; or end the episode with the reason for failure."""
        before = time.process_time()
        try:
            scene = read or self._read_scene()
            goal, planner = self._goal.target or self._goal, self._planner
            given = scene, goal, self._strategy, self._rng, self._config.planning_s
            solution = planner.solve(*given, *[self._start_scene] * isinstance(planner, Planner))
            if isinstance(solution, Infeasible) and (wider := self._with_all_grasps(scene)) is not None:
                self._note(f"{solution.cause}: {solution.detail}; planned with all grasps")
                solution = wider.solve(*given, self._start_scene)
        except (SceneError, GoalError) as error:
            self._end(f"the scene is not valid for planning: {error}")
            return
        if not isinstance(solution, Solution | Infeasible):
            raise ExpertError(f"the planner returned {solution!r:.100}; it must return a Solution or an Infeasible")
        self._solution = solution
        self._recorder.add_solve(solution)
        planned, report = contacts(solution), self._report
        self._report = replace(
            report,
            planned=isinstance(solution, Solution),
            planning_s=report.planning_s + time.process_time() - before,
            contacts=report.contacts + len(planned),
            not_straight=report.not_straight + sum(not contact.is_straight for contact in planned),
        )
        if isinstance(solution, Infeasible):
            self._end(f"{solution.cause}: {solution.detail}")
        elif not solution.actions:
            self._hold()
        else:
            self._executor = Executor(
                solution.actions,
                self._env.robot,
                self._sensors[solution.actions[0].scene.robot.arm_name],
                self._tolerances,
                by_tcp=self._env.control_mode == "ee" or getattr(self._env, "waits_for_tcp", False),
                at_start=_AT_START if self._report.replans else 0,
                dt=self._dt,
                latency=getattr(self._env, "latency", 0),
                line_tolerance=getattr(self._env, "line_tolerance", ON_THE_WAY),
            )

    def _with_all_grasps(self, scene: Scene) -> Planner | None:
        """The planner with all grasps, to plan again once something has toppled: few grasp sets fit what lies."""
        planner, lies = self._planner, any(not body.is_upright for body in scene.objects)
        if not (self._report.replans and lies and isinstance(planner, Planner) and planner.grasps != "all"):
            return None
        return replace(planner, grasps="all", supports=planner.supports or (scene.support.name,))

    def _hold(self) -> None:
        """The plan is carried out to its end: hold the target up."""
        self._report = replace(self._report, executed=True)
        self._wait = self._steps(self._config.hold_s)

    def _check_result(self) -> None:
        """After waiting: the episode is over if the target is held up; otherwise plan again from how things are now."""
        is_retrieved, unknown = self._result()
        if is_retrieved or unknown:
            self._report = replace(self._report, scored=is_retrieved)
            self._end(unknown)
            return
        if self._report.executed:
            self._report = replace(self._report, executed=False)
            self._note("target not held" if self._goal.target else "goal not reached")
            end = "the target was not held" if self._goal.target else "the goal was not reached"
            if not self._may_replan(f"{end} at the end of the plan"):
                return
        self._plan()

    def _may_replan(self, failure: str) -> bool:
        """Count one more replan, or end the episode with a failure if there were too many."""
        if self._report.replans >= self._config.replans:
            self._end(failure)
            return False
        self._report = replace(self._report, replans=self._report.replans + 1)
        return True

    def _steps(self, seconds: float) -> int:
        """Steps in a time [s]; at least one, so that the simulation advances before the next look."""
        return max(round(seconds / self._dt), 1)

    def _note(self, deviation: str) -> None:
        self._report = replace(self._report, deviations=(*self._report.deviations, deviation))
        self._recorder.add_note(deviation)

    def _end(self, failure: str) -> None:
        self._report = replace(self._report, failure=failure, sim_s=float(self._env.data.time) - self._started)
        self._executor = None
        self._done = True

    def _action(self, command: Command) -> Array:
        """The environment's action for a command, in its own control mode."""
        self._last = command
        env, robot = self._env, self._env.robot
        if env.control_mode == "ee":
            T_world_tcp = tcp_pose(robot, RobotState(command.drive[:3], command.drive[3:], 0.0))
            return np.asarray(env.ee_action(command.drive[:3], T_world_tcp, command.opening))
        self._arm_targets[command.arm] = command.drive[4:]
        if not robot.acts_with_all_arms:
            return np.asarray(env.joint_action(command.drive, command.opening))
        # The arms that do not move stay where they were commanded last, their grippers closed.
        arms = robot.acting_arms
        q_target = np.concatenate((command.drive[:4], *(self._arm_targets[arm] for arm in arms)))
        widths = [command.opening if arm == command.arm else robot.opening(0.0) for arm in arms]
        return np.asarray(env.joint_action(q_target, np.array(widths)))

    # Reading the world.

    def _read_scene(self) -> Scene:
        """A snapshot with the arm active that is away from home; one near its home is taken to be exactly in it."""
        scenes = []
        for arm in self._robots:
            scene = self._measure(arm, held_object(self._measure(arm)))
            home = _home_of(scene)
            q = home if np.abs(scene.state.q - home).max() <= _NEAR_HOME else scene.state.q
            scenes.append(scene.with_state(RobotState(scene.state.base, q, scene.state.finger_position)))
        scene = max(scenes, key=lambda one: (not _is_at_home(one), one.held is not None))
        others = [one for one in scenes if one is not scene]
        if away := [one.robot.arm_name for one in others if not _is_at_home(one)]:
            raise SceneError(f"the arms {scene.robot.arm_name} and {', '.join(away)} are both away from home")
        held = [AsideObject(one.robot.arm_name, one.held) for one in others if one.held is not None]
        parked = [ParkedArm(one.robot.arm_name, one.state.q[1:]) for one in others]
        return replace(scene, aside=tuple(held), parked=tuple(parked))

    def _measure(self, arm: str = "", held: str = "") -> Scene:
        """The scene as it is now, with an arm active and this object in its gripper."""
        env, robot = self._env, self._robots.get(arm, self._env.robot)
        known = self._perceived
        return Scene.from_mujoco(
            known.model,
            known.data,
            robot,
            held,
            movable=env.object_names,
            support=env.support_name,
            more_supports=getattr(env, "more_supports", None),
            regions=getattr(env, "regions", ()),
        )

    @property
    def _perceived(self) -> Any:
        """`model` and `data` as the robot knows them: of an environment that says so, not the true ones."""
        return getattr(self._env, "perceived", self._env)

    def _result(self) -> tuple[bool, str]:
        """Whether the goal is reached, and why nobody can tell, such as a bin that has been knocked over; "" if so."""
        try:
            return self._is_retrieved(), ""
        except (SceneError, GoalError) as error:
            return False, f"whether the goal is reached cannot be measured: {error}"

    def _is_retrieved(self) -> bool:
        """Whether the goal is reached: the target held, high enough above the support that it stood on for success."""
        in_hand = {arm: held_object(self._measure(arm)) for arm in self._robots}
        target = self._goal.target
        if not target:
            arm, held = next((one for one in in_hand.items() if one[1]), ("", ""))
            return self._goal.holds(self._measure(arm, held), self._start_scene)
        stood_at = height_below(self._start_scene, self._start_scene.body(target))
        height = self._measure().body(target).bottom - stood_at
        return height > self._env.lift_height and target in in_hand.values()


def _home_of(scene: Scene) -> Array:
    """The home configuration of the active arm, unwrapped to the turns that its joints have now."""
    return unwrap_joints(robot_arrays(scene.robot), scene.state.q, np.array(scene.robot.home))


def _is_at_home(scene: Scene) -> bool:
    return np.array_equal(scene.state.q, _home_of(scene))
