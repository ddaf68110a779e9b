"""A plan in less time: what its actions do between two contacts becomes one motion.

Actions keep their names, their order and their phases; where one ends and the next begins, the robot no longer rests.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace

from planners.collision.compiled_scenes import CompiledScenes
from planners.motion.contact_free import ContactFree, merge_phases, phases_of
from planners.motion.trajectory import Trajectory, is_contact, join
from planners.scene import RobotState, Scene
from planners.tamp.solution import BoundAction

__all__ = ["shorten"]


def shorten(
    actions: Sequence[BoundAction], compiled: CompiledScenes, is_accepted: Callable[[Scene, Sequence[Trajectory]], bool]
) -> tuple[BoundAction, ...]:
    """The same plan with shorter motions between contacts, where such are free.

    Args:
        actions: the plan.
        compiled: the scenes compiled so far.
        is_accepted: whether motions in a scene are accepted by the second collision checker, MuJoCo.
    """
    parts = [(index, phase) for index, action in enumerate(actions) for phase in phases_of(action.trajectory)]
    runs = [list(run) for _, run in itertools.groupby(parts, key=lambda part: is_contact(part[1].phases[0]))]
    shorter: list[list[Trajectory]] = [[] for _ in actions]
    for k, run in enumerate(runs):
        phases = [phase for _, phase in run]
        if not is_contact(phases[0].phases[0]):
            motion = ContactFree(phases, begins_in_contact=k > 0, ends_in_contact=k + 1 < len(runs))
            scene = actions[run[-1][0]].scene
            found = merge_phases(compiled.world(scene), motion)
            phases = found if found is not None and is_accepted(scene, [join(found)]) else phases
        for (index, _), phase in zip(run, phases, strict=True):
            shorter[index].append(phase)
    return tuple(_with_trajectory(action, join(pieces)) for action, pieces in zip(actions, shorter, strict=True))


def _with_trajectory(action: BoundAction, trajectory: Trajectory) -> BoundAction:
    """The action with another trajectory; its scene has the robot where that begins."""
    state = RobotState(trajectory.base[0], trajectory.q[0], float(trajectory.finger_position[0]))
    return replace(action, trajectory=trajectory, scene=action.scene.with_state(state))
