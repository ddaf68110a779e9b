"""The search expert: look, and until the target is in sight, look from elsewhere or move the objects that hide most.

look -> target seen? -> take it
  ^      | no: another view, or an object put where it hides nothing: the one that reveals more per second
  +------+ every place seen: it cannot be found
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.expert.actor import AT_START, Actor, Follow, Steps, Straight, Wait, home_of
from planners.expert.config import ExpertError, MonitorConfig
from planners.expert.executor import Command, Executor
from planners.expert.monitor import Snapshot
from planners.goals import Goal, Region, inside
from planners.motion.trajectory import CONTROL_STEP
from planners.planner import Planner
from planners.search.decisions import ORDERS, Decisions, Places
from planners.search.knowledge import Knowledge
from planners.search.options import Disclosure, Viewpoint
from planners.search.own_shadow import OwnShadow
from planners.search.report import SearchReport, SearchStep
from planners.search.sensing import BelievedSensor
from planners.search.sight import load_kernels
from planners.tamp.solution import BoundAction, Infeasible, Solution

Array = NDArray[np.float64]

_TRIED = 5
"""Objects to try plans for before another view, or the end, is considered."""
_MOST_STEPS = 40
"""Most views and moves of one search."""
_RETRIES = 3
"""Plans for one move, or for taking the target, after deviations."""
_SETTLE = 10
"""Control steps at rest before an image is used, so that a slow camera shows the present, too."""
_AIMED, _AIM_STEPS = 0.04, 40
"""Accuracy [rad] of aiming the camera at a point, and control steps after which the image is taken anyway."""
_AT_HOME = 0.02
"""Distance [m], [rad] from home within which torso and arm need not go home."""
_HOLD = 20
"""Control steps of holding up the target."""
_UNSURE = 0.007
"""Standard deviation [m] of an object's place from which on it needs another look before it is taken. It is larger with
noise. In 24 first views, 90% of the errors were below 1.3 mm for deviations below 6 mm. For deviations above 7 mm, 90%
were below 18 mm."""
_UNNAMED = "furniture, gaps between pixels, or what is too wide to count as an object"
_TOLERANCES = MonitorConfig(slip=0.03)
"""Tolerances of the monitor. The place of an object between the fingers is only known by their opening."""


class SearchedEnv(Protocol):
    """Interface of an environment for the search expert, in addition to observations.

    Attributes:
        robot: the robot.
        workplace: a model of robot and furniture without objects.
        support_name: name of the geom that objects stand on.
        control_mode: "joint".
    """

    robot: RobotSpec
    workplace: mujoco.MjModel
    support_name: str
    control_mode: str

    def joint_action(self, q_target: Array, gripper_width: float, head_target: Array | None = None) -> Array:
        """Action that moves the robot to a whole-body configuration, and its head to pan and tilt."""
        ...


@dataclass(frozen=True, eq=False)
class _Options:
    """Options to reveal the target, or to free the path to it.

    `target` is its name, "" out of sight. An `opening` reveals more than all other options.
    """

    target: str
    places: Places
    view: Viewpoint | None
    names: list[str]
    opening: Disclosure | None = None


class SearchExpert:
    """A policy for `clutter_env/Search-…` that finds and takes a target by camera data alone.

    It knows the robot, the furniture, and a description of the target. It knows objects only as far as it has seen
    them.

    Example:
        env = gymnasium.make("clutter_env/Search-o10-v0")
        observation, info = env.reset(seed=0)
        expert = SearchExpert(env)
        expert.reset(observation)
        while not expert.done:
            observation, _, terminated, truncated, info = env.step(expert.act(observation))
            if terminated or truncated:
                break
        print("taken" if info["is_success"] else expert.report.failure)
    """

    def __init__(
        self, env: Any, order: str = "expected", *, planner: Planner | None = None, seed: int = 0, noise: float = 0.0
    ) -> None:
        """Make an expert. Call `reset` to begin an episode.

        Args:
            env: an environment with the `SearchedEnv` protocol, wrapped or not.
            order: order of the moved objects. "expected" weighs views and objects by the probability that they reveal
                per second. The baselines "random", "front" (nearest first) and "shadow" (most hidden first) use no
                further views.
            planner: planner for moved objects and the target. Default: a planner for the robot.
            seed: seed of the planner's sampling, and of the random order.
            noise: noise [m] of the camera's depth, as far as it is known.

        Raises:
            ExpertError: the order, the noise or the environment cannot be used.
        """
        inner = getattr(env, "unwrapped", env)
        missing = [name for name in (*SearchedEnv.__annotations__, "joint_action") if not hasattr(inner, name)]
        if missing or inner.control_mode != "joint" or inner.robot.base_drive == "differential":
            what = f"it lacks {', '.join(missing)}" if missing else "control_mode must be 'joint', and base 'holonomic'"
            raise ExpertError(f"{type(inner).__name__} cannot be searched, {what}; use clutter_env/Search-o{{N}}-v0")
        if order not in ORDERS:
            raise ExpertError(f"order={order!r} is not valid; valid values: {', '.join(ORDERS)}")
        if not 0.0 <= noise < math.inf:
            raise ExpertError(f"noise={noise!r} is not valid; it must be a number from 0 on [m]")
        self._env: SearchedEnv = inner
        self._order, self._seed, self._noise = order, seed, noise
        self._planner = planner or Planner(inner.robot)
        self._actor: Actor | None = None

    def reset(self, observation: Mapping[str, Any]) -> None:
        """Begin an episode with its first observation.

        Raises:
            ExpertError: no camera of the observation is on the robot.
        """
        self._planner.warmup()
        load_kernels()
        env, robot = self._env, self._env.robot
        known = self._knowledge = Knowledge(robot, env.workplace, env.support_name, self._noise, observation)
        camera = known.cameras[0]
        K, size = observation[f"{camera}_K"], observation[f"{camera}_depth"].shape[:2]
        shadow = OwnShadow(env.workplace, robot, camera, K, size)
        self._decisions = Decisions(known, shadow, self._planner, self._order, np.random.default_rng(self._seed))
        self.report = SearchReport()
        self._ticks, self._steps_left, self._is_in_sight = 0, _MOST_STEPS, False
        self._moved_before = 0
        last = Command(known.reading.drive.copy(), known.reading.width)
        self._actor = Actor(last, partial(self._look, list(known.empty.supports)), self._decide)

    def act(self, observation: Mapping[str, Any]) -> Array:
        """Return the next action after an observation.

        Raises:
            ExpertError: `reset` has not been called.
        """
        if self._actor is None:
            raise ExpertError("call SearchExpert.reset(observation) before act()")
        self._knowledge.observe(observation)
        self._ticks += 1
        self._actor.decide()
        if self._actor.is_idle:
            return self._env.joint_action(self._knowledge.reading.drive, self._actor.last.opening)
        command = self._actor.command()
        if (executor := self._actor.executor) is not None:
            # Update at once: the episode may end before the plan does.
            self.report.moves[self._moved_before :] = executor.cleared
        return self._env.joint_action(command.drive, command.opening, command.head)

    @property
    def done(self) -> bool:
        """Whether the search has ended."""
        return self._actor is not None and self._actor.is_idle

    @property
    def phase(self) -> str:
        """Action and phase of a plan's motion, for example "PickUp seen_03: lift". "" otherwise."""
        return "" if self._actor is None else self._actor.phase

    # The phases of a search. Each returns the next steps of the actor: none at the end.

    def _decide(self) -> Steps:
        """Take the target if it is in sight, else reveal it."""
        if not self._steps_left:
            return self._end("gave up: too many steps")
        self._steps_left -= 1
        target, was_in_sight = self._knowledge.seen_target(), self._is_in_sight
        self._is_in_sight = target is not None
        if target is not None:
            self.report.found = True
            return self._take(target.name)
        if was_in_sight:
            self._knowledge.belief.restart()
        return self._reveal()

    def _reveal(self, target: str = "") -> Steps:
        """Weigh views and objects that could reveal the target, or free the path to a visible one."""
        started = time.process_time()
        places = self._knowledge.places()
        if not target and not any(cells.any() for cells in places.values()):
            return self._end("lost after it was seen" if self.report.found else "cannot be found")
        options = _Options(target, places, *self._decisions.ranked(places, target))
        self.report.decision_s.append(time.process_time() - started)
        if options.opening is not None:
            return [self._go_home, partial(self._open, options.opening, options)]
        view, names = options.view, options.names
        return self._plan_aside(options, names[:_TRIED], names[_TRIED:] if view is None else [])

    def _plan_aside(self, options: _Options, names: Sequence[str], others: Sequence[str] = ()) -> Steps:
        """Put aside the first object with a plan, from home. Try others after these."""
        if not names:
            return self._look_elsewhere(options)

        def put_aside() -> Steps:
            started = time.process_time()
            move = self._decisions.plan_aside(names, options.places)
            self.report.decision_s[-1] += time.process_time() - started
            if move is None:
                return self._plan_aside(options, others)
            name, actions = move
            self._note("place", f"put {name} aside", options.places)
            region = actions[0].scene.regions[0]
            return [*self._put_aside(name, actions, region), *self._look_on(options)]

        return [self._go_home, put_aside]

    def _open(self, opening: Disclosure, options: _Options) -> Steps:
        """Open what hides the target, from home, and look. If this fails, weigh the other options."""
        started = time.process_time()
        found = self._decisions.plan_opening(opening, options.places)
        self.report.decision_s[-1] += time.process_time() - started
        if found is None:
            return self._reveal()
        verb, name, actions = found
        self._note("open", f"{verb} {name}", options.places)
        return self._execute(actions, lambda is_done: [*([] if is_done else [self._recover]), *self._look_on(options)])

    def _look_elsewhere(self, options: _Options) -> Steps:
        """Take another view if no object is to be moved, or end the search."""
        if (view := options.view) is not None:
            text = f"another view, which should show {view.gain:.0%} of the places left"
            self._note("drive", text, options.places)
            return [*self._go(view), *self._look_on(options)]
        if options.target:
            why = self.report.deviations[-1] if self.report.deviations else "it does not stay between the fingers"
            return self._end(f"the target cannot be taken: {why}")
        left = [f"{cells.sum()} on {name}" for name, cells in options.places.items() if cells.any()]
        names = [*options.names, *self._decisions.unopened]
        fixed = [f"{name} ({self._decisions.refusals[name]})" for name in names] or [_UNNAMED]
        return self._end(f"not found where it can be seen; {', '.join(left)} places stay hidden by {', '.join(fixed)}")

    def _look_on(self, options: _Options) -> Steps:
        return [partial(self._look, [name for name, cells in options.places.items() if cells.any()]), self._decide]

    def _take(self, name: str, plans: int = 2 * _RETRIES, looks: int = _RETRIES) -> Steps:
        """Take the target, from home, with limits on the plans and on the looks at the path to it."""
        if not self._knowledge.is_target(name):
            return [self._decide]
        return [self._go_home, partial(self._plan_taking, name, plans, looks)] if plans else self._reveal(name)

    def _plan_taking(self, name: str, plans: int, looks: int) -> Steps:
        """Look at unseen places in the arm's path, else take the target."""
        started = time.process_time()
        outcome = self._decisions.solved(self._knowledge.scene(), Goal.of(name))
        self.report.decision_s.append(time.process_time() - started)
        if isinstance(outcome, Infeasible):
            self.report.deviations.append(f"{outcome.cause}: {outcome.detail}")
            return self._reveal(name)
        look = partial(self._look, [self._knowledge.empty.support.name])
        view = self._decisions.view_of_unseen(outcome.actions, name) if looks else None
        if view is not None:
            self._note("drive", "look at what is on the way to the target", self._knowledge.places())
            return [*self._go(view), look, partial(self._take, name, plans - 1, looks - 1)]
        self._note("pick", f"take {name}", self._knowledge.places())
        replan: Steps = [self._recover, look, partial(self._take, name, plans - 1, looks)]
        hold: Steps = [Wait(_HOLD), partial(self._check, name, replan)]
        return self._execute(outcome.actions, lambda is_done: hold if is_done else replan)

    def _check(self, name: str, replan: Steps) -> Steps:
        """End the search if the target is held up."""
        if not self._holds(name) or not self._knowledge.reading.is_gripping:
            return replan
        self.report.taken, self.report.failure = True, ""
        return []

    def _put_aside(self, name: str, actions: tuple[BoundAction, ...], region: Region, plans: int = _RETRIES) -> Steps:
        """Follow a plan. After deviations, plan again from the believed poses, with a limit on the plans."""

        def watch(is_done: bool) -> Steps:
            if is_done:
                return []
            if plans > 1 and self._holds(name):
                scene = replace(self._knowledge.scene(), regions=(region,))
                outcome = self._decisions.solved(scene, inside(name, region.name))
                if isinstance(outcome, Solution):
                    return self._put_aside(name, outcome.actions, region, plans - 1)
            return [self._recover]

        return self._execute(actions, watch)

    def _recover(self) -> Steps:
        """Recover after a deviation: put down a held object if the planner finds a place, and bring the arm home."""
        if (held := self._knowledge.held) is not None:
            outcome = self._decisions.solved(
                self._knowledge.scene(), inside(held.name, self._knowledge.empty.support.name)
            )
            if isinstance(outcome, Solution):
                return self._execute(outcome.actions, lambda _: [self._go_home])
        return self._go_home()

    def _execute(self, actions: tuple[BoundAction, ...], then: Callable[[bool], Steps]) -> Steps:
        """Follow a plan, then take the steps for its end, or for a deviation before it."""
        if not actions:
            return then(True)
        known, robot = self._knowledge, self._env.robot
        self.report.openings += [one.target for one in actions if one.name in ("Open", "Close")]
        pull = actions[0].scene.pull
        bodies = tuple(one for one in actions[0].scene.objects if pull is None or one.name != pull.handle)
        sensor = BelievedSensor(bodies, known.reading, robot, known.held, known.empty)
        # The first object has just been looked at. Objects behind it come into sight once it leaves.
        picks = [action.target for action in actions if action.name == "PickUp"][:1]
        unsure = {one.name for one in known.objects if one.sigma > _UNSURE + self._noise} - set(picks)
        executor = Executor(actions, robot, sensor, _TOLERANCES, at_start=AT_START, unsure=unsure)  # type: ignore[arg-type]  # its members names and read are used
        head = np.array(robot.head_configuration) if len(known.reading.head) else None

        def read(_arm: str) -> Snapshot:
            sensor.update(known.reading)
            return sensor.read()

        return [Follow(executor, read, head), partial(self._watch, executor, sensor, then)]

    def _watch(self, executor: Executor, sensor: BelievedSensor, then: Callable[[bool], Steps]) -> Steps:
        """Update the believed poses after a plan or a deviation."""
        self._moved_before = len(self.report.moves)
        self._knowledge.settle(sensor)
        self._decisions.start_over()
        if executor.deviation is not None:
            self.report.deviations.append(str(executor.deviation))
        if executor.stop is not None:
            self._knowledge.opened_in_part(*executor.stop)
        return then(executor.deviation is None)

    def _look(self, names: Sequence[str]) -> Steps:
        """Look at supports, or at all visible ones if none of those named is visible, with the arm out of sight."""
        known, points = self._knowledge, list[Array]()
        places = known.places()
        supports = [one for one in known.shown if one.name in names] or known.shown
        for support in sorted(supports, key=lambda one: float(one.position[1])):
            left = known.belief.grid(support.name).centres()[places[support.name]]
            middle = left.mean(axis=0) if len(left) else support.position[:2]
            points.append(np.append(middle, support.top + known.target.height / 2))

        def perceive() -> Steps:
            self.report.belief_s.append(known.look())
            return []

        def count() -> Steps:
            self._decisions.count_look()
            return []

        aside = self._decisions.arm_aside(points)
        looks: Steps = [step for point in points for step in (partial(self._aim, point), perceive)]
        return [*(() if aside is known.reading.drive else self._move_to(aside)), *looks, count]

    def _aim(self, point: Array, left: int = _AIM_STEPS) -> Steps:
        """Turn the head until the first camera looks at a point (3,) [m], and wait until the image is still."""
        known, rest = self._knowledge, Wait(_SETTLE)
        if not left or not len(known.reading.head):
            return [rest]
        T_world_camera = known.reading.T_world_base @ known.observation[f"{known.cameras[0]}_T_base_camera"]
        x, y, z, _ = np.linalg.inv(T_world_camera) @ np.append(point, 1.0)
        errors = np.array((-math.atan2(x, z), math.atan2(y, math.hypot(x, z))))
        if np.abs(errors).max() < _AIMED:
            return [rest]
        return [Wait(1, head=known.reading.head + 0.5 * errors), partial(self._aim, point, left - 1)]

    def _go(self, view: Viewpoint) -> Steps:
        """Drive to a viewpoint in a straight line with the arm aside, if collision-free."""
        self.report.views += 1
        return self._move_to(self._decisions.drive_to(view))

    def _go_home(self) -> Steps:
        """Bring torso and arm home, where plans begin."""
        drive = self._knowledge.reading.drive
        home = home_of(self._env.robot, drive[3:])
        return [] if np.allclose(drive[3:], home, atol=_AT_HOME) else self._move_to(np.append(drive[:3], home))

    def _move_to(self, goal: Array) -> Steps:
        """Move all joints together to a whole-body configuration, if collision-free as far as known, and come to
        rest."""
        if not self._decisions.is_free(goal):
            return []
        return [Straight(self._knowledge.reading.drive.copy(), goal, self._decisions.seconds(goal)), Wait(_SETTLE)]

    # Helpers of the phases.

    def _holds(self, name: str) -> bool:
        return self._knowledge.held is not None and self._knowledge.held.name == name

    def _note(self, kind: str, text: str, places: Places) -> None:
        known = self._knowledge
        grids = {name: known.belief.grid(name) for name in places}
        self.report.steps.append(
            SearchStep(self._ticks * CONTROL_STEP, kind, text, places, grids, known.objects, known.eye)
        )

    def _end(self, failure: str) -> Steps:
        self.report.failure = failure
        self._note("end", failure, self._knowledge.places())
        return []
