"""Numbers of objects that obstruct side grasps, by a fast geometric test without a planner.

For each object and each approach direction, the test lays the outline of the level gripper and the wrist over the
table. An object obstructs the grasp if its footprint touches this outline. Only directions are tested that the robot
reaches on the empty table. They come from a table that was made with the planner (`assets/approaches/<robot>.json`).

Under a shelf the robot drives straight in and out with the arm rigid, as in the planner. There the swept volume of
gripper and wrist is tested too, and on the way out that of the grasped object. The forearm and the rest of the robot
are left out. `docs/suites.md` reports how well the test agrees with the planner.
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
"""Number of an object without a reachable side grasp, even on the empty table."""
WIDEST_YAW = math.radians(75.0)
"""[rad] Largest deviation of an approach from straight ahead, for a table with front access whose layout has no table
of reachable directions."""


class PlannerMargins(NamedTuple):
    """The planner's parameters that the test needs. The script that makes the table of approaches reads them from the
    planner.

    Attributes:
        yaws: number of approach directions to a cylinder, evenly spaced about the vertical.
        padding: [m] that gripper and wrist keep from objects.
        finger_gap: [m] between each finger and the object before the fingers close.
        back: [m] that the gripper retreats under a shelf before it moves straight out.
        held_gap: [m] that a grasped object keeps from others on the way out.
    """

    yaws: int
    padding: float
    finger_gap: float
    back: float
    held_gap: float


class Solids(NamedTuple):
    """Gripper and wrist of a level gripper, seen from above: s rectangles with rounded corners.

    Attributes:
        start, end: (s,) [m] along the approach from the TCP.
        half_width, radius, half_height: (s,) [m].
        is_finger: (s,) whether `half_width` is measured from the pad.
    """

    start: Array
    end: Array
    half_width: Array
    radius: Array
    half_height: Array
    is_finger: NDArray[np.bool_]

    @classmethod
    def of(cls, rows: Sequence[Sequence[float]]) -> Solids:
        """Make the solids from one row of numbers each."""
        start, end, half_width, radius, half_height, is_finger = np.array(rows, np.float64).T
        return cls(start, end, half_width, radius, half_height, is_finger > 0)


@dataclass(frozen=True, eq=False)
class SideApproaches:
    """Side grasps of a robot, read from a file.

    Attributes:
        margins: of the planner.
        solids: outline of gripper and wrist.
        grasp_height: [m] of the TCP above the table. Lower objects have no side grasps.
        palm_reach: [m] largest extent of the object from the TCP towards the palm.
        pad_half_height: [m] of a finger pad, which should not extend above the object.
        reachable: by name of the layout, whether the robot reaches a grasp on the empty table, (nx, ny, yaws). The
            table top is divided evenly into nx by ny cells.
    """

    margins: PlannerMargins
    solids: Solids
    grasp_height: float
    palm_reach: float
    pad_half_height: float
    reachable: dict[str, NDArray[np.bool_]]

    def is_reachable(self, layout: Layout, points: Array, yaws: Array) -> NDArray[np.bool_]:
        """Whether the robot reaches grasps at TCP positions (..., 2) [m] with yaws (...) [rad] on the empty table.

        For a layout without a table of directions, all yaws are accepted if the table is open on all sides, else those
        within `WIDEST_YAW` of straight ahead.
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
    """Full names, see `RobotSpec.full_name`, of the robots that have a table of side approaches."""
    return assets.names("approaches")


@cache
def side_approaches(robot: str) -> SideApproaches:
    """Side approaches of the robot with this full name. The file is read once.

    Raises:
        FileNotFoundError: the robot has no table, see `robots_with_approaches`.
    """
    content = json.loads(assets.path(f"approaches/{robot}.json").read_text())
    margins = PlannerMargins(**content["planner"])
    reachable, digits = {}, margins.yaws // 4
    for name, rows in content["layouts"].items():  # each cell is a bit mask of yaws, in hexadecimal digits
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
    """Reachable side grasps of the objects of a scene, and the objects that obstruct them.

    Attributes:
        own: (k,) slot of the object of each grasp.
        hits: (k, n) whether gripper, wrist or grasped object would touch each object.
    """

    own: NDArray[np.int64]
    hits: NDArray[np.bool_]

    def fewest_blockers(self) -> NDArray[np.int64]:
        """Fewest obstructing objects over the grasps of each object: (n,), `UNREACHABLE` for an object without a
        grasp."""
        count = self.hits.shape[1]
        fewest = np.full(count, count)
        np.minimum.at(fewest, self.own, self.hits.sum(axis=1))
        return np.where(np.isin(np.arange(count), self.own), fewest, UNREACHABLE)

    def can_be_freed(self, target: int) -> bool:
        """Whether a grasp of the target becomes free after all objects are removed that can be removed before it.

        Objects are removed one after another, each by a grasp that is free by then. If the target's blockers wait for
        one another, or for the target, no plan with these grasps removes it.
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
    """Find the reachable side grasps of all objects.

    Args:
        approaches: of the robot.
        layout: the table and its surroundings.
        scene: the objects and their poses.
        max_opening: [m] of the gripper.
    """
    return SideGrasps(*_in_the_way(approaches, layout, scene, max_opening, np.arange(scene.num_objects)))


def count_blockers(
    approaches: SideApproaches, layout: Layout, scene: TableScene, max_opening: float
) -> NDArray[np.int64]:
    """Fewest objects that obstruct a reachable side grasp, for each object, see `SideGrasps.fewest_blockers`."""
    return side_grasps(approaches, layout, scene, max_opening).fewest_blockers()


def estimate_clearances(approaches: SideApproaches, layout: Layout, scene: TableScene, max_opening: float) -> float:
    """Estimate how many objects must be moved before a side grasp reaches the target, by the same test.

    The estimate is the sum of two numbers. The first is the number of objects in the way of the target's best grasp, in
    the way of the best grasps of those objects, and so on. The second is the mean number of objects in the way over all
    reachable grasps of the target. Without a reachable grasp, both are the number of objects.

    Args:
        approaches: of the robot.
        layout: the table and its surroundings.
        scene: the objects and their poses.
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
        hits = hits[~hits[:, scene.target]] & ~is_counted  # the target is still in place while the others are moved
        if len(hits):
            found = hits[hits.sum(axis=1).argmin()]
            is_counted |= found
            waiting += np.flatnonzero(found).tolist()
    return float(np.count_nonzero(is_counted)) + mean


def _in_the_way(
    approaches: SideApproaches, layout: Layout, scene: TableScene, max_opening: float, grasped: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """All reachable side grasps of these objects: slots (k,) of the grasped objects, and whether each object obstructs
    (k, n)."""
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
    """Yaws [rad], openings [m] and whether the grasp exists, each (n, yaws). A box has four grasps, along its axes."""
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
    """Objects that gripper, wrist or grasped object would touch on the straight drive out after k grasps, (k, n).

    The drive goes along -x from the pose to which the gripper retreats. Equivalently, the robot stands still and the
    other objects move along x. So each object is replaced by the box that it sweeps from its axis on.
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
    """Objects that gripper or wrist would touch at k grasps, (k, n)."""
    x, y = (scene.positions[:, axis] - tcp[:, axis, None] for axis in (0, 1))
    c, s = np.cos(yaws)[:, None], np.sin(yaws)[:, None]
    ahead, aside = x * c + y * s, y * c - x * s
    # Most objects are too far away for any solid to touch them, so their distances are not computed.
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
    """Largest gap [m] over the four edge normals. Where two corners face each other it is less than the distance.

    Args:
        ahead, aside: (p,) [m] from the centre of the first of each pair of rectangles to that of the second.
        half: half extents [m] of the first rectangle, along and across the axis of `ahead`.
        other_half: half extents [m] of the second rectangle, along its own axes.
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
