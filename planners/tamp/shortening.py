"""A plan in less time: what its actions do between two contacts becomes one motion.

Actions keep their names, their order and their phases; where one ends and the next begins, the robot no longer rests.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace

from planners.collision.world import CompiledScenes
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
    runs = [list(run) for _, run in itertools.groupby(parts, key=lambda part: _kind(actions[part[0]], part[1]))]
    in_contact = [is_contact(run[0][1].phases[0]) for run in runs]
    shorter: list[list[Trajectory]] = [[] for _ in actions]
    for k, run in enumerate(runs):
        phases = [phase for _, phase in run]
        if not in_contact[k]:
            motion = ContactFree(phases, k > 0 and in_contact[k - 1], k + 1 < len(runs) and in_contact[k + 1])
            scene = actions[run[-1][0]].scene
            found = merge_phases(compiled.world(scene), motion)
            phases = found if found is not None and is_accepted(scene, [join(found)]) else phases
        for (index, _), phase in zip(run, phases, strict=True):
            shorter[index].append(phase)
    return tuple(_with_trajectory(action, join(pieces)) for action, pieces in zip(actions, shorter, strict=True))


def _kind(action: BoundAction, phase: Trajectory) -> tuple[str, bool]:
    """What phases of one motion have in common: the arm, and whether it is a contact."""
    return action.scene.robot.arm_name, is_contact(phase.phases[0])


def _with_trajectory(action: BoundAction, trajectory: Trajectory) -> BoundAction:
    """The action with another trajectory; its scene has the robot where that begins."""
    state = RobotState(trajectory.base[0], trajectory.q[0], float(trajectory.finger_position[0]))
    return replace(action, trajectory=trajectory, scene=action.scene.with_state(state))
