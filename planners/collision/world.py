"""Which objects does this configuration hit? The scene compiled for fast checks, one bit per object."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planners.collision.configuration_kernel import Attached, Obstacles
from planners.collision.geometry import BOX
from planners.collision.path_kernel import many_hits, path_hits
from planners.collision.robot_model import RobotArrays, robot_arrays
from planners.collision.scene_arrays import body_bound, body_core, obstacle_arrays
from planners.scene import SELF_BIT, STATIC_BIT, HeldObject, Scene

__all__ = ["PADDING", "STEP", "CollisionWorld"]

PADDING = 0.002
"""[m] that everything keeps from everything."""
STEP = 0.006
"""[m] that a point of the robot may move between two checks: what slips between them is at most 1 mm deep."""
SUPPORT_SLACK = 0.0005
"""[m] The bottom of a held object may press into a static obstacle: an object that rests on the table can be lifted."""
_ALL = (1 << 64) - 1


@dataclass(frozen=True, eq=False)
class CollisionWorld:
    """A scene for collision checks; masks are as in `Scene`: bit i is object i, plus STATIC_BIT and SELF_BIT.

    Attributes:
        scene: what it was made from.
        robot, obstacles: the same as arrays for kernels.
        padding: [m] Nearer counts as a hit.
    """

    scene: Scene
    robot: RobotArrays
    obstacles: Obstacles
    padding: float = PADDING
    _in_hand: dict[int, tuple[HeldObject | None, Attached]] = field(init=False, repr=False, default_factory=dict)

    @classmethod
    def from_scene(cls, scene: Scene, padding: float = PADDING) -> CollisionWorld:
        """Compile a scene. Objects may stand or lie; the robot's head is taken to be in its usual configuration."""
        return cls(scene, robot_arrays(scene.robot), obstacle_arrays(scene), padding)

    def with_padding(self, padding: float) -> CollisionWorld:
        """The same world with another distance to keep [m]."""
        return replace(self, padding=padding)

    def active(self, ignore: int = 0) -> np.uint64:
        """The bits that count when those of `ignore` do not."""
        return np.uint64(_ALL & ~int(ignore))

    def attached(self, held: HeldObject | None) -> Attached:
        """What is in hand, for kernels, remembered; raises `UnknownObject`."""
        known = self._in_hand.get(id(held))
        if known is None:
            known = self._in_hand[id(held)] = held, self._attached(held)
        return known[1]

    def _attached(self, held: HeldObject | None) -> Attached:
        if held is None:
            nothing = np.zeros((2, 3))
            return Attached(-1, BOX, nothing, 0.0, nothing, np.eye(3), np.array(self.robot.reach))
        body = self.scene.body(held.name)
        bound = body_bound(body)
        position, rotation = held.T_tcp_object[:3, 3], np.ascontiguousarray(held.T_tcp_object[:3, :3])
        raised = 0.5 * (self.padding + SUPPORT_SLACK)
        return Attached(
            bit=self.scene.index(held.name),
            core=body_core(body),
            half=np.stack([body.half_extents, body.half_extents - [0.0, 0.0, raised]]),
            bound=bound,
            position=np.stack([position, position + raised * rotation[:, 2]]),
            rotation=rotation,
            reach=np.maximum(self.robot.reach, self.robot.tip_reach + np.linalg.norm(position) + bound),
        )

    def hits(
        self, base: ArrayLike, q: ArrayLike, opening: float, held: HeldObject | None = None, ignore: int = 0
    ) -> int:
        """What one configuration hits.

        Args:
            base: (3,) x [m], y [m], yaw [rad].
            q: (8,) torso [m] and arm [rad].
            opening: of the gripper [m].
            held: what is in hand; it moves with the TCP and is no obstacle.
            ignore: bits that do not count.
        """
        return int(self.hits_many(base, np.asarray(q, dtype=float)[None], opening, held, ignore)[0])

    def hits_many(
        self, base: ArrayLike, Q: ArrayLike, opening: float, held: HeldObject | None = None, ignore: int = 0
    ) -> NDArray[np.uint64]:
        """What each configuration of `Q` (k, 8) hits at one base pose: (k,); see `hits`."""
        place, rows = np.array(base, dtype=float), np.array(Q, dtype=float, order="C")
        arguments = self.robot, self.obstacles, self.attached(held), place, rows
        hits: NDArray[np.uint64] = many_hits(*arguments, float(opening), self.active(ignore), self.padding)
        return hits

    def path_hits(
        self,
        X: ArrayLike,
        opening: float,
        held: HeldObject | None = None,
        ignore: int = 0,
        step: float = STEP,
        first_only: bool = False,
    ) -> int:
        """What a piecewise straight motion through whole-body configurations `X` (k, 11), base and `q`, hits.

        No point moves more than `step` [m] between two checks. `first_only`: some of what it hits will do, if anything.
        """
        rows = np.array(X, dtype=float, order="C")
        arguments = self.robot, self.obstacles, self.attached(held), rows
        return int(path_hits(*arguments, float(opening), self.active(ignore), self.padding, step, first_only))

    def names_of(self, mask: int) -> tuple[str, ...]:
        """The objects, "a static obstacle" and "the robot itself", whose bits are set."""
        special = (("a static obstacle", STATIC_BIT), ("the robot itself", SELF_BIT))
        return (*self.scene.names_of(mask), *(name for name, bit in special if int(mask) >> bit & 1))
