"""Sets of random objects as data: ranges of their sizes and masses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from clutter_env.scene.household import KINDS, slot_kinds
from clutter_env.scene.layout import Layout

Range = tuple[float, float]

SHAPE_SETS = ("cylinder", "box", "mixed")
OBJECT_GAP = 0.012
"""[m] between the bounding circles of two objects at least."""
STANDARD_HEIGHT = 0.20
"""[m] Height up to which objects fit every layout."""
HEADROOM_LEFT = 0.05
"""[m] between a random object's top and what hangs above the table, at least."""
MAX_OBJECTS = 60
"""Objects in one scene at most, on any table: the planners' bit masks hold no more."""
_PACKING = 0.46
"""Share of the area that random placement reliably fills; the limit is 0.547 (random sequential adsorption)."""

_PACKING_WIDEST_FIRST = 0.53
"""The same of household objects, whose widest are placed first."""


@dataclass(frozen=True)
class ObjectSet:
    """Ranges from which sizes and masses are drawn uniformly.

    Attributes:
        radius: [m] of a cylinder.
        half_depth, half_width: [m] of a box. The corners of an upright box stay within the footprint of the larger
            cylinders' clearance. `half_depth` is also half the length of a lying cylinder.
        height: [m], for cylinders and boxes.
        mass: [kg]
        edge_margin: [m] from an object's axis to the table's edge at least.
        are_cylinders_lying: whether cylinders lie on their sides instead of standing.
        kinds: names of the kinds of household objects that the slots of a scene hold in turn, in place of random
            cylinders and boxes; none for these.
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
        """The range of heights [m], cut off where less than `HEADROOM_LEFT` would remain above the objects."""
        low, high = self.height
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
"""Upright cylinders and boxes but for "lying", cylinders and boxes on one of their long sides, and "household"."""


def slot_shapes(shapes: str, count: int, objects: ObjectSet = OBJECT_SETS["standard"]) -> tuple[str, ...]:
    """The shape, or kind, of every slot of a random scene: a mixed set alternates."""
    if objects.kinds:
        return slot_kinds(count)
    if shapes == "mixed":
        return tuple("box" if index % 2 else "cylinder" for index in range(count))
    return (shapes,) * count


def capacity(layout: Layout, shapes: str, objects: ObjectSet = OBJECT_SETS["standard"]) -> int:
    """Number of objects of these shapes that random placement reliably puts on the table."""
    cylinder, depth = sum(objects.radius), sum(objects.half_depth)
    box = math.hypot(depth, sum(objects.half_width))
    if objects.are_cylinders_lying:
        cylinder = math.hypot(depth, cylinder)
    if objects.kinds:
        widest = [2 * math.hypot(*KINDS[kind].half_extents[:2]) + OBJECT_GAP for kind in objects.kinds]
        square = sum(width**2 for width in widest) / len(widest)
        in_one_row = int(_PACKING_WIDEST_FIRST * layout.depth * layout.width / (math.pi / 4 * square))
        return min(in_one_row * len(layout.levels), MAX_OBJECTS)
    diameter = {"cylinder": cylinder, "box": box, "mixed": (cylinder + box) / 2}[shapes] + OBJECT_GAP
    overhang = diameter / 2 - objects.edge_margin
    area = (layout.depth + 2 * overhang) * (layout.width + 2 * overhang)
    in_one_row = int(_PACKING * area / (math.pi / 4 * diameter**2))
    return min(in_one_row * len(layout.levels), MAX_OBJECTS)
