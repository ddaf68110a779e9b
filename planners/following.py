"""Plans for an arm whose controller moves the gripper and chooses the joints itself.

Such an arm bends its elbow elsewhere than the plan does. It may run into a limit of a joint and stay there, or touch
what the plan passes. Which of several plans it can follow is found out with a model of the controller.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from planners.clock import Deadline
from planners.collision.opened import riding, without_moving
from planners.collision.world import CompiledScenes
from planners.goals import Before, Goal, GoalError
from planners.motion.tcp_following import TcpFollower, follow
from planners.planner import Planner
from planners.scene import Scene
from planners.strategies import Strategy
from planners.tamp.solution import Infeasible, Solution
from planners.workspace import Workspace

_Cost: TypeAlias = tuple[bool, bool, int, int, int]
"""Of a plan: whether the controller cannot follow it to its end; whether it takes too long; how many objects it
touches; how many picks it has more than the lower bound; its steps."""
_GOOD, _ENOUGH = (False, False, 0, 0), 3
"""How the cost of good plans begins, and how many of them are compared."""


@dataclass(frozen=True)
class FollowingPlanner(Planner):
    """A planner that returns, of several plans, one that the controller can follow.

    The first plans are for the goal as it is, with arm configurations near home, where such controllers keep the
    joints, and with all. The others move one of the objects before, or after, all others of the goal. Good plans are
    those that a model of the controller follows to their end in time, that touch no object on the way and take none
    without need. Of the first three, the one that takes the fewest steps is returned.

    If there are none, motions are looked at one by one, near home: those that the controller cannot follow, or that
    touch an object, are replaced, as by one with another grasp. If there is no good plan then either, the one is
    returned that comes nearest to this.

    Attributes:
        controller: the model. Other than with `follower`, motions are planned as for joint control.
        near_home: whether only arm configurations near home count.
        by_motion: whether motions are refused that the controller cannot follow.
        steps_left: tells how many steps of the controller are left; None: enough.
    """

    controller: TcpFollower | None = None
    near_home: bool = False
    by_motion: bool = False
    steps_left: Callable[[], float] | None = None

    def workspace(self, scene: Scene) -> Workspace:
        """That of `Planner`, near home if so chosen."""
        workspace = replace(super().workspace(scene), controller=self.controller if self.by_motion else None)
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
        """Plan for a goal; see the function `solve`."""
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
            own: tuple[str, ...] = (action.target,) if action.target else ()
            if here.pull is not None and action.target == here.pull.opening:  # it moves with the hand
                here, own = without_moving(here), riding(here)
            hits = followed.hits(compiled.world(here).with_padding(0.0), here.mask(own))
            touched += len(action.scene.names_of(hits))
            steps, q = steps + len(followed.configurations), followed.configurations[-1, 3:]
        is_late = self.steps_left is not None and steps > self.steps_left()
        return False, is_late, touched, needless, steps


def _best(plans: Sequence[tuple[_Cost, Solution]], refusals: Sequence[Infeasible], goal: Goal) -> Solution | Infeasible:
    """The plan of the least cost, else the first refusal: that of the goal as it is."""
    found = min(plans, key=lambda plan: plan[0])[1] if plans else refusals[0]
    return replace(found, goal=goal)


def _orders(goal: Goal, scene: Scene, start: Scene) -> Iterator[Goal]:
    """The goal as it is; then with each object that it places moved before, or after, all others."""
    yield goal
    names = [fact.object for fact in goal.placed if not fact.holds(scene, start)]
    for name in names if len(names) > 1 else ():
        others = [other for other in names if other != name]
        for facts in ([Before(name, other) for other in others], [Before(other, name) for other in others]):
            ordered = replace(goal, facts=(*goal.facts, *facts))
            try:
                ordered.check(scene)
            except GoalError:  # against the goal's own order, or what stands on what
                continue
            yield ordered
