"""The motion behind an action, as the motion layer answers it."""

from __future__ import annotations

from dataclasses import dataclass

from planners.motion.trajectory import Trajectory
from planners.placing.surfaces import Surface
from planners.scene import Scene

__all__ = ["BoundMotion"]


@dataclass(frozen=True, eq=False)
class BoundMotion:
    """A motion behind an action, and the scene it leaves.

    Attributes:
        trajectory: the verified motion.
        scene: the scene after it.
        surfaces: of a put-down: the supports that were looked at, with the regions that the object keeps out of.
        location: where a base motion leads to a put-down: the symbol of the location.
        put_down: and the put-down itself, which is planned before the base moves there.
        before: the scene in which the motion was planned, with its arm active.
    """

    trajectory: Trajectory
    scene: Scene
    location: str = ""
    put_down: BoundMotion | None = None
    surfaces: tuple[Surface, ...] = ()
    before: Scene | None = None
