"""Which objects does this configuration hit? The scene compiled for fast checks, one bit per object."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planners.collision.configuration_kernel import Attached, Obstacles
from planners.collision.geometry import BOX, CYLINDER, Solids
from planners.collision.path_kernel import many_hits, path_hits
from planners.collision.robot_model import RobotArrays, robot_arrays
from planners.scene import FURNITURE_BIT, SELF_BIT, Body, HeldObject, Scene

__all__ = ["PADDING", "STEP", "CollisionWorld"]

PADDING = 0.002
"""[m] that everything keeps from everything."""
STEP = 0.006
"""[m] that a point of the robot may move between two checks: what slips between them is at most 1 mm deep."""
SUPPORT_SLACK = 0.0005
"""[m] The bottom of an object in hand may press into furniture: one that rests on the table can be lifted from it."""
_ALL = (1 << 64) - 1


@dataclass(frozen=True, eq=False)
class CollisionWorld:
    """A scene for collision checks; masks are as in `Scene`: bit i is object i, plus FURNITURE_BIT and SELF_BIT.

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
        return cls(scene, robot_arrays(scene.robot), _obstacles(scene), padding)

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
        bound = _bounding_radius(body)
        position, rotation = held.T_tcp_object[:3, 3], np.ascontiguousarray(held.T_tcp_object[:3, :3])
        raised = 0.5 * (self.padding + SUPPORT_SLACK)
        return Attached(
            bit=self.scene.index(held.name),
            core=_core(body),
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
        """The objects, and "furniture" and "robot", whose bits are set."""
        special = (("furniture", FURNITURE_BIT), ("robot", SELF_BIT))
        return (*self.scene.names_of(mask), *(name for name, bit in special if int(mask) >> bit & 1))


def _core(body: Body) -> int:
    return CYLINDER if body.shape == "cylinder" else BOX


def _bounding_radius(body: Body) -> float:
    """[m] of the sphere about a body's centre that contains it."""
    half = body.half_extents
    return float(np.hypot(half[0], half[2]) if body.shape == "cylinder" else np.linalg.norm(half))


def _obstacles(scene: Scene) -> Obstacles:
    bodies, furniture = scene.objects, sorted(scene.furniture, key=lambda box: -box.top)
    corners = np.array(
        [(*(b.position[:2] + s * b.radius), b.top if s > 0 else b.bottom) for b in bodies for s in (-1, 1)]
    )
    nowhere = np.full((1, 3), np.inf)
    return Obstacles(
        objects=Solids(
            core=np.array([_core(body) for body in bodies], dtype=np.int64),
            half=_rows([body.half_extents for body in bodies]),
            radius=np.zeros(len(bodies)),
            bound=np.array([_bounding_radius(body) for body in bodies], dtype=float),
            position=_rows([body.position for body in bodies]),
            rotation=np.array([body.rotation for body in bodies]).reshape(-1, 3, 3),
        ),
        radius=np.array([body.radius for body in bodies], dtype=float),
        bottom=np.array([body.bottom for body in bodies], dtype=float),
        top=np.array([body.top for body in bodies], dtype=float),
        lower=(corners if bodies else nowhere).min(axis=0),
        upper=(corners if bodies else nowhere).max(axis=0),
        furniture=Solids(
            core=np.full(len(furniture), BOX, dtype=np.int64),
            half=_rows([box.half_extents for box in furniture]),
            radius=np.zeros(len(furniture)),
            bound=np.array([np.linalg.norm(box.half_extents) for box in furniture], dtype=float),
            position=_rows([box.position for box in furniture]),
            rotation=np.tile(np.eye(3), (len(furniture), 1, 1)),
        ),
    )


def _rows(vectors: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    return np.array(vectors, dtype=float).reshape(-1, 3)
