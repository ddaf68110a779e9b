"""Tables and their surroundings, predefined by name or made by the user.

World frame: origin on the ground under the table's centre, x from the robot towards the table, y left, z up.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from types import MappingProxyType
from typing import Any, Literal

from clutter_env.errors import ConfigError, check_choice, check_number
from clutter_env.scene.opening import (
    CHEST_TOP,
    DRAWER,
    DRAWER_HEADROOM,
    DRAWERS,
    LEAST_CHEST_DEPTH,
    Box as Box,
    Opening,
    Surface,
    chest,
    door,
    drawer,
    drawer_surface,
    drawer_surfaces,
    drawers,
    floor_of,
    way_surface,
)

TABLE_HEIGHT = 0.75
"""[m] of every table's top face above the ground."""

TABLE = "table_top"
"""Name of the box on which objects stand at the start."""
_BOARD, _BOARDS = "shelf_board", ("shelf_board", "shelf_board_upper", "shelf_board_top")
_COUNTERS = ("counter_left", "counter_right")
_TOP_THICKNESS = 0.04
_LEG_HALF_WIDTH = 0.025
_COUNTER_WIDTH = 0.6
_WALL_HEIGHT = 1.6
_WALL_THICKNESS = 0.05
_PANEL_THICKNESS = 0.02
"""[m] Dimensions of the furniture."""

TABLE_SIZE_RANGE = (0.3, 3.0)
"""[m] of a table's depth and width. Some objects fit on the smallest table, and the base can drive around the
largest."""
HEADROOM_RANGE = (0.25, 1.0)
"""[m] from the table top to the lowest object above it. Random objects are up to 0.20 m high."""
BOX_HALF_EXTENT_RANGE = (0.001, 5.0)
"""[m] Range of half extents."""
BOX_POSITION_RANGE = (-10.0, 10.0)
"""[m] Range of coordinates."""
START_DISTANCE = (0.6, 1.1)
"""[m] from the table's front edge to the base centre at the start."""
LOWEST_SUPPORT = 0.4
"""[m] Height above the ground of the lowest face on which objects may be placed. Lower faces are out of reach."""
SHELF_START_DISTANCE = (0.95, 1.3)
"""[m] Farther away, because the carried gripper is about as high as the shelf."""
OPENS = (None, "drawer", "door_left", "door_right", "drawers")
"""Types of opening of a layout. A door is named by the side of its hinges."""
OBJECT_GAP, DRAWER_GAP = 0.012, 0.03
"""[m] Least distances between the bounding circles of two objects. In a drawer objects are grasped from above, so
fingers must fit between them."""
_CUPBOARD_MARGINS = 0.02, 0.03
"""[m] Depth of the strips behind a door and along the side panels that are empty at the start."""
LONGEST_FRONT = 0.5
"""[m] Longest part of the table in front of a chest. Across a longer part no arm reaches the handle."""
OPENING_START_DISTANCE = (1.1, 1.45)
"""[m] Start distance in front of a handle, which protrudes."""
START_SIDE_MARGIN = 0.1
"""[m] Least distance of the start from the table's side edges, inwards."""
START_CLEARANCE = 0.4
"""[m] Free radius around the base centre at the start: the base and 0.1 m."""


@dataclass(frozen=True)
class Layout:
    """A table (depth along x, width along y [m]), its surroundings, and its drawers or door.

    Example:
        >>> bench = Layout("bench", depth=0.5, width=0.9, is_front_only=False)
        >>> furniture(bench)[0].name
        'table_top'

    Raises:
        ConfigError: a size is outside its range, a box has no unique name, or a box is over the table or where the
            robot
            starts.
    """

    name: str
    depth: float
    width: float
    is_front_only: bool = True
    """Counters beside it and a wall behind it."""
    board_height: float | None = None
    """[m] from the table top to the shelf above it, None if there is no shelf."""
    boxes: tuple[Box, ...] = ()
    """More furniture, in the world frame: obstacles for the robot and for the planner."""
    supports: tuple[str, ...] | None = None
    """Names of the boxes on whose top faces objects may be put, the table's first. None for table and counters."""
    second_board_height: float | None = None
    """[m] from the shelf to a second one above it, None without: objects stand below both."""
    third_board_height: float | None = None
    """[m] from the second shelf to a third one above it, None without: objects stand below all three."""
    opens: str | None = None
    """Drawers or doors in front of the objects. "drawer": in a chest on the table. "drawers": three of them side by
    side. "door_left" or "door_right": in front of table and shelves, with hinges on that side. None: nothing."""
    front: float = 0.0
    """[m] of the table in front of the chest of a drawer, with objects that stand in the drawer's way."""

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise ConfigError(f"a layout's name must be a non-empty string, not {self.name!r}")
        place = f"layout {self.name!r}"
        for name in ("depth", "width"):
            check_number(f"{place}: {name}", getattr(self, name), TABLE_SIZE_RANGE, "m")
        if not isinstance(self.is_front_only, bool):
            raise ConfigError(f"{place}: is_front_only={self.is_front_only!r} must be True or False")
        for name in ("board_height", "second_board_height", "third_board_height"):
            if (height := getattr(self, name)) is not None:
                check_number(f"{place}: {name}", height, HEADROOM_RANGE, "m")
        if self.second_board_height is not None and self.board_height is None:
            raise ConfigError(f"{place}: second_board_height={self.second_board_height!r} needs a board_height")
        if self.third_board_height is not None and self.second_board_height is None:
            raise ConfigError(f"{place}: third_board_height={self.third_board_height!r} needs a second_board_height")
        self._check_opening(place)
        object.__setattr__(self, "boxes", _checked_boxes(place, self.boxes))
        moving = [box for opening in openings_of(self) for box in (*opening.parts, *opening.handle)]
        names = [box.name for box in (*furniture(self), *moving)]
        for name in names:
            if names.count(name) > 1:
                raise ConfigError(f"{place}: two boxes are named {name!r}; the names: {', '.join(names)}")
        half_x, half_y = self.depth / 2, self.width / 2
        (x, y), (_, side) = self.start_region
        low, high = (x - START_CLEARANCE, y - START_CLEARANCE, 0.0), (-self.depth / 2, side + START_CLEARANCE, math.inf)
        for box in self.boxes:
            if _overlaps(box, (-half_x, -half_y, TABLE_HEIGHT), (half_x, half_y, TABLE_HEIGHT + HEADROOM_RANGE[0])):
                raise ConfigError(
                    f"{place}: box {box.name!r} is less than {HEADROOM_RANGE[0]} m above the table, where objects stand"
                )
            if _overlaps(box, low, high):
                raise ConfigError(
                    f"{place}: box {box.name!r} reaches into x from {low[0]:.3g} to {high[0]:.3g} m, "
                    f"y from {low[1]:.3g} to {high[1]:.3g} m, where the robot starts"
                )
        if self.supports is not None:
            known = [
                box.name
                for box in furniture(self)
                if top_of(box) >= (LOWEST_SUPPORT if box in self.boxes else TABLE_HEIGHT)
            ]
            # JSON turns tuples into lists.
            chosen = tuple(self.supports) if isinstance(self.supports, list | tuple) else ()
            chosen = chosen if all(isinstance(name, str) for name in chosen) else ()
            if chosen[:1] != (TABLE,) or len(set(chosen)) < len(chosen) or not set(chosen) <= set(known):
                raise ConfigError(
                    f"{place}: supports={self.supports!r} must be names of boxes at least {LOWEST_SUPPORT} m high, "
                    f"{TABLE!r} first; valid names: {', '.join(known)}"
                )
            object.__setattr__(self, "supports", chosen)

    def _check_opening(self, place: str) -> None:
        """Raise ConfigError unless the drawers or the door fit the rest of the layout."""
        check_choice(f"{place}: opens", self.opens, OPENS)
        check_number(f"{place}: front", self.front, (0.0, LONGEST_FRONT), "m")
        if self.front and self.opens != "drawer":
            raise ConfigError(
                f"{place}: front={self.front!r} is the table in front of a drawer; it needs opens='drawer'"
            )
        if self.opens and self.supports is not None:
            raise ConfigError(f"{place}: supports={self.supports!r} are chosen by the layout where something opens")
        if self.has_drawers:
            if self.board_height is not None:
                raise ConfigError(f"{place}: board_height={self.board_height!r} does not go with opens={self.opens!r}")
            if self.depth - self.front < LEAST_CHEST_DEPTH:
                raise ConfigError(
                    f"{place}: depth={self.depth!r} leaves less than {LEAST_CHEST_DEPTH} m for the chest of a drawer"
                )
        elif self.opens and self.board_height is None:
            raise ConfigError(f"{place}: opens={self.opens!r} needs a board_height, up to which the door reaches")

    @property
    def has_drawers(self) -> bool:
        """Whether the table carries a chest with one or several drawers."""
        return self.opens in ("drawer", "drawers")

    @property
    def is_fridge(self) -> bool:
        """Whether three shelves stand behind a door. The lowest compartment then stands on a solid base in place of
        table legs."""
        return self.third_board_height is not None and self.opens is not None

    @cached_property
    def surfaces(self) -> tuple[Surface, ...]:
        """Surfaces on which objects stand at the start: table and shelves, or drawers, and the table in front of a
        drawer."""
        half = self.depth / 2, self.width / 2
        if self.opens == "drawer":
            inside = drawer_surface(self.front - half[0], self.width, DRAWER_GAP)
            return (inside, way_surface(self.front - half[0], OBJECT_GAP)) if self.front else (inside,)
        if self.opens == "drawers":
            return drawer_surfaces(-half[0], self.width, DRAWER_GAP)
        if self.opens:
            half = half[0] - _CUPBOARD_MARGINS[0], half[1] - _CUPBOARD_MARGINS[1]
        return tuple(Surface(level, (0.0, 0.0), half, self.headroom, OBJECT_GAP) for level in self.levels)

    @property
    def inside(self) -> tuple[Surface, ...]:
        """Surfaces on one of which the target stands: all except the table in front of a drawer."""
        return self.surfaces[:1] if self.front else self.surfaces

    @property
    def levels(self) -> tuple[float, ...]:
        """Heights [m] above the table top of the surfaces on which objects stand at the start. The table itself has
        0."""
        if self.has_drawers:
            return tuple(surface.level for surface in self.surfaces)
        if self.board_height is None or self.second_board_height is None:
            return (0.0,)
        second = self.board_height + _PANEL_THICKNESS
        if self.third_board_height is None:
            return 0.0, second
        return 0.0, second, second + self.second_board_height + _PANEL_THICKNESS

    @property
    def headroom(self) -> float:
        """Distance [m] from a surface with objects to the lowest obstacle above it, infinite if the space is open."""
        if self.has_drawers:
            return DRAWER_HEADROOM
        x, y = self.depth / 2, self.width / 2
        above = [box for box in furniture(self) if _overlaps(box, (-x, -y, TABLE_HEIGHT), (x, y, math.inf))]
        over_table = min((box.position[2] - box.half_extents[2] - TABLE_HEIGHT for box in above), default=math.inf)
        return min(over_table, self.second_board_height or math.inf, self.third_board_height or math.inf)

    @property
    def start_region(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Lowest and highest x and y [m] of the base centre at the start."""
        near, far = START_DISTANCE if self.board_height is None else SHELF_START_DISTANCE
        near, far = OPENING_START_DISTANCE if self.opens else (near, far)
        side = self.width / 2 - START_SIDE_MARGIN
        return (-self.depth / 2 - far, -side), (-self.depth / 2 - near, side)


def _checked_boxes(place: str, boxes: Any) -> tuple[Box, ...]:
    """Check the boxes' numbers. JSON turns Boxes into lists."""
    try:
        made = tuple(Box(name, tuple(position), tuple(half)) for name, position, half in boxes)
    except (TypeError, ValueError):
        raise ConfigError(f"{place}: boxes must be Boxes (name, position, half_extents), not {boxes!r}") from None
    for box in made:
        if not isinstance(box.name, str) or not box.name:
            raise ConfigError(f"{place}: a box's name must be a non-empty string, not {box.name!r}")
        if len(box.position) != 3 or len(box.half_extents) != 3:
            raise ConfigError(f"{place}: box {box.name!r} must have three positions and three half extents")
        for value in box.position:
            check_number(f"{place}: box {box.name!r}: position", value, BOX_POSITION_RANGE, "m")
        for value in box.half_extents:
            check_number(f"{place}: box {box.name!r}: half_extents", value, BOX_HALF_EXTENT_RANGE, "m")
    return made


def _overlaps(box: Box, low: tuple[float, ...], high: tuple[float, ...]) -> bool:
    """Whether a box and the volume between two corners overlap by more than a face."""
    return all(
        centre - half < top and centre + half > bottom
        for centre, half, bottom, top in zip(box.position, box.half_extents, low, high, strict=True)
    )


def furniture(layout: Layout) -> tuple[Box, ...]:
    """All fixed boxes of a layout: the table, those that its options add, and its own `boxes`.

    Other modules rely on the names. `openings_of` returns the moving parts.
    """
    x, y, top = layout.depth / 2, layout.width / 2, TABLE_HEIGHT
    leg = _LEG_HALF_WIDTH
    leg_z = (top - _TOP_THICKNESS) / 2
    boxes = [Box(TABLE, (0.0, 0.0, top - _TOP_THICKNESS / 2), (x, y, _TOP_THICKNESS / 2))]
    corners = ((-1, -1), (-1, 1), (1, -1), (1, 1))
    boxes += [
        Box(f"table_leg_{i}", (sx * (x - leg), sy * (y - leg), leg_z), (leg, leg, leg_z))
        for i, (sx, sy) in enumerate(corners)
    ]
    if layout.is_fridge:
        boxes[1:] = [Box("table_base", (0.0, 0.0, leg_z), (x, y, leg_z))]
    if layout.is_front_only:
        side = _COUNTER_WIDTH / 2
        boxes += [
            Box(_COUNTERS[0], (0.0, y + side, top / 2), (x, side, top / 2)),
            Box(_COUNTERS[1], (0.0, -y - side, top / 2), (x, side, top / 2)),
            Box(
                "wall",
                (x + _WALL_THICKNESS / 2, 0.0, _WALL_HEIGHT / 2),
                (_WALL_THICKNESS / 2, y + _COUNTER_WIDTH, _WALL_HEIGHT / 2),
            ),
        ]
    if layout.board_height is not None:
        # Side panels just outside the table and one to three shelves across them.
        panel, heights = _PANEL_THICKNESS / 2, [layout.board_height]
        for height in (layout.second_board_height, layout.third_board_height):
            if height is not None:
                heights.append(heights[-1] + _PANEL_THICKNESS + height)
        z, half_height = TABLE_HEIGHT + heights[-1] / 2, heights[-1] / 2
        boxes += [
            Box("shelf_left", (0.0, y + panel, z), (x, panel, half_height)),
            Box("shelf_right", (0.0, -y - panel, z), (x, panel, half_height)),
        ]
        boxes += [
            Box(name, (0.0, 0.0, TABLE_HEIGHT + height + panel), (x, y + 2 * panel, panel))
            for name, height in zip(_BOARDS, heights, strict=False)
        ]
    if layout.has_drawers:
        count = len(DRAWERS) if layout.opens == "drawers" else 1
        boxes += chest(layout.front - x, x, layout.width, TABLE_HEIGHT, count)
    return (*boxes, *layout.boxes)


def openings_of(layout: Layout) -> tuple[Opening, ...]:
    """Drawers, from left to right, or the door of a layout. () if it has neither."""
    if layout.opens is None:
        return ()
    front = layout.front - layout.depth / 2
    if layout.opens == "drawer":
        return (drawer(front, layout.width, TABLE_HEIGHT),)
    if layout.opens == "drawers":
        return drawers(front, layout.width, TABLE_HEIGHT)
    side: Literal["left", "right"] = "left" if layout.opens == "door_left" else "right"
    heights = (layout.board_height, layout.second_board_height, layout.third_board_height)
    top = TABLE_HEIGHT + sum(height + _PANEL_THICKNESS for height in heights if height is not None)
    return (door(side, front, layout.width + 2 * _PANEL_THICKNESS, TABLE_HEIGHT, top),)


def top_of(box: Box) -> float:
    """Height [m] of a box's top face above the ground."""
    return box.position[2] + box.half_extents[2]


def supports_of(layout: Layout) -> tuple[str, ...]:
    """Names of the boxes on whose top faces objects may be placed, first the box on which objects stand at the
    start."""
    if layout.supports is not None:
        return layout.supports
    if layout.has_drawers:  # only the part of the table in front of the chest
        names = (CHEST_TOP, *_COUNTERS, TABLE) if layout.front else (CHEST_TOP, *_COUNTERS)
        floors = map(floor_of, DRAWERS if layout.opens == "drawers" else (DRAWER,))
        return (*floors, *(box.name for box in furniture(layout) if box.name in names))
    shelves = _BOARDS[: len(layout.levels) - 1]
    return tuple(box.name for box in furniture(layout) if box.name in (TABLE, *_COUNTERS, *shelves))


TRAY = "tray_"
"""Prefix of the names of trays, the supports into which objects are sorted. The tray's colour follows."""
_TRAY_HALF_X, _TRAY_HALF_Y = 0.21, 0.135
"""[m] Half extents of a tray's floor along x and y: for seven of the largest random objects with fingers between
them."""
_TRAY_FLOOR, _TRAY_RIM, _RIM_WIDTH = 0.005, 0.02, 0.01
"""[m] Thickness of a tray's floor, height of its rim above what the tray stands on, and thickness of the rim. Fingers
that hold an object by its middle stay above the rim."""


def tray(colour: str, x: float, y: float) -> tuple[Box, ...]:
    """Tray at (x, y) [m] on a counter: its floor, named "tray_" and its colour, and four low rims."""
    name, half_floor, half_rim = f"{TRAY}{colour}", _TRAY_FLOOR / 2, _TRAY_RIM / 2
    half = half_x, half_y = _TRAY_HALF_X, _TRAY_HALF_Y
    rims = [(side * (half_x + _RIM_WIDTH / 2), 0.0, _RIM_WIDTH / 2, half_y + _RIM_WIDTH) for side in (-1, 1)] + [
        (0.0, side * (half_y + _RIM_WIDTH / 2), half_x, _RIM_WIDTH / 2) for side in (-1, 1)
    ]
    return (
        Box(name, (x, y, TABLE_HEIGHT + half_floor), (*half, half_floor)),
        *(
            Box(f"{name}_rim_{i}", (x + dx, y + dy, TABLE_HEIGHT + half_rim), (rim_x, rim_y, half_rim))
            for i, (dx, dy, rim_x, rim_y) in enumerate(rims)
        ),
    )


SECOND_TABLE = "second_table"
"""Name of the table in the next room."""
_STEP_DOWN = 0.15
"""[m] Height difference from the first table down to the second."""
_DOOR_WIDTH, _DOOR_X, _PARTITION_Y = 0.9, -1.2, 1.6
"""[m] Width and x of the doorway between the rooms, and y of the wall that contains it."""
_GROUND_END = 4.5
"""[m] Largest |x| of the wall, beyond the base's range."""


def _next_room() -> tuple[Box, ...]:
    """A second, lower table to the left of the first one, and a wall with a doorway in between."""
    ends = ((-_GROUND_END, _DOOR_X - _DOOR_WIDTH / 2), (_DOOR_X + _DOOR_WIDTH / 2, _GROUND_END))
    walls = tuple(
        Box(
            f"partition_{name}",
            ((low + high) / 2, _PARTITION_Y, _WALL_HEIGHT / 2),
            ((high - low) / 2, _WALL_THICKNESS / 2, _WALL_HEIGHT / 2),
        )
        for name, (low, high) in zip(("front", "back"), ends, strict=True)
    )
    height = TABLE_HEIGHT - _STEP_DOWN
    return (Box(SECOND_TABLE, (0.2, 3.0, height / 2), (0.3, 0.5, height / 2)), *walls)


def lowest_support(layout: Layout) -> float:
    """Height [m] above the ground of the lowest face on which objects may be placed."""
    names = layout.supports or ()
    return min((TABLE_HEIGHT, *(top_of(box) for box in layout.boxes if box.name in names)))


LAYOUTS: Mapping[str, Layout] = MappingProxyType(
    {
        "paper": Layout("paper", depth=0.7, width=1.0),
        "wide": Layout("wide", depth=0.8, width=1.2),
        "dense": Layout("dense", depth=0.6, width=0.8),
        "shelf": Layout("shelf", depth=0.7, width=1.0, board_height=0.40),
        "two_boards": Layout("two_boards", depth=0.7, width=1.0, board_height=0.35, second_board_height=0.35),
        "cabinet": Layout("cabinet", depth=0.45, width=0.8, board_height=0.40),
        "island": Layout("island", depth=0.8, width=1.2, is_front_only=False),
        "trays": Layout(
            "trays",
            depth=0.7,
            width=1.0,
            boxes=(*tray("red", -0.11, 0.65), *tray("green", -0.11, 0.95), *tray("blue", -0.11, -0.8)),
            supports=(TABLE, "tray_red", "tray_green", "tray_blue"),
        ),
        "two_tables": Layout(
            "two_tables", depth=0.7, width=1.0, boxes=_next_room(), supports=(TABLE, *_COUNTERS, SECOND_TABLE)
        ),
        "drawer": Layout("drawer", depth=0.42, width=0.62, opens="drawer"),
        "cupboard": Layout("cupboard", depth=0.4, width=0.5, board_height=0.36, opens="door_left"),
        "fridge": Layout(
            "fridge",
            depth=0.34,
            width=0.5,
            board_height=0.27,
            second_board_height=0.27,
            third_board_height=0.27,
            opens="door_right",
        ),
        "blocked_drawer": Layout("blocked_drawer", depth=0.74, width=0.62, opens="drawer", front=0.32),
        "drawers": Layout("drawers", depth=0.42, width=1.5, opens="drawers"),
    }
)


def find_layout(layout: object) -> Layout:
    """Find the layout of a name, or make it from a dictionary of its fields. A `Layout` is returned unchanged.

    Raises:
        ConfigError: the name is unknown, or the dictionary does not hold the fields of a layout. The message lists the
            valid ones.
    """
    if isinstance(layout, Layout):
        return layout
    if isinstance(layout, Mapping):
        known = [entry.name for entry in fields(Layout)]
        if not {"name", "depth", "width"} <= set(layout) <= set(known):
            raise ConfigError(f"layout={dict(layout)!r} must hold the fields of a Layout: {', '.join(known)}")
        return Layout(**layout)
    if isinstance(layout, str) and layout in LAYOUTS:
        return LAYOUTS[layout]
    names = ", ".join(repr(name) for name in LAYOUTS)
    raise ConfigError(f"layout={layout!r} is not valid; valid names: {names}; or give a clutter_env.Layout")
