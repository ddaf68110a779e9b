"""Grasps that the gripper can leave again with the object: worked out once for each place of the object."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

from planners.collision.world import CompiledScenes
from planners.grasping.candidates import GraspCandidate
from planners.motion.pick_and_place import can_leave, fewest_blockers
from planners.scene import Scene

__all__ = ["UsableGrasps"]

Key: TypeAlias = tuple[tuple[str, bytes, bytes], bytes]


@dataclass(frozen=True)
class UsableGrasps:
    """Whether grasps can be used at all, asked among one set of static obstacles.

    Attributes:
        compiled: the scenes compiled so far.
    """

    compiled: CompiledScenes
    _can_leave: dict[Key, bool] = field(default_factory=dict, init=False, repr=False)

    def __call__(self, scene: Scene, grasp: GraspCandidate) -> bool:
        """Whether the gripper can leave a grasp again; under a board also whether it knows all that is in its way.

        In the open, other objects do not count: they can be cleared. So the answer is remembered for the place of the
        object.
        """
        world = self.compiled.world(scene).for_arm(grasp.arm)
        if grasp.drives:
            blockers = fewest_blockers(world, grasp.base, grasp.q, grasp.object)
            return blockers is not None and not blockers & ~grasp.blockers
        key = grasp.key, scene.body(grasp.object).pose.tobytes()
        if key not in self._can_leave:
            self._can_leave[key] = can_leave(world, grasp.base, grasp.q, grasp.object)
        return self._can_leave[key]
