"""Plans for an arm whose controller moves the gripper and chooses the joints itself.

Such an arm moves its elbow elsewhere than the plan does. It may get stuck at a joint limit, or touch objects that the
plan avoids. A model of the controller tells which of several plans the arm can follow.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from planners.clock import Deadline
from planners.collision.opened import riding, without_moving
from planners.collision.world import CompiledScenes, with_clearance_around
from planners.goals import Before, Goal, GoalError
from planners.motion.tcp_following import TcpFollower, follow
from planners.planner import Planner
from planners.scene import Scene
from planners.strategies import Strategy
from planners.tamp.solution import BoundAction, Infeasible, Solution
from planners.workspace import Workspace

_Cost: TypeAlias = tuple[bool, bool, int, int, int]
"""Cost of a plan: whether the controller fails to follow it, whether it takes too long, touched objects, picks above
the lower bound, steps."""
_GOOD, _ENOUGH = (False, False, 0, 0), 3
"""First entries of the cost of a good plan, and number of good plans to compare."""


@dataclass(frozen=True)
class FollowingPlanner(Planner):
    """A planner that makes several plans and returns a plan that the controller can follow.

    The first plans are for the goal as it is: with arm configurations near home, where such controllers keep the
    joints, then with all. The next plans move one of the objects before or after all others of the goal. In a good
    plan, a model of the controller reaches the end in time, touches no object on the way, and makes no needless pick.
    Of the first three good plans, the one with the fewest steps is returned.

    Without a good plan, motions are checked one by one, near home. A motion that the controller cannot follow, or that
    touches an object, is replaced, for example by another grasp. If this fails too, the plan of the least cost is
    returned.

    Attributes:
        controller: the model. Unlike with `follower`, motions are planned as for joint control.
        near_home: whether only arm configurations near home are used.
        by_motion: whether motions are refused if the controller cannot follow them.
        steps_left: function for the number of controller steps left. None means enough.
    """

    controller: TcpFollower | None = None
    near_home: bool = False
    by_motion: bool = False
    steps_left: Callable[[], float] | None = None

    def workspace(self, scene: Scene) -> Workspace:
        """Workspace of `Planner`, near home if so chosen."""
        controller = self.controller if self.by_motion else None
        # Whether such a controller follows motions that are merged thoroughly has not been measured.
        workspace = replace(super().workspace(scene), controller=controller, hurries=False)
        return workspace.only_near_home() if self.near_home else workspace

    def solve(
        self,
        scene: Scene,
        goal: str | Goal,
        strategy: str | Strategy = "lookahead",
        rng: np.random.Generator | int | None = None,
        time_limit: float | None = None,
        start: Scene | None = None,
    ) -> Solution | Infeasible:
        """Plan for a goal. See the function `solve`."""
        deadline = Deadline.after(time_limit)
        wanted, drawn = Goal.of(goal, scene), np.random.default_rng(rng or 0)
        plans: list[tuple[_Cost, Solution]] = []
        refusals: list[Infeasible] = []
        orders = tuple(_orders(wanted, scene, start or scene))
        ways = [(ordered, near_home, False) for ordered in orders for near_home in (True, False)]
        ways += [(ordered, True, True) for ordered in orders if self.controller is not None]
        for ordered, near_home, by_motion in ways:
            if by_motion and any(cost[:-1] == _GOOD for cost, _ in plans):
                break
            left = None if time_limit is None else deadline.remaining
            planner = replace(self, near_home=near_home, by_motion=by_motion)
            found = Planner.solve(planner, scene, ordered, strategy, drawn, left, start)
            if isinstance(found, Infeasible):
                refusals.append(found)
            else:
                plans.append((self._cost(found, scene), found))
            if sum(cost[:-1] == _GOOD for cost, _ in plans) == _ENOUGH or deadline.is_over:
                break
        return _best(plans, refusals, wanted)

    def _cost(self, solution: Solution, scene: Scene) -> _Cost:
        needless = 0 if solution.bound is None else max(solution.picks - solution.bound.least, 0)
        if self.controller is None:
            return False, False, 0, needless, 0
        compiled, touched, steps, q = CompiledScenes(), 0, 0, np.array(scene.state.q)
        for action in solution.actions:
            followed = follow(self.controller, scene.robot, q, action.trajectory)
            if followed is None:
                return True, False, touched, needless, steps
            here: Scene = action.scene
            if _is_pull(action):  # it moves with the hand
                here = without_moving(here)
            world = compiled.world(here).with_padding(0.0)
            if action.name == "PickUp" and action.target in here.names:
                world = with_clearance_around(world, action.target)  # what it touches from the start
            hits = followed.hits(world, here.mask(_own(action, solution.goal)))
            touched += len(action.scene.names_of(hits))
            steps, q = steps + len(followed.configurations), followed.configurations[-1, 3:]
        is_late = self.steps_left is not None and steps > self.steps_left()
        return False, is_late, touched, needless, steps


def _own(action: BoundAction, goal: Goal | None) -> tuple[str, ...]:
    """Names of the objects that an action may touch: the moved object, and the object below or around its place.

    For an opening, these are the handle and the contents.
    """
    scene = action.scene
    if _is_pull(action):
        return riding(scene)
    facts = goal.placed if goal is not None and action.is_put_down else ()
    below = (fact.where for fact in facts if fact.object == action.target)
    return tuple(name for name in (action.target, *below) if name in scene.names)


def _is_pull(action: BoundAction) -> bool:
    return action.scene.pull is not None and action.target == action.scene.pull.opening


def _best(plans: Sequence[tuple[_Cost, Solution]], refusals: Sequence[Infeasible], goal: Goal) -> Solution | Infeasible:
    """Plan of the least cost, else the first refusal, which is for the goal as it is."""
    found = min(plans, key=lambda plan: plan[0])[1] if plans else refusals[0]
    return replace(found, goal=goal)


def _orders(goal: Goal, scene: Scene, start: Scene) -> Iterator[Goal]:
    """The goal as it is, then variants with each placed object moved before, or after, all others."""
    yield goal
    names = [fact.object for fact in goal.placed if not fact.holds(scene, start)]
    for name in names if len(names) > 1 else ():
        others = [other for other in names if other != name]
        for facts in ([Before(name, other) for other in others], [Before(other, name) for other in others]):
            ordered = replace(goal, facts=(*goal.facts, *facts))
            try:
                ordered.check(scene)
            except GoalError:  # against the goal's own order, or against a stack
                continue
            yield ordered
