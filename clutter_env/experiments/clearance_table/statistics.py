"""From trials to the rows of the clearance table: paired by scene, with 95% intervals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest

from clutter_env.experiments.clearance_table.effort import Effort, effort_of
from clutter_env.experiments.clearance_table.trials import Assessment, Attempt
from clutter_env.reporting.intervals import Interval, Times, bootstrap, times, wilson

__all__ = ["CRASH", "Row", "Scenes", "Shared", "make_row", "make_shared", "mcnemar", "summarise_scenes"]

CRASH = "crash"
"""Cause of an attempt that ended in an exception or a dead process; it says nothing about the strategy."""


@dataclass(frozen=True)
class Scenes:
    """The scenes with one number of objects; "floor" is the minimum number of clearances of a scene.

    Attributes:
        objects: number of objects on the table.
        seeds: number of resets that were assessed.
        obstructed: scenes in which something has to be cleared before a level gripper takes the target.
        free: scenes in which nothing has to be.
        without_set: scenes for which it is proved that no self-clearable set exists.
        unreachable: scenes whose target no grasp reaches.
        crashed: scenes that could not be assessed.
        unproved: obstructed scenes whose floor is only an upper bound.
        floor: over the obstructed scenes with a proved floor.
        floor_time: CPU time of its computation.
    """

    objects: int
    seeds: int
    obstructed: int
    free: int
    without_set: int
    unreachable: int
    crashed: int
    unproved: int
    floor: Interval
    floor_time: Times


@dataclass(frozen=True)
class Row:
    """One strategy on the scenes of the table with one number of objects.

    Attributes:
        objects: number of objects on the table.
        strategy: its name.
        scenes: number of attempts without those that crashed.
        crashed: number of attempts that crashed; they are counted nowhere else.
        solved: number of scenes solved.
        success: share of `scenes` that are solved, with Wilson's interval.
        lifted: share of `scenes` whose target was lifted, whatever else moved; of interest in physics only.
        clearances: objects cleared, over the solved scenes.
        duplicated: objects cleared twice or more, over the solved scenes.
        ratio: clearances divided by the floor, over the solved scenes with a proved floor of at least 1.
        at_floor: share of the solved scenes with a proved floor with exactly as many clearances as the floor.
        both: number of scenes that the reference strategy solved too.
        both_clearances: mean clearances of this strategy on those scenes.
        both_reference: mean clearances of the reference strategy on those scenes.
        difference: clearances minus those of the reference strategy, over those scenes.
        censored: clearances over all scenes, each counted as at most the cap, and an unsolved scene as the cap.
        p_success: p value of McNemar's exact test for a difference in success from the reference strategy; NaN for
            the reference strategy itself.
        replans: over all scenes.
        total: CPU time of a whole solve.
        task: CPU time of the task planning in it.
        motion: CPU time of the motion planning in it.
        task_call: CPU time of one call of the task planner.
        causes: of failures, with counts.
        effort: base motions and simulated time, over the scenes that the reference strategy solved too.
    """

    objects: int
    strategy: str
    scenes: int
    crashed: int
    solved: int
    success: Interval
    lifted: Interval
    clearances: Interval
    duplicated: Interval
    ratio: Interval
    at_floor: float
    both: int
    both_clearances: float
    both_reference: float
    difference: Interval
    censored: Interval
    p_success: float
    replans: Interval
    total: Times
    task: Times
    motion: Times
    task_call: Times
    causes: Mapping[str, int]
    effort: Effort


@dataclass(frozen=True)
class Shared:
    """One strategy on the scenes, with one number of objects, that every strategy solved and whose floor is proved.

    Attributes:
        objects: number of objects on the table.
        strategy: its name.
        scenes: number of these scenes; the same for all strategies.
        floor: mean minimum number of clearances of these scenes; the same for all strategies.
        clearances: objects cleared.
        duplicated: objects cleared twice or more.
    """

    objects: int
    strategy: str
    scenes: int
    floor: float
    clearances: Interval
    duplicated: Interval


def make_shared(
    attempts: Mapping[str, Mapping[int, Attempt]], floors: Mapping[int, int], objects: int, seed: int
) -> list[Shared]:
    """All strategies, and the floor, on the same scenes.

    Args:
        attempts: by strategy, then by seed of the scene.
        floors: proved minimum numbers of clearances by seed of the scene.
        objects: number of objects on the table.
        seed: of the bootstrap.

    Returns:
        One entry a strategy; none if no scene was solved by all of them.
    """
    solved = [{k for k, attempt in own.items() if attempt.solved} for own in attempts.values()]
    scenes = sorted(set(floors).intersection(*solved)) if solved else []
    if not scenes:
        return []
    floor = _mean([floors[k] for k in scenes])
    return [
        Shared(
            objects,
            name,
            len(scenes),
            floor,
            bootstrap([[len(own[k].clearances) for k in scenes]], np.random.default_rng(seed)),
            bootstrap([[own[k].duplicated for k in scenes]], np.random.default_rng(seed)),
        )
        for name, own in attempts.items()
    ]


def summarise_scenes(objects: int, found: Sequence[Assessment], seed: int) -> Scenes:
    """Count the scenes with one number of objects by the result of their assessment; `seed` is of the bootstrap."""
    obstructed = [scene for scene in found if scene.is_obstructed]
    proved = [scene.floor for scene in obstructed if scene.proved and scene.floor is not None]
    causes = Counter(scene.cause for scene in found if scene.floor is None)
    crashed = causes.pop(CRASH, 0)
    unreachable = causes.pop("unreachable", 0)
    return Scenes(
        objects=objects,
        seeds=len(found),
        obstructed=len(obstructed),
        free=sum(scene.side_floor == 0 for scene in found),
        without_set=causes.total(),
        unreachable=unreachable,
        crashed=crashed,
        unproved=len(obstructed) - len(proved),
        floor=bootstrap([proved], np.random.default_rng(seed)),
        floor_time=times([scene.floor_s for scene in found]),
    )


def make_row(
    own: Mapping[int, Attempt],
    reference: Mapping[int, Attempt],
    floors: Mapping[int, int],
    cap: int,
    seed: int,
) -> Row:
    """The row of one strategy.

    Args:
        own: its attempts by seed of the scene, at least one.
        reference: those of the strategy that it is compared with; may be `own` itself.
        floors: proved minimum numbers of clearances by seed of the scene.
        cap: number of clearances that an unsolved scene counts as.
        seed: of the bootstrap.
    """
    rng = np.random.default_rng(seed)
    first = next(iter(own.values()))
    ended = {k: attempt for k, attempt in own.items() if attempt.cause != CRASH}
    solved = {k: attempt for k, attempt in ended.items() if attempt.solved}
    both = [k for k in solved if k in reference and reference[k].solved]
    floored = [(len(solved[k].clearances), floors[k]) for k in solved if k in floors]
    return Row(
        objects=first.objects,
        strategy=first.strategy,
        scenes=len(ended),
        crashed=len(own) - len(ended),
        solved=len(solved),
        success=wilson(len(solved), len(ended)),
        lifted=wilson(sum(attempt.lifted for attempt in ended.values()), len(ended)),
        clearances=bootstrap([[len(attempt.clearances) for attempt in solved.values()]], rng),
        duplicated=bootstrap([[attempt.duplicated for attempt in solved.values()]], rng),
        ratio=bootstrap([[count / floor for count, floor in floored if floor]], rng),
        at_floor=_mean([float(count <= floor) for count, floor in floored]),
        both=len(both),
        both_clearances=_mean([len(own[k].clearances) for k in both]),
        both_reference=_mean([len(reference[k].clearances) for k in both]),
        difference=bootstrap([[len(own[k].clearances) - len(reference[k].clearances) for k in both]], rng),
        censored=bootstrap([[min(len(a.clearances), cap) if a.solved else cap for a in ended.values()]], rng),
        p_success=np.nan if own is reference else mcnemar(ended, reference),
        replans=bootstrap([[attempt.replans for attempt in ended.values()]], rng),
        total=times([attempt.total_s for attempt in ended.values()]),
        task=times([attempt.task_planning_s for attempt in ended.values()]),
        motion=times([attempt.motion_planning_s for attempt in ended.values()]),
        task_call=times([a.task_planning_s / a.task_plans for a in ended.values() if a.task_plans]),
        causes=Counter(attempt.cause for attempt in ended.values() if not attempt.solved),
        effort=effort_of(solved, reference, rng),
    )


def mcnemar(own: Mapping[int, Attempt], reference: Mapping[int, Attempt]) -> float:
    """Two-sided p value of McNemar's exact test that both strategies solve the same share of the scenes.

    The test is binomial over the scenes that only one of the two solves; NaN if no scene was tried by both.
    """
    shared = [(own[k].solved, reference[k].solved) for k in own if k in reference and reference[k].cause != CRASH]
    only_own = sum(mine and not theirs for mine, theirs in shared)
    only_reference = sum(theirs and not mine for mine, theirs in shared)
    if not only_own + only_reference:
        return 1.0 if shared else np.nan
    return float(binomtest(only_own, only_own + only_reference).pvalue)


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else np.nan
