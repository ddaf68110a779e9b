"""Planning ahead: the whole sequence is chosen before the first motion: which objects, grasps, order and placements.

Strategies that do not plan ahead commit to grasps only. Planning ahead simulates the clearances one after another, puts
each object where it obstructs nothing that remains to be done, and turns to other grasps, another order or another set
of objects where some object finds no placement.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from types import MappingProxyType

import numpy as np

from planners.cause import Cause
from planners.clearing.clearance_plan import (
    ClearancePlan,
    ClearingProblem,
    IsUsable,
    OrderByTaskPlan,
    RejectedGrasps,
    Turn,
)
from planners.clearing.commitments import (
    Commitments,
    NoCommitment,
    greedy_commitments,
    smallest_commitments,
    varied_commitments,
)
from planners.clearing.holding_aside import held_aside
from planners.clearing.saving_time import with_blockers, with_less_time
from planners.collision.world import CollisionWorld
from planners.grasping.candidates import GraspCandidate
from planners.motion.arm import tcp_pose
from planners.placing.negative_goal_region import SupportGrid, swept_mask
from planners.placing.placements import Placement
from planners.placing.surfaces import KeepClear
from planners.placing.swept_volume import standing_volume
from planners.scene import HeldObject, RobotState, Scene, StaticObstacle
from planners.scene.cover import drive_out
from planners.strategies import Strategy

__all__ = [
    "ClearancePlan",
    "ClearingProblem",
    "IsUsable",
    "OrderByTaskPlan",
    "RejectedGrasps",
    "Turn",
    "alternatives",
    "commitments_for",
    "grasped",
    "keep_clear",
    "simulate_clearance",
    "simulate_until_stuck",
]

_CELL = 0.02
"""[m] of the cells in which swept space is compared."""


def commitments_for(
    problem: ClearingProblem, order_by_task_plan: OrderByTaskPlan, is_usable: IsUsable
) -> ClearancePlan | NoCommitment | RejectedGrasps:
    """The first commitments of the strategy, or, planned ahead, the first whose objects all find placements.

    Args:
        problem: what to choose for and from.
        order_by_task_plan: puts commitments in the order in which the task planner will carry them out.
        is_usable: whether a grasp can be used at all. It is asked about few, before placements are looked for; the
            candidates must not offer those named in `RejectedGrasps` again when this function is called again.

    Returns:
        the plan; the grasps to take out of the candidates; or why there is no plan.
    """
    without_placement = problem.target
    for commitments in alternatives(problem):
        if problem.deadline.is_over:
            break
        if isinstance(commitments, NoCommitment):
            return commitments
        if unusable := tuple(grasp for grasp in commitments.grasps.values() if not is_usable(problem.scene, grasp)):
            return RejectedGrasps(unusable)
        if not problem.strategy.plans_ahead:
            return ClearancePlan(commitments)
        commitments = order_by_task_plan(commitments)
        plan = _simulate_clearances(problem, commitments)
        if problem.holds_aside and (isinstance(plan, str) or plan.moves) and not problem.scene.held_names:
            aside = _simulate_holding_aside(problem, commitments)
            if aside is not None and (isinstance(plan, str) or aside.moves < plan.moves):
                return aside
        if not isinstance(plan, str):
            return plan
        without_placement = plan
    if problem.deadline.is_over:
        return NoCommitment(Cause.TIME_LIMIT, (problem.target,), proved=False)
    return NoCommitment(Cause.NO_CLEARANCE_LOCATION, (without_placement,), proved=False)


def alternatives(problem: ClearingProblem) -> Iterator[Commitments | NoCommitment]:
    """Commitments to one set of objects after another, each followed by other orders and grasps for the same objects.

    Greedy strategies yield one.
    """
    strategy, candidates, scene = problem.strategy, problem.candidates, problem.scene
    sets: Iterator[Commitments | NoCommitment]
    if strategy.grasps == "greedy":
        sets = iter((greedy_commitments(candidates, scene, problem.target, problem.deadline),))
    else:
        limits, deadline = problem.limits, problem.deadline
        sets = smallest_commitments(
            candidates, scene, problem.target, slack=strategy.slack, limits=limits, deadline=deadline
        )
    swept_cells = _swept_cells(problem.compiled.world(scene), problem.placements.supports_in(scene))
    for commitments in itertools.islice(sets, strategy.sets):
        yield commitments
        if isinstance(commitments, Commitments) and commitments.order:
            for _ in range(strategy.variations):
                yield varied_commitments(candidates, scene, commitments, problem.rng, swept_cells)


def _swept_cells(world: CollisionWorld, supports: Sequence[StaticObstacle]) -> Callable[[GraspCandidate], int]:
    """What the robot occupies at each grasp of the space that objects stand in, as bits, one for each cell; cached.

    It stands for what the grasp sweeps, which would take too long to work out for all grasps that are compared.
    """
    grids = [SupportGrid.over(support, _CELL) for support in supports]
    tallest = max(body.top - body.bottom for body in world.scene.objects)
    known: dict[tuple[str, bytes, bytes], int] = {}

    def swept_cells(grasp: GraspCandidate) -> int:
        """The cells that one grasp sweeps."""
        if grasp.key not in known:
            volume = standing_volume(world, grasp)
            cells = np.concatenate([swept_mask(grid, volume, tallest).ravel() for grid in grids])
            known[grasp.key] = int.from_bytes(np.packbits(cells).tobytes(), "big")
        return known[grasp.key]

    return swept_cells


def keep_clear(strategy: Strategy, commitments: Commitments, moving: str) -> KeepClear:
    """The grasps that a cleared object must keep clear of: those of NGR1, of NGR1 + NGR2, or none (eq. 1-3)."""
    if strategy.region == "none":
        return KeepClear()
    target = commitments.grasps[commitments.target]
    if strategy.region == "ngr1":
        return KeepClear(target)
    others = (grasp for name, grasp in commitments.grasps.items() if name not in (moving, commitments.target))
    return KeepClear(target, tuple(others))


def grasped(scene: Scene, grasp: GraspCandidate) -> Scene:
    """The scene after a grasp: its arm holds the object, at home, the robot where it took it or drove out to."""
    scene = scene.using(grasp.arm)
    T_world_tcp = tcp_pose(scene.robot, RobotState(grasp.base, grasp.q, 0.0))
    held = HeldObject.grasped(scene.body(grasp.object), T_world_tcp)
    base = drive_out(scene.support, grasp.base, T_world_tcp)[-1] if grasp.drives else grasp.base
    state = RobotState(base, np.array(scene.robot.home), scene.state.finger_position)
    return scene.with_state(state).with_held(held)


def _simulate_clearances(problem: ClearingProblem, commitments: Commitments) -> ClearancePlan | str:
    """A placement for every object to clear, found by simulating the clearances in order; or the object without one."""
    names = (*problem.scene.held_names, *commitments.order)
    turns, placements = simulate_until_stuck(problem, commitments, names)
    if len(placements) < len(names):
        return names[len(placements)]
    if problem.saves_time:
        last = with_less_time(problem.grasps, turns[-1].scene, commitments, commitments.target)
        commitments = _as_taken(problem, commitments, turns, last.grasps[commitments.target])
        names = (*problem.scene.held_names, *commitments.order)
        placements = {name: placements[name] for name in names}
    return ClearancePlan(commitments, MappingProxyType(placements), moves=len(placements))


def _as_taken(
    problem: ClearingProblem, commitments: Commitments, turns: Sequence[Turn], *others: GraspCandidate
) -> Commitments:
    """The commitments with the grasps chosen turn by turn and others, to those objects that are in the way of these.

    What is in the way is worked out for the present scene: grasps chosen later may need fewer objects cleared.
    """
    taken = dict(commitments.grasps)
    for turn in turns:
        taken |= turn.remaining.grasps
    taken |= {grasp.object: grasp for grasp in others}
    known = {grasp.object: grasp for grasp in with_blockers(problem.grasps, problem.scene, taken.values())}
    kept, frontier = {commitments.target}, [commitments.target]
    while frontier:
        blockers = set(problem.scene.names_of(known[frontier.pop()].blockers)) - kept
        kept |= blockers
        frontier += sorted(blockers)
    order = tuple(name for name in commitments.order if name in kept)
    return Commitments(
        commitments.target, order, MappingProxyType({name: known[name] for name in known if name in kept})
    )


def _simulate_holding_aside(problem: ClearingProblem, commitments: Commitments) -> ClearancePlan | None:
    """A plan in which the last obstacle is held while another arm takes the target; None if none is found."""
    *first, last = commitments.order
    turns, placements = simulate_until_stuck(problem, commitments, first)
    if len(placements) < len(first):
        return None
    scene, remaining = turns[-1]
    held = held_aside(problem.grasps, scene, remaining, grasped)
    if held is None:
        return None
    commitments = _as_taken(problem, commitments, turns, *held.grasps.values())
    placements = {name: placements[name] for name in first if name in commitments.order}
    return ClearancePlan(commitments, MappingProxyType(placements), moves=len(placements), aside=last)


def simulate_until_stuck(
    problem: ClearingProblem, commitments: Commitments, names: Sequence[str]
) -> tuple[list[Turn], dict[str, Placement]]:
    """Clear objects in order, up to the first that finds no location.

    Args:
        problem: where placements come from.
        commitments: at the start.
        names: of the objects.

    Returns:
        the turns, one more than there are placements; the placements, in order.
    """
    turns = [Turn(problem.scene, commitments)]
    placements: dict[str, Placement] = {}
    for name in names:
        scene, remaining = turns[-1]
        if problem.saves_time and name in remaining.order:
            remaining = with_less_time(problem.grasps, scene, remaining, name)
            turns[-1] = Turn(scene, remaining)
        done = simulate_clearance(problem, scene, remaining, name, keep_clear(problem.strategy, remaining, name))
        if done is None:
            break
        placements[name] = done[0]
        turns.append(Turn(done[1], remaining.without(name)))
    return turns, placements


def simulate_clearance(
    problem: ClearingProblem, scene: Scene, commitments: Commitments, name: str, keep: KeepClear
) -> tuple[Placement, Scene] | None:
    """The first placement of an object that is taken through the grasp committed to, and the scene after it.

    Args:
        problem: where placements come from.
        scene: before the clearance; the object may be held already.
        commitments: its grasp is one of them.
        name: of the object.
        keep: what the object must not stand in the way of.
    """
    in_hand = scene.holding(name) or grasped(scene, commitments.grasps[name])
    world = problem.compiled.world(in_hand)
    placement = next(problem.placements.find(world, keep, problem.strategy, problem.rng, problem.deadline), None)
    if placement is None:
        return None
    state = RobotState(placement.base, in_hand.state.q, in_hand.state.finger_position)
    return placement, in_hand.with_held(None).with_body(placement.body).with_state(state)
