"""Plans in a world in which something opens: what the goal wants open or shut, and what else must be opened for it.

Such a plan is a sequence of plans, each of them one run of Algorithm 1 with its attempts: first what the goal wants
open; then, for what is out of reach as the world is and within reach with a drawer or door open, that one; then the
rest of the goal; last what the goal wants shut. A handle is an object among the others (`planners.opening.handle`): so
what is in the way of a drawer is put aside as everything else is.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace

from planners.cause import Cause
from planners.clearing.goal_bound import LowerBound
from planners.clock import Deadline
from planners.facts import LACKS, At, Closed, Fact, Holding, Inside, On, Open, Pulled, Turned
from planners.goals import Goal
from planners.grasping.push_poses import face_against
from planners.opening.handle import HANDLE_OF, as_if_opened, handles_of, with_handle, without_handle
from planners.opening.latches import latches
from planners.problem import Problem
from planners.scene import MAX_OBJECTS, Opening, Scene
from planners.scene.cover import is_covered
from planners.scene.moving import carried_by, moved
from planners.tamp.solution import BoundAction, Infeasible, Solution, SolveStats

_FULLY, _FURTHER = 0.97, 0.08
"""Share to which something is opened that is in the way, short of its stop; and how much farther than wanted."""
_HALF = _FULLY / 2
"""Share below which something is more shut than open."""
_LEFT_AT = (0.6, 0.35)
"""Shares of its way at which something is left that no hand follows all the way."""
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
    parts: list[Solution] = []
    for part in _parts(asked, scene, goal, start or scene, parts):
        if isinstance(part, Infeasible):
            return _ended(part, goal, parts)
        parts.append(part)
    return _one_plan(parts, goal, asked.problem(scene, goal, start) if not parts else None, asked)


def _parts(
    asked: Asked, scene: Scene, goal: Goal, start: Scene, done: Sequence[Solution]
) -> Iterator[Solution | Infeasible]:
    """The parts of a plan, one after another; each begins where those `done` by then end."""

    def here() -> Scene:
        return (done[-1].end if done else None) or scene

    rest = _rest_of(goal)
    first, last = _wanted(asked, scene, goal, start)
    for opened, position in first:
        yield from _moved_to(asked, here(), opened.opening, position)
    if rest is not None and not rest.holds(here(), start):
        for name in needed(asked, here(), rest, start):
            yield from _moved_to(asked, here(), name, here().opening(name).at_share(_FULLY))
        if goal.held and any(not fact.holds(here()) for fact in last):
            # What is to be held in the end waits outside: the hand has to shut the door first.
            yield _put_outside(asked, here(), rest.facts, start)
            for fact in last:
                yield from () if fact.holds(here()) else _moved_last(asked, here(), fact)
        found = asked.solve(asked.problem(here(), rest, start))
        if isinstance(found, Infeasible) and (name := helpful(asked, here(), rest, start)):
            for part in _moved_to(asked, here(), name, here().opening(name).at_share(_FULLY)):
                yield replace(part, bound=None) if isinstance(part, Solution) else part  # it may be that none is needed
            found = asked.solve(asked.problem(here(), rest, start))
        yield found
    for fact in last:
        if not fact.holds(here()):
            yield from _moved_last(asked, here(), fact)


def _wanted(
    asked: Asked, scene: Scene, goal: Goal, start: Scene
) -> tuple[list[tuple[Open | Turned, float]], list[Open | Closed | Turned]]:
    """What of a goal is opened before the rest, each with the position [m] or [rad], and what is moved after it.

    What the rest needs farther open is opened so far at once, and is brought to its angle after it.
    """
    first = [(fact, _further(scene, fact)) for fact in goal.openings if not isinstance(fact, Closed)]
    first = [(fact, position) for fact, position in first if not fact.holds(scene)]
    last: list[Open | Closed | Turned] = [fact for fact in goal.openings if not isinstance(fact, Open)]
    rest = _rest_of(goal)
    if not first or rest is None or rest.holds(scene, start):
        return first, last
    opened = scene
    for fact, position in first:
        opened = as_if_opened(opened, fact.opening, position)
    names = needed(asked, opened, rest, start)
    farther = [
        (fact, scene.opening(fact.opening).at_share(_FULLY) if fact.opening in names else position)
        for fact, position in first
    ]
    return [(fact, position) for fact, position in farther if isinstance(fact, Open) or fact.opening not in names], last


def _rest_of(goal: Goal) -> Goal | None:
    """What a goal says of anything but what opens; None if nothing."""
    rest = tuple(fact for fact in goal.facts if fact not in goal.openings)
    return Goal(rest) if rest else None


def _moved_last(asked: Asked, scene: Scene, fact: Open | Closed | Turned) -> Iterator[Solution | Infeasible]:
    """Plans that shut something, or bring it to an angle, once the rest of a goal is done."""
    return _moved_to(asked, scene, fact.opening, _last_position(scene, fact))


def _last_position(scene: Scene, fact: Open | Closed | Turned) -> float:
    """The position [m] or [rad] to which something is moved in the end."""
    return scene.opening(fact.opening).shut if isinstance(fact, Closed) else _further(scene, fact)


def _put_outside(asked: Asked, scene: Scene, facts: Sequence[Fact], start: Scene) -> Solution | Infeasible:
    """A plan for facts of a goal in which what is to be held is put on a support that does not move."""
    moving = {name for one in scene.openings for name in one.parts}
    ended: Infeasible | None = None
    for support in (one for one in scene.supports if one not in moving):
        outside = [On(fact.object, support) if isinstance(fact, Holding) else fact for fact in facts]
        found = asked.solve(asked.problem(scene, Goal(tuple(outside)).in_scene(scene), start))
        if isinstance(found, Solution):
            return found
        ended = ended or found
    return ended or Infeasible(Cause.NO_CLEARANCE_LOCATION, "no support but what opens", Goal(tuple(facts)).held)


def needed(asked: Asked, scene: Scene, goal: Goal, start: Scene) -> tuple[str, ...]:
    """Names of what must be opened before a goal can be reached: as few as will do; none if nothing helps.

    That is what something is to be put into, and what hides something that is to be moved: the lower bound proves that
    no grasp reaches it as the world is, and that one does with a drawer or door open.
    """
    unmet = [fact for fact in goal.facts if isinstance(fact, On | Inside) and not fact.holds(scene, start)]
    into = {fact.place if isinstance(fact, On) else fact.region for fact in unmet}
    into |= {region.support for region in scene.regions if region.name in into}
    first = tuple(one.name for one in _shut_ones(scene) if one.share < _HALF and _is_shut_in(scene, one, into))
    before = scene
    for name in first:
        scene = as_if_opened(scene, name, scene.opening(name).at_share(_FULLY))
    if not _is_known(goal, scene, before) or _is_possible(asked, scene, goal, start):
        return first
    shut = _shut_ones(scene, goal)
    for count in range(1, _MOST + 1):
        for some in itertools.combinations(shut, count):
            opened = scene
            for one in some:
                opened = as_if_opened(opened, one.name, opened.opening(one.name).at_share(_FULLY))
            if _is_known(goal, opened, before) and _is_possible(asked, opened, goal, start):
                return (*first, *(one.name for one in some))
    return first


def helpful(asked: Asked, scene: Scene, goal: Goal, start: Scene) -> str:
    """Name of what must be opened for a goal for which there is no plan as the world is; "" if nothing helps."""
    for one in _shut_ones(scene, goal):
        opened = as_if_opened(scene, one.name, one.at_share(_FULLY))
        if asked.deadline.is_over or not _is_known(goal, opened, scene):
            continue
        if isinstance(asked.solve(asked.problem(opened, goal, start)), Solution):
            return one.name
    return ""


def _shut_ones(scene: Scene, goal: Goal | None = None) -> list[Opening]:
    """What can be opened further: first what is more shut than open, and of it what carries what a goal names."""
    ajar = [one for one in scene.openings if one.share < _FULLY - _FURTHER]
    return sorted(ajar, key=lambda one: (one.share >= _HALF, goal is not None and not _carries(scene, goal, one)))


def _is_shut_in(scene: Scene, opening: Opening, places: Collection[str]) -> bool:
    """Whether one of some places is inside what opens: not the top of a lid, nor a tray with nothing above it."""
    parts = [one for one in scene.static_obstacles if one.name in opening.parts]
    inside = [one for one in parts if opening.name in places or one.name in places]
    return any(not one.has_level_top or is_covered(scene, (*one.position[:2], one.top)) for one in inside)


def _is_known(goal: Goal, scene: Scene, before: Scene) -> bool:
    """Whether a scene has all objects and supports that a goal names: it lacks what stood in the way of something that
    has been opened, and what has been tilted. `before` is the scene before it was opened.
    """
    facts = [fact for fact in goal.facts if isinstance(fact, Holding | On | Inside | At)]
    places = {fact.place if isinstance(fact, On) else fact.region for fact in facts if isinstance(fact, On | Inside)}
    tilted = {*before.supports} - {*scene.supports}
    lost = tilted | {one.name for one in before.regions if one.support in tilted}
    return {fact.object for fact in facts} <= {*scene.names} and not places & lost


def lower_bound_through(asked: Asked, scene: Scene, goal: Goal, start: Scene | None = None) -> LowerBound:
    """The fewest picks and pulls of any plan for a goal in a scene in which something opens.

    Each thing that must be opened or shut is one pull. An object that is put aside for a pull may be one that has to go
    for the rest too: so the greater number of these counts as proved, the sum of both as what is to be expected.
    """
    began, here = start or scene, scene
    rest = _rest_of(goal)
    rest = None if rest is None or rest.holds(scene, began) else rest
    first, last = _wanted(asked, scene, goal, began)
    moves = [(fact.opening, position) for fact, position in first]
    count = len(moves)
    if rest is not None:
        opened = here
        for name, position in moves:
            opened = as_if_opened(opened, name, position)
        moves += [(name, opened.opening(name).at_share(_FULLY)) for name in needed(asked, opened, rest, began)]
    bounds: list[LowerBound] = []
    for name, position in moves:
        best = _least_to_move(asked, here, name, position)
        if best.picks is None:
            return best
        bounds.append(best)
        here = as_if_opened(here, name, position)
    others: list[LowerBound] = []
    if rest is not None:
        others.append(asked.problem(here, rest, began).lower_bound())
        if others[0].picks is None:
            return others[0]
    for fact in last:
        if not fact.holds(here):
            # What is in its way then is not known: only the pull itself is counted, and the count is not exact.
            is_alone = rest is None and not moves
            found = _least_to_move(asked, here, fact.opening, _last_position(here, fact)) if is_alone else None
            if found is not None and found.picks is None:
                return found
            pull = LowerBound(1, (f"{HANDLE_OF}{fact.opening}",), (), False, 1)
            bounds.append(found or pull)
    return _together(bounds, others, len(moves) > count)


def _least_to_move(asked: Asked, scene: Scene, name: str, position: float) -> LowerBound:
    """The fewest picks and pulls with which something is opened or shut, by a handle or by a push."""
    found = [asked.problem(twin, goal_of(twin), None).lower_bound() for twin in _twins(scene, name, position)]
    if all(one.picks is None for one in found):
        pushes = (asked.problem(twin, goal_of(twin), None).lower_bound() for twin in _pushes(scene, name, position))
        found += itertools.islice((one for one in pushes if one.picks is not None), 1)
    if not found:
        is_full = len(scene.objects) >= MAX_OBJECTS
        return LowerBound(None, (name,), (), not is_full, 0, Cause.GIVEN_UP if is_full else Cause.UNREACHABLE)
    return min(found, key=lambda one: (one.picks is None, one.least))


def _together(pulls: Sequence[LowerBound], others: Sequence[LowerBound], hides: bool) -> LowerBound:
    """The bound of a plan with parts that pull handles, and others.

    Where something `hides` what is to be moved, one object at least is moved after the pull, besides those put aside
    for it: nothing reaches it before.
    """
    bounds = (*pulls, *others)
    aside = max((bound.least - 1 for bound in pulls), default=0)
    least = len(pulls) + max([aside + hides, *(bound.least for bound in others)])
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
    bound = asked.problem(scene, goal, start).lower_bound(deadline=asked.deadline, is_exact=False)
    return bound.picks is not None or not bound.proved


def _carries(scene: Scene, goal: Goal, opening: Opening) -> bool:
    """Whether what a goal names stands in something that opens, or is to."""
    named = {value for fact in goal.facts for value in vars(fact).values() if isinstance(value, str)}
    return bool(named & {*carried_by(scene, opening), *opening.parts})


def _further(scene: Scene, fact: Open | Turned) -> float:
    """The position [m] or [rad] to which something is pulled that is to be open by a share, or at an angle."""
    opening, position = scene.opening(fact.opening), fact.position_in(scene)
    if isinstance(fact, Turned):
        return min(max(position, min(opening.shut, opening.open)), max(opening.shut, opening.open))
    share = (position - opening.shut) / (opening.open - opening.shut)
    return opening.at_share(max(min(share + _FURTHER, _FULLY), share))


def _twins(scene: Scene, name: str, position: float) -> Iterator[Scene]:
    """The scenes in which a handle of what opens stands among the objects."""
    latched = latches(scene, name, position)
    for latch in latched or (None,):
        for handle in handles_of(scene, latch.lever if latch else name):
            twin = with_handle(scene, name, position, handle, latch=latch)
            if twin is not None:
                yield twin


def _pushes(scene: Scene, name: str, position: float) -> Iterator[Scene]:
    """The scenes in which parts of what opens that fingers can push stand among the objects.

    First a handle with all that belongs to it, since fingers at its bar touch its posts too; then the broadest part.
    """
    opening = scene.opening(name)
    if latches(scene, name, position):
        return
    faces = [
        (face_against(opening, one, position), one.name) for one in scene.static_obstacles if one.name in opening.parts
    ]
    parts = [(part,) for face, part in sorted(faces, reverse=True) if face > 0.0]
    for some in (opening.handles, *parts) if len(opening.handles) > 1 else parts:
        twin = with_handle(scene, name, position, some, pushes=True)
        if twin is not None:
            yield twin


def _moved_to(asked: Asked, scene: Scene, name: str, position: float) -> Iterator[Solution | Infeasible]:
    """A plan that opens or shuts something, or why there is none; where no hand follows all the way, two plans.

    The second one takes it up where the first one has left it: by another handle, at another place, or from behind.
    """
    found = _moved_at_once(asked, scene, name, position)
    start = scene.opening(name).position
    for share in _LEFT_AT if isinstance(found, Infeasible) and found.cause is Cause.MOTION else ():
        first = _moved_at_once(asked, scene, name, start + share * (position - start))
        if isinstance(first, Solution) and first.end is not None:
            rest = _moved_at_once(asked, first.end, name, position)
            if isinstance(rest, Solution):
                yield replace(first, bound=None)  # one motion may be enough: what two need is no bound
                yield rest
                return
        if asked.deadline.is_over:
            break
    yield found


def _moved_at_once(asked: Asked, scene: Scene, name: str, position: float) -> Solution | Infeasible:
    """A plan that opens or shuts something by one of its handles, else pushes it, or why there is none."""
    opening = scene.opening(name)
    left_at = opening.released(position)
    if abs(left_at - position) > LACKS * abs(opening.open - opening.shut):
        cause, does = (Cause.SPRINGS_SHUT, "shuts") if opening.opens_to(position) else (Cause.SPRINGS_OPEN, "opens")
        detail = f"a spring or its weight {does} {name} when nobody holds it, by {abs(left_at - position):.3g} m or rad"
        return Infeasible(cause, detail, (name,))
    if len(scene.objects) >= MAX_OBJECTS:
        detail = f"to open or shut {name}, its handle would be one more than the {MAX_OBJECTS} objects of a scene"
        return Infeasible(Cause.GIVEN_UP, detail, (name,))
    ended: Infeasible | None = None
    for twin in itertools.chain(_twins(scene, name, position), _pushes(scene, name, position)):
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
    name = "Open" if opening.opens_to(position) else "Close"
    actions = tuple(
        replace(one, name=name, args=(opening.name, *one.args[1:]), target=opening.name) if _is_pull(one) else one
        for one in found.actions
    )
    return replace(found, actions=actions, end=end)


def _is_pull(action: BoundAction) -> bool:
    pull = action.scene.pull
    return action.name == "PickUp" and pull is not None and action.target == pull.handle


def _ended(found: Infeasible, goal: Goal, parts: list[Solution]) -> Infeasible:
    """The end of a search in one of its parts."""
    done = tuple(name for part in parts for name in part.clearances)
    where = f", to open {found.target.removeprefix(HANDLE_OF)}" if found.target.startswith(HANDLE_OF) else ""
    return replace(
        found, detail=found.detail + where, clearances=(*done, *found.clearances), target=goal.target, goal=goal
    )


def _one_plan(parts: list[Solution], goal: Goal, as_it_is: Problem | None, asked: Asked) -> Solution | Infeasible:
    """The parts as one plan; without any, that of the problem `as_it_is`: nothing is to be done."""
    if as_it_is is not None:
        return asked.solve(as_it_is)
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
    bounds = [(part.bound, part.pulls > 0) for part in parts if part.bound is not None]
    pulls, others = [one for one, is_pull in bounds if is_pull], [one for one, is_pull in bounds if not is_pull]
    pulled = {action.target for part in parts for action in part.actions if action.name in ("Open", "Close")}
    hides = bool(others) and bool(pulled - {fact.opening for fact in goal.openings})
    return replace(
        parts[-1],
        bound=_together(pulls, others, hides) if len(bounds) == len(parts) else None,
        actions=tuple(action for part in parts for action in part.actions),
        clearances=tuple(name for part in parts for name in part.clearances),
        stats=total,
        target=goal.target,
        goal=goal,
    )
