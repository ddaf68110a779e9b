"""The search expert: look, and as long as the target is not in sight, look from elsewhere or move what hides most.

look -> target seen? -> take it
  ^      | no: another view, or an object put where it hides nothing: what reveals more per second
  +------+ every place seen: it cannot be found
"""

from __future__ import annotations

import math
import time
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.collision.world import CollisionWorld, overlaps, validate
from planners.expert.config import ExpertError, MonitorConfig
from planners.expert.executor import Executor
from planners.goals import Goal, inside
from planners.motion.base import unwrap_yaw
from planners.motion.trajectory import CONTROL_STEP
from planners.placing.negative_goal_region import SupportGrid
from planners.planner import Planner
from planners.scene import Body, HeldObject, RobotState, Scene, SceneError
from planners.scene.masks import MAX_OBJECTS
from planners.search.belief import Belief
from planners.search.options import Prospect, Viewpoint, spots, viewpoints
from planners.search.own_shadow import OwnShadow, arms_near
from planners.search.perception import Description, Seen, View, perceive
from planners.search.sensing import BelievedSensor, RobotReading
from planners.search.sight import load_kernels
from planners.strategies import STRATEGIES
from planners.tamp.solution import BoundAction, Infeasible, Solution

Array = NDArray[np.float64]
Actions = Generator[Array, None, Any]
"""Yields actions; after each, the next observation has arrived."""

ORDERS = ("expected", "random", "front", "shadow")
"""Ways to choose what is moved: by probability revealed per second, beside views; and three baselines without views."""
_MOVE_SECONDS = 35.0
"""[s] that moving an object takes, about."""
_LOOK_SECONDS = 2.5
"""[s] that looking takes, about."""
_LEAST_GAIN = 0.02
"""Probability that a view must reveal."""
_NEW_EYE = 0.06
"""[m] from where the camera was on which a view counts as another one."""
_MISSES = 2
"""Times that a place in line of sight is not seen, for example because it is narrower than a pixel, until views do not
count it any more."""
_ASIDE = replace(STRATEGIES["lookahead"], tries=30, attempts=1)
"""How what is put aside is planned: quickly, since another spot or another object will do."""
_TRIED = 5
"""Objects for which a plan is tried before another view, or the end, is considered."""
_MOST_STEPS = 40
"""Views and moves of one search at most."""
_RETRIES = 3
"""Plans for one move, or for taking the target, after deviations."""
_SETTLE = 10
"""Control steps at rest before an image counts: those of a slow camera, too, show the present by then."""
_AIMED, _AIM_STEPS = 0.04, 40
"""[rad] to which the camera is aimed at a point; control steps after which it is looked anyway."""
_HIDES = 0.05
"""Share of an image that the robot itself may hide."""
_SPEED = 0.6
"""Share of the largest joint velocities and accelerations between viewpoints."""
_EVERY = 4
"""Samples of a planned motion from one that is looked at to the next."""
_HOLD = 20
"""Control steps for which the target is held up."""
_GONE = 0.6
"""Share of an object's cells that must be seen to be empty until it counts as gone."""
_LURKING = 0.02
"""[m] radius of an object that may stand, unseen, where the arm would pass."""
_UNSURE = 0.007
"""[m] standard deviation of an object's place from which on it is looked at again before it is taken; more with noise.
In 24 first views 90% of the errors were below 1.3 mm where it was less than 6 mm, below 18 mm where more than 7."""
_UNNAMED = "furniture, gaps between pixels, or what is too wide to count as an object"
_TOLERANCES = MonitorConfig(slip=0.03)
"""Where an object is between the fingers is seen by their opening alone."""
_SHRINK = (0.0, 0.001, 0.002, 0.004, 0.008)
"""[m] by which perceived objects are made narrower until they do not overlap."""


class SearchedEnv(Protocol):
    """All that the search expert uses of an environment beside observations.

    Attributes:
        robot: which robot it is.
        workplace: a model of robot and furniture, without any object.
        support_name: of the geom on whose top face objects stand.
        control_mode: "joint".
    """

    robot: RobotSpec
    workplace: mujoco.MjModel
    support_name: str
    control_mode: str

    def joint_action(self, q_target: Array, gripper_width: float, head_target: Array | None = None) -> Array:
        """The action that moves the robot to a whole-body configuration, and its head to pan and tilt."""
        ...


@dataclass(frozen=True, eq=False)
class SearchStep:
    """One decision of a search: when [s], its kind, what in words, and the belief that it was made with.

    `kind` is "drive" for a view, "place" for an object put aside, "pick" for the target taken, "end". `places` are the
    cells at which the target can be, by support, of `grids`; `known` the objects, `eye` (3,) the camera.
    """

    time: float
    kind: str
    text: str
    places: Mapping[str, NDArray[np.bool_]]
    grids: Mapping[str, SupportGrid]
    known: tuple[Seen, ...]
    eye: Array


@dataclass
class SearchReport:
    """How a search went.

    Attributes:
        found: the target has been seen.
        taken: it has been taken and is still between the fingers.
        failure: why the search ended without, "" for success; "cannot be found" if every place has been seen and the
            target in none of them. Otherwise it says how many places stay hidden, and by what.
        moves: names of the objects moved, in order, as the expert calls them.
        views: viewpoints looked from.
        deviations: that stopped motions, as text.
        belief_s, decision_s: [s] CPU time of each belief update, of each decision with its plan.
        steps: decisions, in order.
    """

    found: bool = False
    taken: bool = False
    failure: str = "unfinished"
    moves: list[str] = field(default_factory=list)
    views: int = 0
    deviations: list[str] = field(default_factory=list)
    belief_s: list[float] = field(default_factory=list)
    decision_s: list[float] = field(default_factory=list)
    steps: list[SearchStep] = field(default_factory=list)


class SearchExpert:
    """A policy for `clutter_env/Search-…` that finds and takes a target by camera data alone.

    It knows the robot, the furniture, and what the target is like; of objects it knows what it has seen.

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
        """Make an expert; call `reset` to begin an episode.

        Args:
            env: wrapped or not, with the `SearchedEnv` protocol.
            order: "expected" weighs views and objects by the probability that they reveal per second. "random",
                "front" (the nearest first) and "shadow" (what hides most first) are baselines that look from where
                the robot stands.
            planner: plans what is moved and taken; one for the robot if not given.
            seed: of the planner's sampling, and of the random order.
            noise: [m] of the camera's depth, as far as it is known.

        Raises:
            ExpertError: an order, a noise or an environment that cannot be used.
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
        self._run: Actions | None = None

    def reset(self, observation: Mapping[str, Any]) -> None:
        """Begin an episode with its first observation.

        Raises:
            ExpertError: no camera of the observation is on the robot.
        """
        self._rng = np.random.default_rng(self._seed)
        self._planner.warmup()
        load_kernels()
        model, data = self._env.workplace, mujoco.MjData(self._env.workplace)
        mujoco.mj_forward(model, data)
        self._empty = Scene.from_mujoco(model, data, self._env.robot, movable=(), support=self._env.support_name)
        self._supports = [self._empty.support_named(name) for name in self._empty.supports]
        own = self._env.robot.cameras  # the first of them, which is aimed, is the head's where there is one
        shown = [name.removesuffix("_depth") for name in sorted(observation) if name.endswith("_depth")]
        self._cameras = [name for name in own if name in shown] + [name for name in shown if name not in own]
        if not set(own) & set(shown):
            raise ExpertError(f"cameras={tuple(shown)!r} do not move with the robot; it has {', '.join(own)}")
        self._target = Description.of(observation["target"])
        self._belief = Belief.begin(self._empty, self._target)
        self._known: tuple[Seen, ...] = ()
        self._held: HeldObject | None = None
        self._attempted: list[str] = []
        self._refusals: dict[str, str] = {}  # why an object cannot be put aside
        self._ticks, self._done = 0, False
        self._executor: Executor | None = None
        self._observation = observation
        self._reading = RobotReading.of(observation)
        camera, K = self._cameras[0], observation[f"{self._cameras[0]}_K"]
        self._shadow = OwnShadow(model, self._env.robot, camera, K, observation[f"{camera}_depth"].shape[:2])
        self._last, self._width = self._reading.drive.copy(), self._reading.width  # as last commanded
        self._home = np.array(self._env.robot.home)
        self._aside = self._home.copy()
        self._start_over()
        self.report = SearchReport()
        self._run = self._search()

    def act(self, observation: Mapping[str, Any]) -> Array:
        """The next action after an observation.

        Raises:
            ExpertError: `reset` has not been called.
        """
        if self._run is None:
            raise ExpertError("call SearchExpert.reset(observation) before act()")
        self._observation = observation
        self._reading = RobotReading.of(observation, self._reading.drive[2])
        self._ticks += 1
        action = None if self._done else next(self._run, None)
        if action is None:
            self._done = True
            return self._env.joint_action(self._reading.drive, self._width)
        return action

    @property
    def done(self) -> bool:
        """Whether the search has ended."""
        return self._run is not None and self._done

    @property
    def phase(self) -> str:
        """Action and phase of the motion that follows a plan, for example "PickUp seen_03: lift"; "" otherwise."""
        return "" if self._executor is None else self._executor.phase

    # The search, as a story; each part yields actions.

    def _search(self) -> Actions:
        yield from self._look(list(self._empty.supports))
        is_in_sight = False
        for _ in range(_MOST_STEPS):
            target = self._seen_target()
            if target is None and is_in_sight:
                self._belief.restart()
            is_in_sight = target is not None
            if target is not None:
                self.report.found = True
                if (yield from self._take(target.name)):
                    self.report.failure, self._done = "", True
                    return
                if not self._is_target(target.name):
                    continue
            started = time.process_time()
            places = self._places()
            if target is None and not any(cells.any() for cells in places.values()):
                return self._end("lost after it was seen" if self.report.found else "cannot be found")
            view, names = self._ranked(places, target)
            seconds = time.process_time() - started
            move: tuple[str, tuple[BoundAction, ...]] | None = None
            for some in (names[:_TRIED], names[_TRIED:] if view is None else []):
                if some and move is None:
                    yield from self._go_home()
                    started = time.process_time()
                    move = self._move(some, places)
                    seconds += time.process_time() - started
            self.report.decision_s.append(seconds)
            if move is not None:
                name, actions = move
                self._note("place", f"put {name} aside", places)
                self._attempted.append(name)
                yield from self._put_aside(name, actions)
            elif view is not None:
                self._note("drive", f"another view, which should show {view.gain:.0%} of the places left", places)
                yield from self._go(view)
            elif target is not None:
                why = self.report.deviations[-1] if self.report.deviations else "it does not stay between the fingers"
                return self._end(f"the target cannot be taken: {why}")
            else:
                left = [f"{cells.sum()} on {name}" for name, cells in places.items() if cells.any()]
                fixed = [f"{name} ({self._refusals[name]})" for name in names] or [_UNNAMED]
                return self._end(
                    f"not found where it can be seen; {', '.join(left)} places stay hidden by {', '.join(fixed)}"
                )
            yield from self._look([name for name, cells in places.items() if cells.any()])
        self._end("gave up: too many steps")

    def _ranked(
        self, places: Mapping[str, NDArray[np.bool_]], target: Seen | None
    ) -> tuple[Viewpoint | None, list[str]]:
        """The view that reveals most per second, and what should rather be moved, the first to be tried first."""
        scene = self._scene()
        prospect, world = Prospect(self._belief, places, scene), CollisionWorld.from_scene(scene)
        names, worth = self._ranked_objects(prospect, self._viewpoints(scene, prospect), target)
        useful: list[Viewpoint] = []
        if self._order == "expected" and target is None:
            # Places that should have been seen, and were not, are not looked at again before something has moved.
            fresh = {name: cells & (self._missed[name] < _MISSES) for name, cells in places.items()}
            share = sum(cells.sum() for cells in fresh.values()) / sum(cells.sum() for cells in places.values())
            views = self._viewpoints(scene, Prospect(self._belief, fresh, scene), float(share))
            useful = [one for one in views if one.gain >= _LEAST_GAIN and self._is_new(one)]
        by_rate = sorted(useful, key=lambda one: -one.rate)
        best = next((one for one in by_rate if self._is_free(world, self._drive_to(one))), None)
        return best, names if best is None or best.rate < worth / _MOVE_SECONDS else []

    def _move(
        self, names: Sequence[str], places: Mapping[str, NDArray[np.bool_]]
    ) -> tuple[str, tuple[BoundAction, ...]] | None:
        """The first of some objects that can be put aside, and a plan for that; None if there is none."""
        scene = self._scene()
        prospect = Prospect(self._belief, places, scene)
        views = self._viewpoints(scene, prospect)
        eyes = [one.eye for one in views[:: max(len(views) // 6, 1)]]
        for name in names:
            self._refusals[name] = "no free spot for it has been seen"
            for region in spots(scene, scene.body(name), self._belief, prospect, eyes, self._rng):
                outcome = self._solved(replace(scene, regions=(region,)), inside(name, region.name))
                if isinstance(outcome, Solution) and outcome.actions:
                    return name, outcome.actions
                if isinstance(outcome, Infeasible):
                    self._refusals[name] = outcome.cause
                    if outcome.cause.lies_in_grasps:
                        break  # whatever the spot is
        return None

    def _ranked_objects(
        self, prospect: Prospect, views: Sequence[Viewpoint], target: Seen | None
    ) -> tuple[list[str], float]:
        """Names of objects, the first to be moved first, and what moving that one is worth."""
        names = [body.name for body in prospect.bodies if target is None or body.name != target.name]
        fresh = [name for name in names if name not in self._attempted]
        if self._order == "random":
            return list(self._rng.permutation(fresh)), 0.0
        if self._order == "front":
            x = {body.name: body.position[0] - body.half_extents[0] for body in prospect.bodies}
            return sorted(fresh, key=lambda name: x[name]), 0.0
        if self._order == "shadow":
            alone = {body.name: prospect.hidden_by(body, [self._eye()]) for body in prospect.bodies}
            return sorted(fresh, key=lambda name: -alone[name]), 0.0
        # From the viewpoints near to hand, the one from which most would be seen.
        best: dict[str, float] = dict.fromkeys(names, 0.0)
        for view in sorted(views, key=lambda one: one.seconds)[:12]:
            for name, share in prospect.shadows(view.eye).items():
                if name in best:
                    best[name] = max(best[name], share * _MOVE_SECONDS / (_MOVE_SECONDS + view.seconds))
        again = {name: 0.5 ** self._attempted.count(name) for name in names}
        order = sorted((name for name in names if best[name] > 0), key=lambda name: -best[name] * again[name])
        return order, best[order[0]] if order else 0.0

    def _take(self, name: str) -> Actions:
        """Take the target; whether it is held in the end."""
        looks = 0
        for _ in range(2 * _RETRIES):
            yield from self._go_home()
            started = time.process_time()
            outcome = self._solved(self._scene(), Goal.of(name))
            self.report.decision_s.append(time.process_time() - started)
            if isinstance(outcome, Infeasible):
                self.report.deviations.append(f"{outcome.cause}: {outcome.detail}")
                return False
            may_look = self._order == "expected" and looks < _RETRIES
            if may_look and (view := self._view_of_unseen(outcome.actions, name)) is not None:
                looks += 1
                self._note("drive", "look at what is on the way to the target", self._places())
                yield from self._go(view)
            else:
                self._note("pick", f"take {name}", self._places())
                if (yield from self._follow(outcome.actions)):
                    yield from self._wait(_HOLD)
                    if self._held is not None and self._held.name == name and self._reading.is_gripping:
                        self.report.taken = True
                        return True
                yield from self._recover()
            yield from self._look([self._empty.support.name])
            if not self._is_target(name):
                return False
        return False

    def _put_aside(self, name: str, actions: tuple[BoundAction, ...]) -> Actions:
        """Follow a plan; after a deviation plan again from where things are believed to be."""
        regions = actions[0].scene.regions
        for _ in range(_RETRIES):
            if (yield from self._follow(actions)):
                return
            if self._held is None or self._held.name != name:
                break
            outcome = self._solved(replace(self._scene(), regions=regions), inside(name, regions[0].name))
            if isinstance(outcome, Infeasible):
                break
            actions = outcome.actions
        yield from self._recover()

    def _view_of_unseen(self, actions: Sequence[BoundAction], name: str) -> Viewpoint | None:
        """The view that shows most of the unseen places that motions pass through; None if there is none."""
        scene, places = self._scene(), self._places()
        prospect = Prospect(self._belief, places, scene)
        feet, room = prospect.points[:, 0], MAX_OBJECTS - len(scene.objects)
        away = feet - scene.body(name).position
        # Something of the target's height is taken to stand at these places, those near the target first.
        chosen: list[int] = []
        for index in np.argsort(np.hypot(*away[:, :2].T), kind="stable"):
            if len(chosen) < room and all(math.dist(feet[index], feet[other]) > 2 * _LURKING for other in chosen):
                chosen.append(int(index))
        half = np.array((_LURKING, _LURKING, self._target.height / 2))
        unseen = [Body(f"unseen_{i}", "cylinder", half, feet[i], np.array((1.0, 0, 0, 0))) for i in chosen]
        world = CollisionWorld.from_scene(replace(scene, objects=(*scene.objects, *unseen), held=None))
        hit, known = 0, scene.mask(scene.names)
        for trajectory in (action.trajectory for action in actions):
            X = np.column_stack((trajectory.base, trajectory.q))[::_EVERY]
            hit |= world.path_hits(X, self._env.robot.max_opening, ignore=known)
        rows = [index for number, index in enumerate(chosen) if hit >> (len(scene.objects) + number) & 1]
        if not rows:
            return None
        prospect.points = prospect.points[rows]
        views = [one for one in self._viewpoints(scene, prospect) if one.gain >= 0.5 and self._is_new(one)]
        return max(views, key=lambda one: one.rate, default=None)

    def _viewpoints(self, scene: Scene, prospect: Prospect, share: float = 1.0) -> list[Viewpoint]:
        """Viewpoints before the support, with what they are worth; the places of a prospect are a share of all."""
        T = np.linalg.inv(self._reading.T_world_base) @ np.append(self._eye(), 1.0)
        limits = self._env.robot.chain[0]
        found = viewpoints(scene, prospect.points, T[:3], (limits.lower + 0.01, limits.upper - 0.01))
        return [
            replace(
                one, gain=share * prospect.gain(one.eye), seconds=_LOOK_SECONDS + self._seconds(self._drive_to(one))
            )
            for one in found
        ]

    def _is_new(self, view: Viewpoint) -> bool:
        """Whether nothing has been looked at from there since something moved."""
        return all(math.dist(view.eye, eye) > _NEW_EYE for eye in self._looked_from)

    def _solved(self, scene: Scene, goal: Goal) -> Solution | Infeasible:
        return self._planner.solve(scene, goal.target or goal, "lookahead" if goal.target else _ASIDE, self._rng)

    # Motions.

    def _follow(self, actions: tuple[BoundAction, ...]) -> Actions:
        """Follow planned motions; whether they came to their end."""
        if not actions:
            return True
        env, bodies = self._env, actions[0].scene.objects
        sensor = BelievedSensor(bodies, self._reading, env.robot, self._held)
        # The first object has just been looked at; those behind it come into sight as it goes.
        picks = [action.target for action in actions if action.name == "PickUp"][:1]
        unsure = {one.name for one in self._known if one.sigma > _UNSURE + self._noise} - set(picks)
        self._executor = executor = Executor(actions, env.robot, sensor, _TOLERANCES, at_start=2, unsure=unsure)  # type: ignore[arg-type]  # its members names and read are used
        head = np.array(env.robot.head_configuration) if len(self._reading.head) else None
        while not executor.is_over:
            sensor.update(self._reading)
            counted = len(executor.cleared)
            command = executor.advance(sensor.read())
            self.report.moves += executor.cleared[counted:]  # at once: the episode may end before the plan does
            self._last, self._width = command.drive, command.opening
            yield env.joint_action(command.drive, command.opening, head)
        self._executor = None
        sensor.update(self._reading)
        self._held = sensor.held
        self._settle_belief({new.name: new for old, new in zip(bodies, sensor.bodies, strict=True) if new is not old})
        self._start_over()
        if executor.deviation is not None:
            self.report.deviations.append(str(executor.deviation))
        return executor.deviation is None

    def _start_over(self) -> None:
        """Something has moved: views may show what they did not before."""
        self._looked_from: list[Array] = []
        self._missed = {name: np.zeros(cells.shape, np.int64) for name, cells in self._places().items()}

    def _settle_belief(self, moved: Mapping[str, Body]) -> None:
        """Objects moved by the robot: what it holds is in its hand, the rest where it let go of it, upright; around
        there nothing is known."""
        kept = []
        for one in self._known:
            if (body := moved.get(one.name)) is not None:
                if self._held is None or self._held.name != one.name:
                    under = [
                        s.top for s in self._supports if s.is_under(body.position[:2]) and s.top < body.position[2]
                    ]
                    height, turn = max(under, default=0.0) + one.body.half_extents[2], body.yaw / 2
                    upright = math.cos(turn), 0.0, 0.0, math.sin(turn)
                    body = one.body.at((*body.position[:2], height), upright)
                self._belief.move(one.body, body, one.sigma)
                T = body.pose @ np.linalg.inv(one.body.pose)
                one = replace(one, body=body, points=one.points @ T[:3, :3].T + T[:3, 3])
            kept.append(one)
        self._known = tuple(kept)

    def _carry(self) -> None:
        """Believe what is held to be where the hand is, or to have been dropped if the fingers press on nothing."""
        if self._held is not None:
            known, in_hand = {one.name: one.body for one in self._known}, self._held
            body = known[in_hand.name].at_pose(self._reading.T_world_tcp @ in_hand.T_tcp_object)
            if not self._reading.is_gripping:
                self._held = None
            self._settle_belief({in_hand.name: body})

    def _recover(self) -> Actions:
        """After a deviation: let go of what is held where the planner finds a place, and bring the arm home."""
        if self._held is not None:
            name = self._held.name
            outcome = self._solved(self._scene(), inside(name, self._empty.support.name))
            if isinstance(outcome, Solution):
                yield from self._follow(outcome.actions)
        yield from self._go_home()

    def _go_home(self) -> Actions:
        """Bring torso and arm to where plans begin."""
        if not np.allclose(self._reading.drive[3:], self._home, atol=0.02):
            yield from self._interpolate(np.concatenate((self._reading.drive[:3], self._home)))

    def _go(self, view: Viewpoint) -> Actions:
        """Drive to a viewpoint in a straight line, the arm aside, if that is free."""
        self.report.views += 1
        yield from self._interpolate(self._drive_to(view))

    def _drive_to(self, view: Viewpoint) -> Array:
        """The whole-body configuration at a viewpoint, the arm aside."""
        drive = np.concatenate((view.base, [view.torso], self._aside[1:]))
        drive[2] = unwrap_yaw(drive[2], self._reading.drive[2])
        return drive

    def _is_free(self, world: CollisionWorld, goal: Array) -> bool:
        """Whether all joints can move together from where they are to a whole-body configuration."""
        motion = np.stack((self._reading.drive, goal))
        return not world.path_hits(motion, self._env.robot.max_opening, self._held, first_only=True)

    def _interpolate(self, goal: Array) -> Actions:
        """Move all joints together to a whole-body configuration, if nothing known is in the way."""
        start = self._reading.drive.copy()
        if not self._is_free(CollisionWorld.from_scene(self._scene()), goal):
            return
        seconds = self._seconds(goal)
        steps = max(math.ceil(seconds / CONTROL_STEP), 1)
        for step in range(1, steps + 1):
            share = step / steps
            self._last = start + (goal - start) * share * share * (3 - 2 * share)
            yield self._env.joint_action(self._last, self._width)
        yield from self._wait(_SETTLE)

    def _seconds(self, goal: Array) -> float:
        """[s] that the motion to a whole-body configuration takes."""
        away, robot = np.abs(goal - self._reading.drive) / _SPEED, self._env.robot
        # A cubic is 1.5 times as fast as on average, and starts 6 times as hard.
        by_speed, by_force = 1.5 * away / robot.max_velocity, np.sqrt(6 * away / np.array(robot.max_acceleration))
        return float(np.maximum(by_speed, by_force).max())

    def _wait(self, steps: int) -> Actions:
        for _ in range(steps):
            yield self._env.joint_action(self._last, self._width)

    # Looking.

    def _look(self, names: Sequence[str]) -> Actions:
        """Look at supports, all if none is named, the arm out of sight for it."""
        places, points = self._places(), []
        supports = [one for one in self._supports if one.name in names] or self._supports
        for support in sorted(supports, key=lambda one: float(one.position[1])):
            left = self._belief.grid(support.name).centres()[places[support.name]]
            middle = left.mean(axis=0) if len(left) else support.position[:2]
            points.append(np.append(middle, support.top + self._target.height / 2))
        yield from self._turn_arm_aside(points)
        for point in points:
            yield from self._aim(point)
            self._take_in()
        self._looked_from.append(self._eye())
        for name, cells in self._places().items():
            in_line = Prospect(self._belief, {name: cells}, self._scene(), len(cells.ravel())).masks(self._eye()) == 0
            self._missed[name][cells] += in_line.any(axis=1)

    def _turn_arm_aside(self, points: Sequence[Array]) -> Actions:
        """Bring the arm, if it hides much of a view of some points (3,) [m], to where it hides little soonest."""
        drive, world, robot = self._reading.drive, CollisionWorld.from_scene(self._scene()), self._env.robot
        limits = np.array([(joint.lower, joint.upper) for joint in robot.chain[1:]])
        arms = [arm for arm in arms_near(self._home[1:]) if (limits[:, 0] < arm).all() and (arm < limits[:, 1]).all()]
        goals = [drive, *sorted((np.append(drive[:4], arm) for arm in arms), key=self._seconds)]
        hides: list[float] = []
        for goal in goals:
            hides.append(self._shadow.share(goal, points) if self._is_free(world, goal) else 1.0)
            if hides[-1] <= _HIDES:
                break
        best = goals[int(np.argmin(hides))]
        self._aside[1:] = best[4:]
        if best is not drive:
            yield from self._interpolate(best)

    def _aim(self, point: Array) -> Actions:
        """Turn the head until the first camera looks at a point (3,) [m], and wait until the image is still."""
        name = self._cameras[0]
        for _ in range(_AIM_STEPS if len(self._reading.head) else 0):
            T_world_camera = self._reading.T_world_base @ self._observation[f"{name}_T_base_camera"]
            x, y, z, _ = np.linalg.inv(T_world_camera) @ np.append(point, 1.0)
            errors = np.array((-math.atan2(x, z), math.atan2(y, math.hypot(x, z))))
            if np.abs(errors).max() < _AIMED:
                break
            yield self._env.joint_action(self._last, self._width, self._reading.head + 0.5 * errors)
        yield from self._wait(_SETTLE)

    def _take_in(self) -> None:
        """Carve, forget what is gone, and perceive, with each camera."""
        self._carry()
        started = time.process_time()
        views = [self._view(name) for name in self._cameras]
        for view in views:
            self._belief.update(view, self._noise)
        self.report.belief_s.append(time.process_time() - started)
        held = self._held.name if self._held else ""
        known = tuple(one for one in self._known if one.name == held or self._belief.emptied(one.body) < _GONE)
        for view in views:
            known = perceive(view, known, self._supports, self._target, held)
        self._known = known

    def _view(self, camera: str) -> View:
        return View.of(self._observation, camera, self._reading.T_world_base)

    def _eye(self) -> Array:
        """(3,) [m] where the first camera is."""
        return self._view(self._cameras[0]).T_world_camera[:3, 3]

    # What is known.

    def _places(self) -> dict[str, NDArray[np.bool_]]:
        return self._belief.places([one.body for one in self._known], self._empty.static_obstacles)

    def _seen_target(self) -> Seen | None:
        """What is known of the target; of two things that look like it the one of which most was seen."""
        return max((one for one in self._known if one.is_target), key=lambda one: len(one.points), default=None)

    def _is_target(self, name: str) -> bool:
        """Whether what has this name still is what is taken for the target: further views may join or lose things."""
        target = self._seen_target()
        return target is not None and target.name == name

    def _scene(self) -> Scene:
        """The known objects, narrower where they would overlap; the robot as it is, at home if it is near it.

        Where that does not help, one object has been taken for two: of both, the one of which less was seen is left
        out, never the target or what is held.
        """
        reading, robot, target = self._reading, self._env.robot, self._seen_target()
        q = self._home if np.abs(reading.drive[3:] - self._home).max() < 0.05 else reading.drive[3:]
        state = RobotState(reading.drive[:3], q, robot.finger_position(reading.width))
        known = {one.name: one for one in self._known}
        surety = {name: (one is target, len(one.points)) for name, one in known.items()}
        while True:
            for by in _SHRINK:
                narrower = (np.maximum(one.body.half_extents - (by, by, 0.0), 0.005) for one in known.values())
                parts = zip(known.values(), narrower, strict=True)
                bodies = tuple(replace(one.body, half_extents=half) for one, half in parts)
                scene = replace(self._empty, state=state, objects=bodies, held=self._held)
                world = CollisionWorld.from_scene(scene)
                pairs = [pair for pair in overlaps(world) if not set(scene.held_names) & set(pair)]
                if not pairs:
                    try:
                        validate(world)
                    except SceneError as error:
                        raise ExpertError(f"the robot stands inside the furniture of env.workplace: {error}") from error
                    return scene
            for pair in pairs:
                known.pop(min(pair, key=lambda name: surety[name]), None)

    def _note(self, kind: str, text: str, places: Mapping[str, NDArray[np.bool_]]) -> None:
        grids = {name: self._belief.grid(name) for name in places}
        step = SearchStep(self._ticks * CONTROL_STEP, kind, text, places, grids, self._known, self._eye())
        self.report.steps.append(step)

    def _end(self, failure: str) -> None:
        self.report.failure = failure
        self._note("end", failure, self._places())
