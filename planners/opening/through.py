"""Plans in a world in which something opens: what the goal wants open or shut, and what else must be opened for it.

Such a plan is a sequence of plans, each of them one run of Algorithm 1 with its attempts: first what the goal wants
open; then, for what is out of reach as the world is and within reach with a drawer or door open, that one; then the
rest of the goal; last what the goal wants shut. A handle is an object among the others (`planners.opening.handle`): so
what is in the way of a drawer is put aside as everything else is.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from planners.cause import Cause
from planners.clearing.goal_bound import LowerBound
from planners.clock import Deadline
from planners.facts import Closed, Open, Pulled, Turned
from planners.goals import Goal
from planners.opening.handle import handles_of, with_handle, without_handle
from planners.problem import Problem
from planners.scene import Opening, Scene
from planners.scene.moving import carried_by, moved
from planners.tamp.solution import BoundAction, Infeasible, Solution, SolveStats

_FULLY, _FURTHER = 0.97, 0.08
"""Share to which something is opened that is in the way, short of its stop; and how much farther than wanted."""
_MOST = 2
"""Things that are opened for the same object at most."""


@dataclass(frozen=True)
class Asked:
    """A planner that is asked for the parts of a plan.

    Attributes:
        problem: makes the problem of a goal in a scene, from a scene in which it began.
        solve: plans for a problem.
        deadline: when to stop.
    """

    problem: Callable[[Scene, Goal, Scene | None], Problem]
    solve: Callable[[Problem], Solution | Infeasible]
    deadline: Deadline


def solve_through(asked: Asked, scene: Scene, goal: Goal, start: Scene | None = None) -> Solution | Infeasible:
    """A plan for a goal in a scene in which something opens, or why there is none.

    Args:
        asked: the planner.
        scene: as it is.
        goal: what is wanted.
        start: the scene from which the goal counts.
    """
    began, here = start or scene, scene
    parts: list[Solution] = []
    wanted = [fact for fact in goal.openings if not fact.holds(scene)]
    rest = tuple(fact for fact in goal.facts if fact not in goal.openings)
    for fact in wanted:
        if isinstance(fact, Closed):
            continue
        found = _moved_to(asked, here, fact.opening, _further(here, fact))
        if isinstance(found, Infeasible):
            return _ended(found, goal, parts)
        here = _joined(parts, found)
    if rest and not Goal(rest).holds(here, began):
        left = Goal(rest)
        for name in needed(asked, here, left, began):
            opening = here.opening(name)
            found = _moved_to(asked, here, name, opening.at_share(_FULLY))
            if isinstance(found, Infeasible):
                return _ended(found, goal, parts)
            here = _joined(parts, found)
        found = asked.solve(asked.problem(here, left, began))
        if isinstance(found, Infeasible):
            return _ended(found, goal, parts)
        here = _joined(parts, found)
    for shut in goal.openings:
        if isinstance(shut, Closed) and not shut.holds(here):
            found = _moved_to(asked, here, shut.opening, here.opening(shut.opening).shut)
            if isinstance(found, Infeasible):
                return _ended(found, goal, parts)
            here = _joined(parts, found)
    return _one_plan(parts, goal, here, asked)


def needed(asked: Asked, scene: Scene, goal: Goal, start: Scene) -> tuple[str, ...]:
    """Names of what must be opened before a goal can be reached: as few as will do; none if nothing helps.

    What is in the way of the goal is proved by the lower bound: that no grasp reaches what must move as the world is.
    """
    if _is_possible(asked, scene, goal, start):
        return ()
    shut = sorted(
        (one for one in scene.openings if one.share < _FULLY / 2), key=lambda one: -_carries(scene, goal, one)
    )
    for count in range(1, _MOST + 1):
        for some in itertools.combinations(shut, count):
            opened = scene
            for one in some:
                opened = moved(opened, one.name, opened.opening(one.name).at_share(_FULLY))
            if _is_possible(asked, opened, goal, start):
                return tuple(one.name for one in some)
    return ()


def lower_bound_through(asked: Asked, scene: Scene, goal: Goal, start: Scene | None = None) -> LowerBound:
    """The fewest picks and pulls of any plan for a goal in a scene in which something opens.

    Each thing that must be opened or shut is one pull. An object that is put aside for a pull may be one that has to go
    for the rest too: so of these the greater number counts as proved, the sum of both as what is to be expected.
    """
    began, here = start or scene, scene
    bounds: list[LowerBound] = []
    rest = tuple(fact for fact in goal.facts if fact not in goal.openings)
    moves = [(fact.opening, fact.position_in(scene)) for fact in goal.openings if not fact.holds(scene)]
    if rest:
        opened = here
        for name, position in moves:
            opened = moved(opened, name, position)
        names = needed(asked, opened, Goal(rest), began)
        moves += [(name, opened.opening(name).at_share(_FULLY)) for name in names]
    for name, position in moves:
        found = [asked.problem(twin, goal_of(twin), None).lower_bound() for twin in _twins(here, name, position)]
        if not found:
            return LowerBound(None, (name,), (), True, 0, Cause.UNREACHABLE)
        best = min(found, key=lambda one: (one.picks is None, one.least))
        if best.picks is None:
            return best
        bounds.append(best)
        here = moved(here, name, position)
    if rest:
        last = asked.problem(here, Goal(rest), began).lower_bound()
        if last.picks is None:
            return last
        bounds.append(last)
    pulls = len(moves)
    aside = [bound.least - 1 for bound in bounds[:pulls]]
    least = pulls + max([*aside, *(bound.least for bound in bounds[pulls:]), 0])
    picks = sum(bound.picks or 0 for bound in bounds)
    objects = tuple(dict.fromkeys(name for bound in bounds for name in bound.objects))
    twice = tuple(name for bound in bounds for name in bound.aside)
    proved = picks == least and all(bound.proved for bound in bounds)
    return LowerBound(picks, objects, twice, proved, least, "", sum(bound.expansions for bound in bounds))


def goal_of(twin: Scene) -> Goal:
    """The goal of a scene with a handle: that it has been pulled."""
    assert twin.pull is not None
    return Goal((Pulled(twin.pull.handle),))


def _is_possible(asked: Asked, scene: Scene, goal: Goal, start: Scene) -> bool:
    bound = asked.problem(scene, goal, start).lower_bound(deadline=asked.deadline)
    return bound.picks is not None or not bound.proved


def _carries(scene: Scene, goal: Goal, opening: Opening) -> bool:
    """Whether what a goal names stands in something that opens, or is to."""
    named = {value for fact in goal.facts for value in vars(fact).values() if isinstance(value, str)}
    return bool(named & {*carried_by(scene, opening), *opening.parts})


def _further(scene: Scene, fact: Open | Turned) -> float:
    """The position [m] or [rad] to which something is pulled that is to be open by a share, or at an angle."""
    opening, position = scene.opening(fact.opening), fact.position_in(scene)
    if isinstance(fact, Turned):
        return position
    share = (position - opening.shut) / (opening.open - opening.shut)
    return opening.at_share(max(min(share + _FURTHER, _FULLY), share))


def _twins(scene: Scene, name: str, position: float) -> Iterator[Scene]:
    """The scenes in which a handle of what opens stands among the objects."""
    for handle in handles_of(scene, name):
        twin = with_handle(scene, name, position, handle)
        if twin is not None:
            yield twin


def _moved_to(asked: Asked, scene: Scene, name: str, position: float) -> Solution | Infeasible:
    """A plan that opens or shuts something by one of its handles, or why there is none."""
    opening = scene.opening(name)
    towards_open = (position - opening.position) * (opening.open - opening.shut) > 0
    if towards_open and opening.springs_shut:
        detail = f"a spring of {abs(opening.spring):.1f} shuts {name} when nobody holds it, and both hands are needed"
        return Infeasible(Cause.SPRINGS_SHUT, detail, (name,))
    ended: Infeasible | None = None
    for twin in _twins(scene, name, position):
        found = asked.solve(asked.problem(twin, goal_of(twin), None))
        if isinstance(found, Solution):
            return _as_opened(found, scene, opening, position)
        ended = ended or found
        if asked.deadline.is_over:
            break
    return ended or Infeasible(Cause.UNREACHABLE, f"{name} has no handle that is known", (name,))


def _as_opened(found: Solution, scene: Scene, opening: Opening, position: float) -> Solution:
    """A plan that has taken a handle, its last action named for what it does, and the scene at its end as it is."""
    assert found.end is not None
    end = without_handle(found.end, moved(scene, opening.name, position))
    towards_open = (position - opening.position) * (opening.open - opening.shut) > 0
    name = "Open" if towards_open else "Close"
    actions = tuple(
        replace(one, name=name, args=(opening.name, *one.args[1:]), target=opening.name) if _is_pull(one) else one
        for one in found.actions
    )
    return replace(found, actions=actions, end=end)


def _is_pull(action: BoundAction) -> bool:
    pull = action.scene.pull
    return action.name == "PickUp" and pull is not None and action.target == pull.handle


def _joined(parts: list[Solution], found: Solution) -> Scene:
    """The scene after one more part of a plan."""
    parts.append(found)
    assert found.end is not None
    return found.end


def _ended(found: Infeasible, goal: Goal, parts: list[Solution]) -> Infeasible:
    """The end of a search in one of its parts."""
    done = tuple(name for part in parts for name in part.clearances)
    where = f", to open {found.target.partition(':')[0]}" if ": handle" in found.target else ""
    return replace(
        found, detail=found.detail + where, clearances=(*done, *found.clearances), target=goal.target, goal=goal
    )


def _one_plan(parts: list[Solution], goal: Goal, end: Scene, asked: Asked) -> Solution | Infeasible:
    """The parts as one plan."""
    if not parts:
        return asked.solve(asked.problem(end, goal, None))
    stats = [part.stats for part in parts]
    total = SolveStats(
        replans=sum(one.replans for one in stats),
        task_plans=sum(one.task_plans for one in stats),
        task_planning_s=sum(one.task_planning_s for one in stats),
        motion_planning_s=sum(one.motion_planning_s for one in stats),
        total_s=sum(one.total_s for one in stats),
        unusable=sum(one.unusable for one in stats),
        history=tuple(record for one in stats for record in one.history),
    )
    return replace(
        parts[-1],
        actions=tuple(action for part in parts for action in part.actions),
        clearances=tuple(name for part in parts for name in part.clearances),
        stats=total,
        target=goal.target,
        goal=goal,
        end=end,
    )
