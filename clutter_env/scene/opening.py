"""Furniture that opens: drawers in a chest, and a door in front of shelves. Each has one joint and a bar as its handle.

All positions are those of the closed state, in the world frame of `layout`. A drawer slides towards the robot. A door
swings towards the robot about its hinges. The joint is 0 when closed, and positive values open it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

Point = tuple[float, float, float]

DRAWER, DOOR = "drawer", "door"
"""Names of the moving bodies."""
DRAWERS = ("left_drawer", "middle_drawer", "right_drawer")
"""Names of the bodies of drawers side by side, as the robot sees them."""
CHEST_TOP = "chest_top"
"""Name of the box above a drawer."""
DRAWER_TRAVEL = 0.30
"""[m]"""
DOOR_TRAVEL = math.radians(100.0)
"""[rad]"""
DRAWER_HEADROOM = 0.15
"""[m] from the floor of a closed drawer to the face above it."""
DRAWER_LEVEL = 0.03
"""[m] Height of a drawer's floor above the table on which its chest stands."""
LEAST_CHEST_DEPTH = 0.39
"""[m] Least depth of a chest: the drawer and a panel behind it."""
FRICTION_RANGE, DAMPING_RANGE = (0.5, 4.0), (1.0, 5.0)
"""Dry friction of runners and hinges: [N] of a drawer, [N m] of a door. Damping: [N s/m] of a drawer, [N m s] of a
door."""

_PANEL = 0.02
"""[m] Thickness of the panels of a chest, of doors and of a drawer's front."""
_WALL, _WALL_HEIGHT, _FLOOR = 0.012, 0.08, 0.01
"""[m] Thickness of a drawer's walls, their height above its floor, and the floor's thickness."""
_SLIT = 0.004
"""[m] Gap between moving and fixed parts."""
_OVERLAP = 0.008
"""[m] by which the fronts of drawers side by side overlap the edge of the chest's top. Over a lower front a camera
would see the objects through the slit."""
_DRAWER_LENGTH = 0.34
"""[m] Inner length of a drawer."""
_MARGIN = 0.04
"""[m] Width of the strips along a drawer's walls and front that are empty at the start, with room for a finger."""
_SHOWN = 0.18
"""[m] Length of the region behind this strip in which objects stand. In an open drawer a hand reaches them from
above."""
_BAR_HALF_THICKNESS, _BAR_HALF_WIDTH = 0.010, 0.012
"""[m] Half extents of a handle's bar towards the robot, and across, where fingers close on it."""
_BAR_DISTANCE = 0.05
"""[m] from the face behind it to the middle of the bar. Fingers fit between."""
_DRAWER_BAR, _LONGEST_BAR = 0.055, 0.12
"""[m] Half lengths of bars."""
_BAR_SHARE = 1 / 6
"""Half length of a door's bar over the height of the door."""
_BAR_HEIGHT = 0.95
"""[m] Largest height above the ground of the middle of a door's bar."""
_BAR_MARGIN = 0.05
"""[m] from the edge of a door to the middle of its bar."""
_POST_HALF_WIDTH = 0.006
"""[m] Half width of the two posts that carry a bar."""


class Box(NamedTuple):
    """An axis-aligned piece of furniture: centre and half extents, each (3,) [m]."""

    name: str
    position: Point
    half_extents: Point


class Surface(NamedTuple):
    """A rectangle on which objects stand at the start.

    Attributes:
        level: [m] height above the table top.
        centre, half_extents: (2,) [m] along x and y.
        headroom: [m] to the lowest obstacle above it, infinite if the space is open.
        gap: [m] least distance between the bounding circles of two objects on it.
    """

    level: float
    centre: tuple[float, float]
    half_extents: tuple[float, float]
    headroom: float
    gap: float


@dataclass(frozen=True)
class Opening:
    """A drawer or a door: the moving part of the furniture, in its closed state, in the world frame.

    Attributes:
        name: of its body. The names of its joint, "<name>_joint", and of the bar of its handle, "<name>_handle", begin
            with it.
        is_slide: whether it slides along its axis. Otherwise it turns about the axis.
        origin: (3,) [m] on the axis.
        axis: (3,) opening direction, or axis of the opening rotation.
        travel: [m] or [rad] from closed to open.
        parts: its boxes without the handle.
        handle: the bar, and the posts that carry it.
        inside: (2, 3) [m] lowest and highest corner of the space that moves with it. For a door both are the origin.
    """

    name: str
    is_slide: bool
    origin: Point
    axis: Point
    travel: float
    parts: tuple[Box, ...]
    handle: tuple[Box, ...]
    inside: tuple[Point, Point]

    @property
    def joint(self) -> str:
        """Name of its joint."""
        return f"{self.name}_joint"

    @property
    def bar(self) -> str:
        """Name of the bar by which it is opened."""
        return self.handle[0].name


def floor_of(name: str) -> str:
    """Name of a drawer's floor, the box on which the objects inside stand."""
    return f"{name}_floor"


def chest(front: float, back: float, width: float, table: float, count: int = 1) -> tuple[Box, ...]:
    """Fixed panels of a chest around drawers side by side.

    Args:
        front, back: [m] along x.
        width: [m] outer width.
        table: [m] height of the table on which it stands.
        count: number of drawers. Two panels separate neighbours.
    """
    half, middle, half_depth = _PANEL / 2, (front + back) / 2, (back - front) / 2
    bottom, top = table, table + DRAWER_LEVEL + DRAWER_HEADROOM
    z, half_height, side = (bottom + top) / 2, (top - bottom) / 2, width / 2 - half
    return (
        Box("chest_left", (middle, side, z), (half_depth, half, half_height)),
        Box("chest_right", (middle, -side, z), (half_depth, half, half_height)),
        *(
            Box(f"chest_divider_{number}", (middle, y, z), (half_depth, _PANEL, half_height))
            for number, y in enumerate(width / count * (place - count / 2) for place in range(count - 1, 0, -1))
        ),
        Box("chest_back", (back - half, 0.0, z), (half, width / 2 - _PANEL, half_height)),
        Box(CHEST_TOP, (middle, 0.0, top + half), (half_depth, width / 2, half)),
    )


def drawer(front: float, width: float, table: float) -> Opening:
    """Single drawer of a `chest`."""
    return _drawer(DRAWER, front, 0.0, width, width, table)


def drawers(front: float, width: float, table: float) -> tuple[Opening, ...]:
    """Drawers of a `chest` with `DRAWERS` side by side, from left to right."""
    each = width / len(DRAWERS)
    return tuple(
        _drawer(name, front, y, each, each - _SLIT, table, _OVERLAP)
        for name, y in zip(DRAWERS, _middles(width), strict=True)
    )


def _middles(width: float) -> tuple[float, ...]:
    """Centres [m] along y of drawers side by side in a chest of this width."""
    each = width / len(DRAWERS)
    return tuple(each * ((len(DRAWERS) - 1) / 2 - number) for number in range(len(DRAWERS)))


def _drawer(
    name: str, front: float, y: float, width: float, front_width: float, table: float, overlap: float = 0.0
) -> Opening:
    """Drawer with its centre at y. The chest around it is `width` [m] wide, and its front is `overlap` [m] higher."""
    half_width, floor = width / 2 - _PANEL - _SLIT, table + DRAWER_LEVEL
    face = front - _SLIT - _PANEL
    low, high = table + _SLIT, table + DRAWER_LEVEL + DRAWER_HEADROOM
    z, half = (low + high) / 2, _PANEL / 2
    start, end = front - _SLIT, front + _DRAWER_LENGTH + _WALL
    middle, half_length = (start + end) / 2, (end - start) / 2
    wall_z, wall_half = floor + _WALL_HEIGHT / 2, _WALL_HEIGHT / 2
    parts = (
        Box(
            f"{name}_front",
            (face + half, y, z + overlap / 2),
            (half, front_width / 2, (high + overlap - low) / 2),
        ),
        Box(floor_of(name), (middle, y, floor - _FLOOR / 2), (half_length, half_width, _FLOOR / 2)),
        *(
            Box(
                f"{name}_{side}",
                (middle, y + sign * (half_width - _WALL / 2), wall_z),
                (half_length, _WALL / 2, wall_half),
            )
            for side, sign in (("left", 1), ("right", -1))
        ),
        Box(f"{name}_back", (end - _WALL / 2, y, wall_z), (_WALL / 2, half_width - _WALL, wall_half)),
    )
    return Opening(
        name,
        is_slide=True,
        origin=(face + half, y, z),
        axis=(-1.0, 0.0, 0.0),
        travel=DRAWER_TRAVEL,
        parts=parts,
        handle=_bar(name, face, y, z, _DRAWER_BAR),
        inside=((start, y - half_width, floor - _FLOOR), (end, y + half_width, high)),
    )


def drawer_surface(front: float, width: float, gap: float, y: float = 0.0) -> Surface:
    """Surface on which objects stand in a `drawer` with its centre at y."""
    half = _SHOWN / 2, width / 2 - _PANEL - _SLIT - _WALL - _MARGIN
    return Surface(DRAWER_LEVEL, (front - _SLIT + _MARGIN + half[0], y), half, DRAWER_HEADROOM, gap)


def drawer_surfaces(front: float, width: float, gap: float) -> tuple[Surface, ...]:
    """Surfaces on which objects stand in `drawers`, from left to right."""
    return tuple(drawer_surface(front, width / len(DRAWERS), gap, y) for y in _middles(width))


def way_surface(front: float, gap: float) -> Surface:
    """Surface of the table for objects that block a `drawer`. Behind it is room for the drawer's handle."""
    far = front - _SLIT - _PANEL - _BAR_DISTANCE
    return Surface(0.0, (far - 0.09, 0.0), (0.08, 0.16), math.inf, gap)


def door(side: Literal["left", "right"], front: float, width: float, bottom: float, top: float) -> Opening:
    """Door in front of shelves.

    Args:
        side: of its hinges, as the robot sees it.
        front: [m] along x of the compartment that it closes.
        width: [m]
        bottom, top: [m] heights above the ground.
    """
    sign = 1.0 if side == "left" else -1.0
    low, high = bottom + _SLIT, top
    face, z, height = front - _SLIT - _PANEL, (low + high) / 2, high - low
    hinge = (face, sign * width / 2, z)
    return Opening(
        DOOR,
        is_slide=False,
        origin=hinge,
        axis=(0.0, 0.0, -sign),
        travel=DOOR_TRAVEL,
        parts=(Box("door_panel", (face + _PANEL / 2, 0.0, z), (_PANEL / 2, width / 2, height / 2)),),
        handle=_bar(
            DOOR,
            face,
            -sign * (width / 2 - _BAR_MARGIN),
            min(z, _BAR_HEIGHT),
            min(_BAR_SHARE * height, _LONGEST_BAR),
        ),
        inside=(hinge, hinge),
    )


def _bar(name: str, face: float, y: float, z: float, half_length: float) -> tuple[Box, ...]:
    """Upright bar in front of a face at x, and the posts at its ends."""
    post = (_BAR_DISTANCE - _BAR_HALF_THICKNESS) / 2
    return (
        Box(f"{name}_handle", (face - _BAR_DISTANCE, y, z), (_BAR_HALF_THICKNESS, _BAR_HALF_WIDTH, half_length)),
        *(
            Box(
                f"{name}_post_{number}",
                (face - post, y, z + end * (half_length - _POST_HALF_WIDTH)),
                (post, _POST_HALF_WIDTH, _POST_HALF_WIDTH),
            )
            for number, end in enumerate((-1, 1))
        ),
    )
