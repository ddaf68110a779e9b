"""Counts of objects in the way of side grasps: a fast geometric test that needs no planner.

For every object and every direction of approach, the outline of the level gripper and of the wrist behind it is laid
over the table. The objects whose footprint it touches are in the way. Only directions count that the robot reaches on
the empty table; they come from a table that was made with the planner (`assets/approaches/<robot>.json`).
Under a shelf the robot drives straight in and out with the arm rigid, as in the planner: what gripper and wrist touch
on the way, and the grasped object on the way out, is in the way too.
The forearm and the rest of the robot are left out; `docs/suites.md` says how well this agrees with the planner.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import assets
from clutter_env.scene.layout import LAYOUTS, Layout
from clutter_env.scene.table_scene import TableScene

Array = NDArray[np.float64]

UNREACHABLE = -1
"""Count of an object that no side grasp reaches, whatever is moved."""
WIDEST_YAW = math.radians(75.0)
"""Approaches to a table with front access deviate by no more than this from straight ahead, if there is no table of
reachable directions for its layout."""


class PlannerMargins(NamedTuple):
    """The planner's numbers that the test needs; whoever makes the table of approaches takes them from the planner.

    `yaws`: directions of approach to a cylinder, evenly about the vertical; `padding` [m] that gripper and wrist keep
    from objects; `finger_gap` [m] between each finger and the object before the fingers close; `back` [m] that the
    gripper backs off under a shelf before it moves straight out; `held_gap` [m] that a grasped object keeps from others
    on the way out.
    """

    yaws: int
    padding: float
    finger_gap: float
    back: float
    held_gap: float


class Solids(NamedTuple):
    """Gripper and wrist of a level gripper, seen from above: s rectangles with rounded corners.

    `start`, `end` (s,) [m] along the approach from the TCP; `half_width`, `radius`, `half_height` (s,) [m];
    `is_finger` (s,): `half_width` is counted from the pad.
    """

    start: Array
    end: Array
    half_width: Array
    radius: Array
    half_height: Array
    is_finger: NDArray[np.bool_]

    @classmethod
    def of(cls, rows: Sequence[Sequence[float]]) -> Solids:
        """From a row of numbers for each."""
        start, end, half_width, radius, half_height, is_finger = np.array(rows, np.float64).T
        return cls(start, end, half_width, radius, half_height, is_finger > 0)


@dataclass(frozen=True, eq=False)
class SideApproaches:
    """Side grasps of a robot, read from a file.

    Attributes:
        margins: of the planner.
        solids: outline of gripper and wrist.
        grasp_height: [m] of the TCP above the table, for objects that are high enough.
        palm_reach: [m] that the object may extend from the TCP towards the palm.
        pad_half_height: [m] of a finger pad, which should not stick out above the object.
        reachable: by name of the layout, whether the robot reaches a grasp on the empty table, (nx, ny, yaws): the
            table top is divided evenly into nx by ny cells.
    """

    margins: PlannerMargins
    solids: Solids
    grasp_height: float
    palm_reach: float
    pad_half_height: float
    reachable: dict[str, NDArray[np.bool_]]

    def is_reachable(self, layout: Layout, points: Array, yaws: Array) -> NDArray[np.bool_]:
        """Whether grasps at TCP positions (..., 2) [m] with these yaws (...) [rad] are reached on the empty table.

        For a layout without a table of directions: all yaws if it is open on all sides, else those within
        `WIDEST_YAW` of straight ahead.
        """
        table = self.reachable.get(layout.name) if LAYOUTS.get(layout.name) == layout else None
        if table is None:
            ahead = np.abs(np.mod(yaws + math.pi, 2 * math.pi) - math.pi) <= WIDEST_YAW
            return ahead | (not layout.is_front_only)
        count = np.array(table.shape[:2])
        shares = points / (layout.depth, layout.width) + 0.5
        cells = np.clip(np.floor(shares * count).astype(np.int64), 0, count - 1)
        index = np.rint(yaws * (self.margins.yaws / (2 * math.pi))).astype(np.int64) % self.margins.yaws
        return np.asarray(table[cells[..., 0], cells[..., 1], index])


def robots_with_approaches() -> tuple[str, ...]:
    """Full names of the robots, see `RobotSpec.full_name`, for which there is a table of side approaches."""
    return assets.names("approaches")


@cache
def side_approaches(robot: str) -> SideApproaches:
    """The side approaches of a robot of that full name, read once.

    Raises:
        FileNotFoundError: there is no table for that robot; see `robots_with_approaches`.
    """
    content = json.loads(assets.path(f"approaches/{robot}.json").read_text())
    margins = PlannerMargins(**content["planner"])
    reachable, digits = {}, margins.yaws // 4
    for name, rows in content["layouts"].items():  # a mask of the yaws in hexadecimal digits for each cell
        masks = [[int(row[start : start + digits], 16) for start in range(0, len(row), digits)] for row in rows]
        reachable[name] = (np.array(masks)[..., None] >> np.arange(margins.yaws) & 1).astype(np.bool_)
    return SideApproaches(
        margins=margins,
        solids=Solids.of(content["solids"]),
        grasp_height=content["grasp_height"],
        palm_reach=content["palm_reach"],
        pad_half_height=content["pad_half_height"],
        reachable=reachable,
    )


class SideGrasps(NamedTuple):
    """Reachable side grasps of the objects of a scene, and what is in their way.

    `own` (k,): slot of what each grasps; `hits` (k, n): the objects that gripper, wrist or load would touch.
    """

    own: NDArray[np.int64]
    hits: NDArray[np.bool_]

    def fewest_blockers(self) -> NDArray[np.int64]:
        """The fewest objects in the way of any grasp, for every object: (n,), or `UNREACHABLE`."""
        count = self.hits.shape[1]
        fewest = np.full(count, count)
        np.minimum.at(fewest, self.own, self.hits.sum(axis=1))
        return np.where(np.isin(np.arange(count), self.own), fewest, UNREACHABLE)

    def can_be_freed(self, target: int) -> bool:
        """Whether a grasp of the target becomes free once everything is gone that can go before it.

        Objects go one after another, each by a grasp that is free by then. Where the target's blockers wait for one
        another, or for the target, no plan with these grasps takes it.
        """
        waiting = np.ones(self.hits.shape[1], np.bool_)
        while True:
            free = np.zeros_like(waiting)
            free[self.own[~(self.hits & waiting).any(axis=1)]] = True
            if free[target]:
                return True
            if not (free & waiting).any():
                return False
            waiting &= ~free


def side_grasps(approaches: SideApproaches, layout: Layout, scene: TableScene, max_opening: float) -> SideGrasps:
    """The reachable side grasps of all objects.

    Args:
        approaches: of the robot.
        layout: the table and its surroundings.
        scene: what stands where.
        max_opening: [m] of the gripper.
    """
    return SideGrasps(*_in_the_way(approaches, layout, scene, max_opening, np.arange(scene.num_objects)))


def count_blockers(
    approaches: SideApproaches, layout: Layout, scene: TableScene, max_opening: float
) -> NDArray[np.int64]:
    """The fewest objects in the way of any reachable side grasp, for every object; see `SideGrasps`."""
    return side_grasps(approaches, layout, scene, max_opening).fewest_blockers()


def estimate_clearances(approaches: SideApproaches, layout: Layout, scene: TableScene, max_opening: float) -> float:
    """Estimate how many objects must be moved before a side grasp reaches the target, by the same test.

    The objects in the way of its best grasp count, those in the way of their own best grasps, and so on; each object
    once. To these is added the mean number of objects in the way over all reachable grasps of the target, to which
    objects beside the best grasp contribute. With no reachable grasp it is as if all objects were in the way.

    Args:
        approaches: of the robot.
        layout: the table and its surroundings.
        scene: what stands where.
        max_opening: [m] of the gripper.
    """
    is_counted = np.zeros(scene.num_objects, np.bool_)
    waiting, mean = [scene.target], float(scene.num_objects)
    while waiting:
        grasped = waiting.pop(0)
        _, hits = _in_the_way(approaches, layout, scene, max_opening, np.array([grasped]))
        if grasped == scene.target:
            if not len(hits):
                return 2.0 * scene.num_objects
            mean = float(hits.sum(axis=1).mean())
        hits = hits[~hits[:, scene.target]] & ~is_counted  # the target is still there when the others are moved
        if len(hits):
            found = hits[hits.sum(axis=1).argmin()]
            is_counted |= found
            waiting += np.flatnonzero(found).tolist()
    return float(np.count_nonzero(is_counted)) + mean


def _in_the_way(
    approaches: SideApproaches, layout: Layout, scene: TableScene, max_opening: float, grasped: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """All reachable side grasps of these objects: the slot (k,) of what is grasped, and what is in the way (k, n)."""
    yaws, opening, is_offered = _grasps(approaches.margins, scene, max_opening)
    approach = np.stack((np.cos(yaws), np.sin(yaws)), axis=-1)
    depth = _half_extent(scene, approach)
    tcp = scene.positions[:, None] - np.maximum(depth - approaches.palm_reach, 0.0)[..., None] * approach
    heights = 2 * scene.standing_extents[:, 2]
    is_high = heights - approaches.pad_half_height >= approaches.grasp_height
    is_offered &= is_high[:, None] & approaches.is_reachable(layout, tcp, yaws)
    is_offered &= np.isin(np.arange(scene.num_objects), grasped)[:, None]
    own, direction = np.nonzero(is_offered)
    grasps = tcp[own, direction], yaws[own, direction], opening[own, direction]
    hits = _hits(approaches, scene, *grasps)
    if layout.board_height is not None and layout.is_front_only:
        hits |= _hits_on_drive(approaches, layout, scene, own, *grasps)
    hits &= scene.levels[own, None] == scene.levels
    hits[np.arange(len(own)), own] = False
    return own, hits


def _grasps(margins: PlannerMargins, scene: TableScene, max_opening: float) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Yaws [rad], openings [m] and whether there is such a grasp, each (n, yaws): a box has four, along its axes."""
    turns = np.arange(margins.yaws) * (2 * math.pi / margins.yaws)
    quarter = np.arange(margins.yaws) * (math.pi / 2)
    yaws = np.where(scene.is_angular[:, None], scene.yaws[:, None] + quarter, turns)
    across = _half_extent(scene, np.stack((-np.sin(yaws), np.cos(yaws)), axis=-1))
    is_offered = (2 * across < max_opening) & (~scene.is_angular[:, None] | (np.arange(margins.yaws) < 4))
    return yaws, np.minimum(2 * (across + margins.finger_gap), max_opening), is_offered


def _half_extent(scene: TableScene, direction: Array) -> Array:
    """Half extents (n, k) [m] of the footprints along horizontal directions (n, k, 2)."""
    half_x, half_y = scene.standing_extents[:, :1], scene.standing_extents[:, 1:2]
    c, s = np.cos(scene.yaws)[:, None], np.sin(scene.yaws)[:, None]
    along = np.abs(direction[..., 0] * c + direction[..., 1] * s)
    across = np.abs(direction[..., 1] * c - direction[..., 0] * s)
    return np.where(scene.is_angular[:, None], half_x * along + half_y * across, half_x)


def _hits_on_drive(
    approaches: SideApproaches,
    layout: Layout,
    scene: TableScene,
    own: NDArray[np.int64],
    tcp: Array,
    yaws: Array,
    opening: Array,
) -> NDArray[np.bool_]:
    """Objects that gripper, wrist or the grasped object touch on the straight drive out at k grasps, (k, n).

    The drive goes against x, from where the gripper has backed off. That gripper, wrist and object move so is the same
    as that the others move along x: each of these becomes the box that it sweeps, from its axis on.
    """
    across = _half_extent(scene, np.tile((0.0, 1.0), (scene.num_objects, 1, 1)))[:, 0]
    swept = replace(
        scene,
        half_extents=np.column_stack((np.full(len(across), layout.depth / 2), across, scene.standing_extents[:, 2])),
        is_box=np.ones_like(scene.is_box),
        is_lying=np.zeros_like(scene.is_lying),
        yaws=np.zeros_like(scene.yaws),
        positions=scene.positions + (layout.depth / 2, 0.0),
    )
    back = approaches.margins.back * np.column_stack((np.cos(yaws), np.sin(yaws)))
    held = scene.positions[own] - back
    x, y = (scene.positions[:, axis] - held[:, axis, None] for axis in (0, 1))
    met_by_held = (x < 0.0) & (np.abs(y) < across[own, None] + across + approaches.margins.held_gap)
    return met_by_held | _hits(approaches, swept, tcp - back, yaws, opening)


def _hits(approaches: SideApproaches, scene: TableScene, tcp: Array, yaws: Array, opening: Array) -> NDArray[np.bool_]:
    """Objects that gripper or wrist touch at k grasps, (k, n)."""
    x, y = (scene.positions[:, axis] - tcp[:, axis, None] for axis in (0, 1))
    c, s = np.cos(yaws)[:, None], np.sin(yaws)[:, None]
    ahead, aside = x * c + y * s, y * c - x * s
    # Most objects are too far away for any solid to touch them, and need no distances.
    solids, padding = approaches.solids, approaches.margins.padding
    reach = np.hypot(scene.standing_extents[:, 0], scene.standing_extents[:, 1]) + (solids.radius.max() + padding)
    behind, before = solids.start.min() - reach, solids.end.max() + reach
    beside = solids.half_width.max() + opening.max(initial=0.0) / 2 + reach
    is_near = (behind < ahead) & (ahead < before) & (np.abs(aside) < beside)
    grasp, other = np.nonzero(is_near)
    ahead, aside = ahead[is_near], aside[is_near]
    half_x, half_y, half_z = scene.standing_extents[other].T
    turn = scene.yaws[other] - yaws[grasp]
    touched = np.zeros(len(other), np.bool_)
    for start, end, width, radius, half_height, is_finger in zip(*solids, strict=True):
        half_length, half_width = (end - start) / 2, width + opening[grasp] * is_finger * 0.5
        centred = ahead - (start + end) / 2
        distance = np.hypot(np.maximum(np.abs(centred) - half_length, 0.0), np.maximum(np.abs(aside) - half_width, 0.0))
        distance -= half_x
        if scene.is_angular[other].any():
            gaps = _rectangle_gaps(centred, aside, (half_length, half_width), (half_x, half_y), turn)
            distance = np.where(scene.is_angular[other], gaps, distance)
        touched |= (distance < radius + padding) & (2 * half_z > approaches.grasp_height - half_height)
    is_near[is_near] = touched
    return is_near


def _rectangle_gaps(
    ahead: Array, aside: Array, half: tuple[float, Array], other_half: tuple[Array, Array], turn: Array
) -> Array:
    """[m] Largest gap over the four edge normals: less than the distance where two corners face each other.

    Args:
        ahead, aside: (p,) [m] from the centre of the first of each pair of rectangles to that of the second.
        half, other_half: half extents [m] of the first along and across the axis of `ahead`, of the second along its
            own axes.
        turn: (p,) [rad] of the second.
    """
    c, s, (half_length, half_width), (half_x, half_y) = np.cos(turn), np.sin(turn), half, other_half
    gaps = (
        np.abs(ahead) - half_length - half_x * np.abs(c) - half_y * np.abs(s),
        np.abs(aside) - half_width - half_x * np.abs(s) - half_y * np.abs(c),
        np.abs(ahead * c + aside * s) - half_x - half_length * np.abs(c) - half_width * np.abs(s),
        np.abs(aside * c - ahead * s) - half_y - half_length * np.abs(s) - half_width * np.abs(c),
    )
    return np.asarray(np.maximum.reduce(gaps))
