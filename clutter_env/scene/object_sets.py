"""Sets of random objects as data: ranges of sizes and masses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from clutter_env.scene.household import KINDS, slot_kinds
from clutter_env.scene.layout import HEADROOM_RANGE, Layout
from clutter_env.scene.opening import Surface

Range = tuple[float, float]

SHAPE_SETS = ("cylinder", "box", "mixed")
STANDARD_HEIGHT = 0.20
"""[m] Largest height of objects that fit every layout."""
HEADROOM_LEFT = 0.05
"""[m] Least clearance between a random object's top and the lowest obstacle above the table."""
_LEFT_IN_DRAWER = 0.025
"""[m] The same in a closed drawer, where nothing is grasped."""
MAX_OBJECTS = 60
"""Most objects in one scene, on any table. The planners' bit masks hold no more."""
_PACKING = 0.46
"""Share of the area that random placement reliably fills. The limit is 0.547 (random sequential adsorption)."""

_PACKING_WIDEST_FIRST = 0.53
"""The same for household objects, because the widest are placed first."""


@dataclass(frozen=True)
class ObjectSet:
    """Ranges from which sizes and masses are drawn uniformly.

    Attributes:
        radius: [m] of a cylinder.
        half_depth, half_width: [m] of a box. The corners of an upright box stay within the footprint of the larger
            cylinders' clearance. `half_depth` is also half the length of a lying cylinder.
        height: [m], for cylinders and boxes.
        mass: [kg]
        edge_margin: [m] least distance from an object's axis to the table's edge.
        are_cylinders_lying: whether cylinders lie on their sides instead of standing.
        kinds: names of the kinds of household objects in the slots of a scene. () for random cylinders and boxes.
        has_side_grasps: whether a level gripper grasps these objects at the robot's usual height above the table, so
            that obstructed targets can be recognised.
    """

    radius: Range = (0.025, 0.035)
    half_depth: Range = (0.020, 0.028)
    half_width: Range = (0.020, 0.028)
    height: Range = (0.12, 0.20)
    mass: Range = (0.15, 0.25)
    edge_margin: float = 0.045
    are_cylinders_lying: bool = False
    kinds: tuple[str, ...] = ()
    has_side_grasps: bool = True

    def heights_on(self, layout: Layout) -> Range:
        """Range of heights [m], with the upper end limited so that `HEADROOM_LEFT` remains above the objects.

        A drawer is lower than all other compartments. There the whole range is scaled down.
        """
        low, high = self.height
        if layout.headroom < HEADROOM_RANGE[0]:
            scale = min((layout.headroom - _LEFT_IN_DRAWER) / high, 1.0)
            return scale * low, scale * high
        if high <= STANDARD_HEIGHT:
            return low, high
        limit = max(layout.headroom - HEADROOM_LEFT, STANDARD_HEIGHT)
        return min(low, limit), min(high, limit)


OBJECT_SETS: Mapping[str, ObjectSet] = MappingProxyType(
    {
        "standard": ObjectSet(),
        "low": ObjectSet(height=(0.04, 0.08), has_side_grasps=False),
        "lying": ObjectSet(
            radius=(0.020, 0.028),
            half_depth=(0.05, 0.09),
            height=(0.04, 0.056),
            edge_margin=0.095,
            are_cylinders_lying=True,
            has_side_grasps=False,
        ),
        "tall": ObjectSet(height=(0.20, 0.30)),
        "heavy": ObjectSet(mass=(0.5, 2.0)),
        "blocks": ObjectSet(
            radius=(0.024, 0.028),
            half_depth=(0.022, 0.028),
            half_width=(0.022, 0.028),
            height=(0.05, 0.06),
            has_side_grasps=False,
        ),
        "household": ObjectSet(height=(0.025, 0.23), mass=(0.12, 0.60), kinds=tuple(KINDS), has_side_grasps=False),
    }
)
""""lying" has cylinders and boxes on one of their long sides, "household" has `KINDS`. All others have upright
cylinders and boxes."""


def slot_shapes(shapes: str, count: int, objects: ObjectSet = OBJECT_SETS["standard"]) -> tuple[str, ...]:
    """Shape or kind of each slot of a random scene. "mixed" alternates cylinders and boxes."""
    if objects.kinds:
        return slot_kinds(count)
    if shapes == "mixed":
        return tuple("box" if index % 2 else "cylinder" for index in range(count))
    return (shapes,) * count


def capacity(layout: Layout, shapes: str, objects: ObjectSet = OBJECT_SETS["standard"]) -> int:
    """Number of objects of these shapes that random placement reliably puts on the table.

    A layout with a blocked drawer has room for one more object, in front of the drawer.
    """
    inside = sum(_capacity_of(surface, shapes, objects) for surface in layout.inside)
    return min(inside + (1 if layout.front and inside else 0), MAX_OBJECTS)


def _capacity_of(surface: Surface, shapes: str, objects: ObjectSet) -> int:
    """The same for one surface."""
    depth, width = (2 * half for half in surface.half_extents)
    cylinder, length = sum(objects.radius), sum(objects.half_depth)
    box = math.hypot(length, sum(objects.half_width))
    if objects.are_cylinders_lying:
        cylinder = math.hypot(length, cylinder)
    if objects.kinds:
        kinds = [KINDS[kind].half_extents for kind in objects.kinds]
        if max(2 * half[2] for half in kinds) > surface.headroom:
            return 0
        widest = [2 * math.hypot(*half[:2]) + surface.gap for half in kinds]
        square = sum(each**2 for each in widest) / len(widest)
        return int(_PACKING_WIDEST_FIRST * depth * width / (math.pi / 4 * square))
    diameter = {"cylinder": cylinder, "box": box, "mixed": (cylinder + box) / 2}[shapes] + surface.gap
    overhang = diameter / 2 - objects.edge_margin
    area = (depth + 2 * overhang) * (width + 2 * overhang)
    return int(_PACKING * area / (math.pi / 4 * diameter**2))
