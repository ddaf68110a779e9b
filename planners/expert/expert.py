"""The scripted expert: it plans, executes in the simulation, monitors deviations, and plans again.

plan -> execute, one control step an action -> hold the target up -> success
  ^       | deviation: retreat, stop              | not held
  +-- settle -------------------------------------+
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planners.contact import StepLabel
from planners.expert.actions import Actions
from planners.expert.actor import AT_START, Actor, Follow, Step, Steps, Wait
from planners.expert.config import ExpertConfig, ExpertError
from planners.expert.executor import Command, Executor
from planners.expert.interfaces import ScenePlanner, controlled_env, planner_for
from planners.expert.report import EpisodeReport, Recorder, Recording
from planners.expert.world import PerceivedWorld
from planners.goals import Goal, GoalError, holding
from planners.grasping.families import Grasps, find_grasp_set
from planners.motion.tcp_following import ON_THE_WAY
from planners.motion.trajectory import CONTROL_STEP
from planners.placing.surfaces import Supports
from planners.planner import Planner
from planners.scene import Scene, SceneError
from planners.strategies import Strategy, find_strategy
from planners.tamp.solution import BoundAction, Infeasible, Solution

if TYPE_CHECKING:
    from planners.drawing.page.live import LivePage

Array = NDArray[np.float64]

_AIM = 1 / 3
"""Share of the pose accuracy that a grasped object may seem to have moved once the robot is near. After a larger
motion, the object was perceived wrongly from afar, and the plan is made again from here."""
_LEAST_AIM = 0.004
"""Smallest such tolerance [m]."""


class TampExpert:
    """A policy for `clutter_env/Retrieve-…` that plans with exact knowledge of all object poses (privileged).

    Before `reset`, everything about an episode raises `ExpertError`.

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
        """Make an expert for an environment. Call `reset` to begin an episode.

        Args:
            env: `clutter_env/Retrieve-…`, wrapped or not, or any environment with the `ControlledEnv` protocol. Its
                action space must not be changed by a wrapper.
            strategy: strategy for clearing: a name of `planners.STRATEGIES`, or a `Strategy`.
            planner: a `Planner`, or any object with `solve(scene, target, strategy, rng, time_limit)`, which gets the
                `Strategy`. Default: a new `Planner`.
            grasps: the grasp set to choose from: "side", "tilted", "top", "all", or a tuple of `GraspFamily`. Default:
                the planner's, which is "all" for a new one.
            supports: supports for objects put aside, as for `solve`. For a `Planner` only.
            canonical: whether to plan canonically, so that plans can be learned. Similar scenes then get the same
                grasps and releases, without random choices, and every phase ends at rest. Default: the planner's
                choice. `report` says where it fell back.
            seed: seed of the planner's sampling. Every `reset` starts from it.
            config: limits, tolerances, and whether an obstacle may be held aside.

        Raises:
            ExpertError: the environment, planner or config cannot be used. The message says why.
            UnknownStrategy: the strategy is neither a known name nor a `Strategy`.
            UnknownGraspSet: the grasps are neither the name of a grasp set nor families.
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
        self._world = PerceivedWorld(self._env)
        monitor, accuracy = self._config.monitor, float(getattr(self._env, "pose_accuracy", 0.0))
        self._tolerances = replace(monitor, displacement=monitor.displacement + accuracy, slip=monitor.slip + accuracy)
        if accuracy > 0:
            self._tolerances = replace(self._tolerances, aim=max(accuracy * _AIM, _LEAST_AIM))
        self._has_begun = False
        self._solution: Solution | Infeasible | None = None

    def reset(self, goal: str | Goal | None = None) -> None:
        """Read the scene and plan. The environment may be in any state after its own reset.

        Args:
            goal: name of the object to retrieve, a `planners.goals.Goal` or its PDDL text. Default: the environment's
                `planning_goal` or `goal`, if it has one, else its target.

        Raises:
            ExpertError: the environment has not been reset, or its own goal is needed but is no `Goal`.
            UnknownObject: no object of that name. The former episode goes on.
            GoalError: the goal is invalid in the scene. The former episode goes on.
        """
        own = self._goal_of_env()
        if goal is None and not isinstance(own, Goal):
            kind = type(self._env).__name__
            raise ExpertError(f"the goal of {kind} is no planners.goals.Goal; say which: reset(goal)")
        if isinstance(self._planner, Planner):
            self._planner.warmup()  # compiles kernels before any clock is started
        scene = self._world.scene()
        wanted = Goal.of(own if goal is None else goal, scene)
        if wanted.target:
            scene.index(wanted.target)
        wanted.check(scene)
        # From here on, this is another episode.
        self._has_begun, self._solution = False, None
        self._goal, self._start_scene = wanted, scene
        self._rng = np.random.default_rng(self._seed)
        self._recorder = Recorder(self._env, wanted.target)
        self._data, self._started = self._world.source.data, self._time
        self._world = PerceivedWorld(self._env)
        self._now, self._sensors = self._started, self._world.sensors()
        self._report = self._bounded(scene)
        arm = scene.robot.arm_name
        last = Command(self._sensors[arm].read().drive, self._env.robot.opening(scene.state.finger_position), arm)
        self._actions, self._actor = Actions(self._env, last), Actor(last, partial(self._plan, scene))
        self._actor.decide()
        self._has_begun = True

    def act(self, observation: Any = None) -> Array:  # noqa: ARG002  of policies that are told what they see
        """Return the next action. Call it once before every step of the environment.

        Args:
            observation: ignored, since the expert reads the simulation. It makes the expert callable like other
                policies.

        Raises:
            ExpertError: `reset` has not been called since the expert was made or since the environment was reset.
        """
        self._check_begun("act()")
        if self._world.source.data is not self._data or self._time < self._now:
            raise ExpertError("the environment was reset after the expert; call TampExpert.reset() again")
        self._now = self._time
        command, executor = self._actor.command(), self._actor.executor
        self._recorder.add_frame(*(() if executor is None else (executor.action, executor.phase)))
        self._actor.decide()
        return self._actions.of(command)

    @property
    def done(self) -> bool:
        """Whether the expert has finished or given up."""
        self._check_begun("done")
        return self._actor.is_idle

    @property
    def report(self) -> EpisodeReport:
        """Report of the episode so far."""
        self._check_begun("report")
        report, executor = self._report, self._actor.executor
        if not self._actor.is_idle:
            report = report.with_clearances([] if executor is None else executor.cleared)
            report = replace(report, sim_s=self._time - self._started)
            is_reached, unknown = self._world.reaches(self._goal, self._start_scene)
            if is_reached:
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
        """Name of the object to retrieve, "" for other goals."""
        self._check_begun("target")
        return self._goal.target

    @property
    def goal(self) -> Goal:
        """Goal of the episode."""
        self._check_begun("goal")
        return self._goal

    @property
    def phase(self) -> str:
        """Action and phase of the motion, for example "PickUp object_03: lift". "" while the robot waits."""
        self._check_begun("phase")
        return self._actor.phase

    @property
    def action(self) -> int:
        """Index of the plan's present action. -1 while the robot waits."""
        self._check_begun("action")
        return -1 if self._actor.executor is None else self._actor.executor.action

    @property
    def step_label(self) -> StepLabel:
        """Label of the last action: phase, grasp or release, and the keyframe at the end of the phase."""
        self._check_begun("step_label")
        last, executor = self._actor.last, self._actor.executor
        waiting = StepLabel("", None, np.append(last.drive, self._env.robot.finger_position(last.opening)))
        return (executor and executor.label) or waiting

    @property
    def solution(self) -> Solution | Infeasible | None:
        """Result of the last solve. None before `reset`, or if the scene was not valid for planning."""
        return self._solution

    @property
    def recording(self) -> Recording:
        """States, plans and deviations of the episode so far."""
        self._check_begun("recording")
        return self._recorder.recording()

    def to_html(self, path: str | Path, rows: Mapping[str, str] | None = None, result: str = "") -> None:
        """Write the episode so far as one HTML page that needs no network, with its motions on a time line.

        The page also has the actions, negative goal regions and candidates of each clearance, and base poses of the
        reachability map. Planned gripper paths, plans after deviations and the report follow.

        Args:
            path: path of the file.
            rows: names and values of the report on the page. Default: those of `report`.
            result: "success" or "failure". Default: that of `report`.

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
        """Serve the running episode to browsers of this machine. See `LivePage` for updates.

        Raises:
            OSError: the port is taken.
        """
        from planners.drawing.page.live import LivePage

        return LivePage(self.recording, port)

    def _check_begun(self, call: str) -> None:
        if not self._has_begun:
            raise ExpertError(f"call TampExpert.reset() before {call}")

    @property
    def _time(self) -> float:
        """Time [s] in the simulation."""
        return float(self._env.data.time)

    def _goal_of_env(self) -> Any:
        """The environment's own goal: `planning_goal`, `goal`, or its target to hold."""
        env = self._env
        try:
            named = [name for name in ("planning_goal", "goal") if hasattr(type(env), name)]
            return getattr(env, named[0]) if named else holding(env.target)
        except ValueError as error:
            raise ExpertError(f"reset the environment before the expert: {error}") from error

    def _bounded(self, scene: Scene) -> EpisodeReport:
        """An empty report, with the minimum number of clearances if wanted."""
        if not (self._config.with_floor and self._goal.target):
            return EpisodeReport()
        before, planner = time.process_time(), self._planner
        bounding = planner if isinstance(planner, Planner) else Planner(scene.robot)
        if scene.openings:
            bound = bounding.lower_bound(scene, self._goal)
            count = bound.least - 1 if bound.picks == bound.least else None
        else:
            floor = bounding.clearance_floor(scene, self._goal.target)
            count = floor.count if floor.proved else None
        return EpisodeReport(floor=count, planning_s=time.process_time() - before)

    # The phases of an episode. Each returns the next steps of the actor: none at the end.

    def _plan(self, read: Scene | None = None) -> Steps:
        """Solve the present scene, or a given one, and execute the plan."""
        before = time.process_time()
        try:
            scene = read or self._world.scene()
            outcome = self._solved(scene)
        except (SceneError, GoalError) as error:
            return self._end(f"the scene is not valid for planning: {error}")
        self._solution = outcome
        grasps = find_grasp_set(self._planner.grasps) if isinstance(self._planner, Planner) else ()
        self._recorder.add_solve(outcome, scene, getattr(outcome, "grasps", ()) or grasps)
        self._report = self._report.with_solve(outcome, time.process_time() - before)
        if isinstance(outcome, Infeasible):
            return self._end(f"{outcome.cause}: {outcome.detail}")
        return self._execute(outcome.actions) if outcome.actions else self._hold()

    def _execute(self, actions: tuple[BoundAction, ...]) -> Steps:
        """Follow a plan, and watch how it ends."""
        env = self._env
        executor = Executor(
            actions,
            env.robot,
            self._sensors[actions[0].scene.robot.arm_name],
            self._tolerances,
            by_tcp=env.control_mode == "ee" or getattr(env, "waits_for_tcp", False),
            at_start=AT_START if self._report.replans else 0,
            dt=self._dt,
            latency=getattr(env, "latency", 0),
            line_tolerance=getattr(env, "line_tolerance", ON_THE_WAY),
        )
        return [Follow(executor, lambda arm: self._sensors[arm].read()), partial(self._watch, executor)]

    def _watch(self, executor: Executor) -> Steps:
        """Hold the target up after a plan. After a deviation, let everything settle and check again."""
        self._report = self._report.with_clearances(executor.cleared)
        if executor.deviation is None:
            return self._hold()
        deviation = str(executor.deviation)
        self._note(deviation)
        if executor.stop is not None:
            self._world.opened_in_part(*executor.stop)
        failure = f"gave up after {self._report.replans} replans; last deviation: {deviation}"
        return self._replan(failure, Wait(self._steps(self._config.settle_s)), self._check)

    def _hold(self) -> Steps:
        """Hold the target up at the end of the plan."""
        self._report = replace(self._report, executed=True)
        return [Wait(self._steps(self._config.hold_s)), self._check]

    def _check(self) -> Steps:
        """End the episode if the goal is reached or cannot be measured. Otherwise plan again from the present scene."""
        is_reached, unknown = self._world.reaches(self._goal, self._start_scene)
        failure = unknown or ("" if is_reached else self._world.stops_short_of(self._goal))
        if is_reached or failure:
            self._report = replace(self._report, scored=is_reached)
            return self._end(failure)
        if not self._report.executed:
            return self._plan()
        self._report = replace(self._report, executed=False)
        self._note("target not held" if self._goal.target else "goal not reached")
        end = "the target was not held" if self._goal.target else "the goal was not reached"
        return self._replan(f"{end} at the end of the plan", self._plan)

    def _replan(self, failure: str, *steps: Step) -> Steps:
        """Steps to another plan, which is counted, or the end with a failure after too many plans."""
        if self._report.replans >= self._config.replans:
            return self._end(failure)
        self._report = replace(self._report, replans=self._report.replans + 1)
        return steps

    def _end(self, failure: str) -> Steps:
        self._report = replace(self._report, failure=failure, sim_s=self._time - self._started)
        return []

    # Helpers of the phases.

    def _solved(self, scene: Scene) -> Solution | Infeasible:
        """Plan for a scene. If this fails with a lying object, plan again with all grasps: few grasp sets fit it.

        Raises:
            SceneError, GoalError: the scene is not valid for planning.
            ExpertError: the planner returns something else.
        """
        planner, start = self._planner, self._start_scene
        given = scene, self._goal.target or self._goal, self._strategy, self._rng, self._config.planning_s
        outcome = planner.solve(*given, *[start] * isinstance(planner, Planner))
        lies = any(not body.is_upright for body in scene.objects)
        is_limited = isinstance(planner, Planner) and planner.grasps != "all"
        if isinstance(outcome, Infeasible) and self._report.replans and lies and is_limited:
            self._note(f"{outcome.cause}: {outcome.detail}; planned with all grasps")
            wider = replace(planner, grasps="all", supports=planner.supports or (scene.support.name,))
            outcome = wider.solve(*given, start)
        if not isinstance(outcome, Solution | Infeasible):
            raise ExpertError(f"the planner returned {outcome!r:.100}; it must return a Solution or an Infeasible")
        return outcome

    def _steps(self, seconds: float) -> int:
        """Number of steps in a time [s], at least one, so that the simulation advances before the next check."""
        return max(round(seconds / self._dt), 1)

    def _note(self, deviation: str) -> None:
        self._report = replace(self._report, deviations=(*self._report.deviations, deviation))
        self._recorder.add_note(deviation)
