"""Built-in task planner: A* over the symbolic state."""

from __future__ import annotations

import math
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator
from heapq import heappop, heappush
from itertools import count

from planners.symbolic.problem import Atom, GroundAction, NoPlan, SymbolicState, TaskPlan, TaskProblem
from planners.symbolic.transitions import apply_action, arm_actions


class AStar:
    """A* search in process, which finds shortest plans and needs no installation."""

    name = "astar"

    def plan(self, problem: TaskProblem, time_limit: float = math.inf) -> TaskPlan | NoPlan:
        """Find a shortest plan. "unsolvable" is a proof that no plan exists, "gave up" comes after `time_limit` [s].

        Each step of the search is an arm action with the drive that makes it possible, because every other drive is
        useless.
        """
        deadline = time.perf_counter() + time_limit
        to_go = LowerBound(problem)
        order = count()
        queue: list[tuple[float, float, int, SymbolicState]] = [(0, 0, next(order), problem.state)]
        cost: dict[frozenset[Atom], int] = {problem.state.facts: 0}
        came_from: dict[frozenset[Atom], tuple[frozenset[Atom], tuple[GroundAction, ...]]] = {}
        closed: set[frozenset[Atom]] = set()
        while queue:
            if time.perf_counter() > deadline:
                return NoPlan("gave up")
            state = heappop(queue)[-1]
            facts = state.facts
            if problem.goals <= facts:
                steps: tuple[GroundAction, ...] = ()
                while facts in came_from:
                    facts, actions = came_from[facts]
                    steps = (*actions, *steps)
                return TaskPlan(steps)
            if facts in closed:
                continue
            closed.add(facts)
            for actions, successor in _successors(state):
                length = cost[facts] + len(actions)
                if length < cost.get(successor.facts, math.inf):
                    remaining = to_go(successor)
                    if remaining < math.inf:
                        cost[successor.facts] = length
                        came_from[successor.facts] = facts, actions
                        closed.discard(successor.facts)
                        heappush(queue, (length + remaining, remaining, next(order), successor))
        return NoPlan("unsolvable")


class LowerBound:
    """Lower bound on the number of actions from a state to the goal, infinite if the goal is out of reach.

    It adds every pick-up and put-down that all plans need. It adds a drive for each group of these actions that shares
    no base pose with other groups. Where objects may be held aside, put-downs are left out.
    """

    def __init__(self, problem: TaskProblem) -> None:
        """Look up the facts that actions never change: the base poses and trajectories that reach each grasp."""
        self._problem = problem
        bases: dict[str, set[str]] = defaultdict(set)
        trajectories: dict[str, set[str]] = defaultdict(set)
        for _, trajectory, base, arm_pose in problem.state.find("isMotion", None, None, None):
            bases[arm_pose].add(base)
            trajectories[arm_pose].add(trajectory)
        self._bases: dict[tuple[str, str], frozenset[str]] = defaultdict(frozenset)
        self._trajectories: dict[tuple[str, str], frozenset[str]] = defaultdict(frozenset)
        for _, arm_pose, name, location in problem.state.find("isGrasp", None, None, None):
            self._bases[name, location] |= bases[arm_pose]
            self._trajectories[name, location] |= trajectories[arm_pose]
        self._put_down: dict[str, frozenset[str]] = defaultdict(frozenset)
        cleared = problem.state.find("isClearanceLocation", None, None, None)
        for _, location, name, *_ in (*cleared, *problem.state.find("isPlacementLocation", None, None)):
            self._put_down[name] |= self._bases[name, location]

    def __call__(self, state: SymbolicState) -> float:
        """The bound at this state of the problem."""
        if self._problem.goals <= state.facts:
            return 0
        held = state.all_held
        stands_at = {name: location for _, name, location in state.find("objectAt", None, None)}
        necessary = self._necessary(state, stands_at)
        steps = [self._bases[name, stands_at[name]] for name in necessary if name not in held]
        if not state.holds_aside:
            steps += [self._put_down[name] for name in necessary if name != self._problem.target]
            steps += [self._put_down[name] for name in held if name not in necessary]
        if not all(steps):
            return math.inf
        is_standing_right = any(state.robot_at in poses for poses in steps)
        return len(steps) + _number_of_groups(steps) - is_standing_right

    def _necessary(self, state: SymbolicState, stands_at: dict[str, str]) -> set[str]:
        """Names of the target, objects not yet placed, and every object that obstructs all grasps of a necessary
        object."""
        necessary: set[str] = set()
        blockers = state.blockers()
        frontier = [self._problem.target] if self._problem.target else []
        frontier += [fact[1] for fact in self._problem.placed if fact not in state.facts]
        while frontier:
            name = frontier.pop()
            if name in necessary:
                continue
            necessary.add(name)
            trajectories = self._trajectories[name, stands_at[name]] if name in stands_at else ()
            in_the_way = [blockers.get(name, {}).get(trajectory, set()) for trajectory in trajectories]
            frontier.extend(set.intersection(*in_the_way) if in_the_way else ())
        return necessary


def _successors(state: SymbolicState) -> Iterator[tuple[tuple[GroundAction, ...], SymbolicState]]:
    here = state.robot_at
    drives = {pose: trajectory for _, trajectory, pose in state.find("isBaseMotion", None, None)}
    for action, base in arm_actions(state):
        if base == here:
            yield (action,), apply_action(state, action)
        elif base in drives:
            drive = GroundAction("MoveBase", (here, base, drives[base]))
            yield (drive, action), apply_action(apply_action(state, drive), action)


def _number_of_groups(sets: Iterable[frozenset[str]]) -> int:
    """Number of sets left after sets with a common element are merged."""
    merged: list[frozenset[str]] = []
    for item in sets:
        touching = [other for other in merged if other & item]
        merged = [other for other in merged if not other & item]
        merged.append(item.union(*touching))
    return len(merged)
