"""A planning problem: a goal in a scene, checked and compiled once for all planning.

planner = Planner("fetch")
problem = planner.problem(scene, "object_03")
problem.lower_bound(), planner.solve_problem(problem)
problem = problem.in_scene(changed)  # objects have moved: results for unmoved parts are reused
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

from assets.robots import RobotSpec
from planners.clearing.goal_bound import LowerBound, fewest_picks, must_move
from planners.clearing.lower_bound import MAX_EXPANSIONS
from planners.clock import NO_DEADLINE, Deadline
from planners.collision.world import SUPPORT_SLACK, CompiledScenes, validate
from planners.goals import Clear, Fact, Goal, Inside, On, levels_under
from planners.grasping.candidates import GraspCandidates
from planners.motion.kept import KeptMotions
from planners.motion.mujoco_check import MujocoCollisionChecker
from planners.regions import RESTING
from planners.scene import Body, Scene, SceneError
from planners.workspace import Workspace


@dataclass(frozen=True, eq=False)
class Problem:
    """A goal in a scene, with the data that every layer of planning needs. See `planners.Planner.problem`.

    Attributes:
        scene: the scene with robot and objects.
        goal: the goal.
        start: the scene that the goal is measured from. Objects that stood there are to stand, even if they have fallen
            since.
        workspace: the robot among the static obstacles, with the options of a whole solve.
        hold_aside: whether one arm may hold an obstacle while another one takes the target.
        compiled: collision worlds of the arrangements so far.
        checkers: MuJoCo's models of the scenes, by what they are built from.
        motions: motions planned for this scene, to reuse in the next one, and motions of the scene before.
        candidates: the grasps known in the scene, before any is refuted by a motion. Each plan uses a copy.
    """

    scene: Scene
    goal: Goal
    start: Scene
    workspace: Workspace
    hold_aside: bool = False
    compiled: CompiledScenes = field(default_factory=CompiledScenes, repr=False)
    motions: KeptMotions = field(default_factory=KeptMotions, repr=False)
    checkers: dict[Hashable, MujocoCollisionChecker] = field(default_factory=dict, repr=False)
    candidates: GraspCandidates = field(init=False, repr=False)
    _bounds: dict[tuple[int, bool, float], LowerBound] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        candidates = replace(self.workspace.grasps(self.compiled), remembers=True)
        object.__setattr__(self, "candidates", candidates)

    @classmethod
    def of(
        cls, scene: Scene, goal: Goal, workspace: Workspace, *, start: Scene | None = None, hold_aside: bool = False
    ) -> Problem:
        """Problem of a valid goal in a scene. See `goal_in`.

        Raises:
            SceneError: objects overlap, or the robot is inside a static obstacle.
        """
        compiled, scene = CompiledScenes(), not_sunk(scene)
        validate(compiled.world(scene))
        return cls(scene, goal, start or scene, workspace, hold_aside, compiled)

    @property
    def target(self) -> str:
        """Name of the object to hold if that is the whole goal, else ""."""
        return self.goal.target

    def in_scene(self, scene: Scene) -> Problem:
        """The same goal in another scene with the same robot and static obstacles.

        Grasps are computed again only near moved objects, and motions are reused if no moved object is near them. So
        the answer comes sooner, but its motions may differ from those of a new problem.

        Raises:
            GoalError, UnknownObject: the goal is invalid in that scene.
            SceneError: as for `of`, or the robot, the static obstacles or the supports differ.
        """
        robot_of(scene)
        if _fixed(scene) != _fixed(self.scene):
            raise SceneError("the robot, the static obstacles or the supports are others: ask for a new problem")
        found = Problem.of(scene, goal_in(scene, self.goal), self.workspace, hold_aside=self.hold_aside)
        found = replace(found, motions=self.motions.for_next_scene(), checkers=self.checkers)
        found.candidates.learn_for(found.scene, self.candidates)
        return found

    def near_home(self) -> Problem:
        """The same problem with arm configurations near home only."""
        return replace(self, workspace=self.workspace.only_near_home(), _bounds={})

    @cached_property
    def closer(self) -> Problem:
        """The same problem with many more base poses, for objects with something in the way of every known grasp."""
        closer = replace(self, workspace=self.workspace.looking_closely(), _bounds={})
        object.__setattr__(closer, "candidates", self.candidates.looking_closely(self.scene))
        return closer

    def lower_bound(
        self, expansions: int = MAX_EXPANSIONS, deadline: Deadline = NO_DEADLINE, *, is_exact: bool = True
    ) -> LowerBound:
        """Find the lower bound of the picks. See `planners.clearing.goal_bound`, and for `is_exact` `fewest_picks`.

        It holds for the scene as it is: nothing is opened. `Planner.lower_bound` includes opening. If other objects
        than those of the goal seem to be in the way, it holds for many more base poses than plans begin with.
        """
        found = self.first_bound(expansions, deadline, is_exact=is_exact)
        if not self._may_be_lower(found):
            return found
        if deadline.is_over:
            return self.without_closer_look(found)
        fewer_than = math.inf if found.picks is None else found.picks
        closer = self.closer.first_bound(expansions, deadline, is_exact=is_exact, fewer_than=fewer_than)
        if closer.picks is not None and (found.picks is None or closer.picks < found.picks):
            return closer
        least, is_proved = min(found.least, closer.least), found.proved and closer.proved
        return found if (least, is_proved) == (found.least, found.proved) else replace(found, least=least, proved=False)

    def without_closer_look(self, found: LowerBound) -> LowerBound:
        """What a bound for the base poses that plans begin with says of many more, if there was no time for these."""
        if not self._may_be_lower(found):
            return found
        return replace(found, least=min(found.least, self._to_pick), proved=False)

    def _may_be_lower(self, found: LowerBound) -> bool:
        """Whether many more base poses may lower a bound for those that plans begin with."""
        return self.candidates.can_look_closely and found.picks != self._to_pick

    @cached_property
    def _to_pick(self) -> int:
        """Number of the objects that every plan picks: those that must move and are in no hand."""
        return len({*must_move(self.scene, self.goal, self.start)} - {*self.scene.held_names})

    def first_bound(
        self,
        expansions: int = MAX_EXPANSIONS,
        deadline: Deadline = NO_DEADLINE,
        *,
        is_exact: bool = True,
        fewer_than: float = math.inf,
    ) -> LowerBound:
        """Find the lower bound for the base poses that plans begin with, cached. See `fewest_picks`."""
        # What is known exactly serves for both.
        key = expansions, is_exact or (expansions, True, fewer_than) in self._bounds, fewer_than
        if key not in self._bounds:
            found = fewest_picks(
                self.scene,
                self.goal,
                self.candidates,
                self.start,
                search=self.workspace.placements(),
                buffers=not self.hold_aside,
                is_exact=is_exact,
                fewer_than=fewer_than,
                expansions=expansions,
                deadline=deadline,
            )
            if deadline.is_over:
                return found
            self._bounds[key] = found
        return self._bounds[key]


def goal_in(scene: Scene, goal: str | Goal, start: Scene | None = None) -> Goal:
    """Resolve a name, a text or a `Goal` in a scene. It is read in the start scene.

    A name of a body in the model may stand for the support on it. The goal then has the name of the support.

    Raises:
        SceneError: the scene is no `Scene`.
        UnknownObject: no object of that name.
        GoalError: the goal is invalid in the scene, or contradicts itself.
    """
    robot_of(scene)
    wanted = _with_supports_for_bodies(Goal.of(goal, start or scene), start or scene)
    if wanted.target:
        scene.index(wanted.target)
    wanted.check(scene)
    return wanted


def _with_supports_for_bodies(goal: Goal, scene: Scene) -> Goal:
    """The goal with the support's name in place of the body that the support is part of."""
    known, meant = {*scene.names, *scene.supports, *(one.name for one in scene.regions)}, dict(scene.support_bodies)
    facts: list[Fact] = []
    for fact in goal.facts:
        match fact:
            case On(_, place) if place not in known and place in meant:
                facts.append(replace(fact, place=meant[place]))
            case Inside(_, region) | Clear(region) if region not in known and region in meant:
                facts.append(replace(fact, region=meant[region]))
            case _:
                facts.append(fact)
    return goal if facts == list(goal.facts) else Goal(tuple(facts)).in_scene(scene)


def robot_of(scene: Scene) -> RobotSpec:
    """Robot of a scene. Raises `SceneError` for anything else, such as an environment."""
    if not isinstance(scene, Scene):
        advice = "Scene.from_mujoco(env.unwrapped.model, env.unwrapped.data, env.unwrapped.robot)"
        raise SceneError(f"a {type(scene).__name__} is no Scene; of an environment {advice} is one")
    return scene.robot


def not_sunk(scene: Scene) -> Scene:
    """Raise objects that press too deep into their support onto its surface.

    Simulated contacts are soft, and perceived poses are inexact.
    """
    for name in sorted(scene.names, key=lambda name: scene.body(name).bottom):
        body = scene.body(name)
        levels = (*levels_under(scene, body), *_furniture_under(scene, body))
        sunk = max((level - body.bottom for level in levels), default=0.0)
        if sunk > SUPPORT_SLACK and name not in scene.held_names:
            scene = scene.with_body(body.at(body.position + [0.0, 0.0, sunk]))
    return scene


def _furniture_under(scene: Scene, body: Body) -> Iterator[float]:
    """[m] heights of level faces under the centre of an object into which it presses, supports or not."""
    for one in scene.static_obstacles:
        if 0.0 < one.top - body.bottom <= RESTING and one.has_level_top and one.is_under(body.position[:2]):
            yield one.top


def _fixed(scene: Scene) -> Hashable:
    """Data that a workspace is compiled for, with the base pose if the base is fixed."""
    obstacles = tuple(
        (
            one.name,
            one.shape,
            *(array.tobytes() for array in (one.position, one.half_extents, one.rotation, one.vertices)),
        )
        for one in scene.static_obstacles
    )
    base = scene.state.base.tobytes() if scene.robot.base_drive == "fixed" else b""
    return scene.robot, scene.supports, tuple(obstacles), base
