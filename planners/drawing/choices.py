"""Choice of each clearance location in a plan: its regions and candidates, computed again from the plan.

`planners.drawing.pictures` draws them from above, the page in 3-D.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from irm.chain import ArmChain
from planners.collision.world import CollisionWorld
from planners.grasping.arm_configurations import ConfigurationGrid, GripperPoses, scan_configurations
from planners.placing.locations import placement_grid
from planners.placing.negative_goal_region import (
    NegativeGoalRegion,
    SupportGrid,
    SweptVolume,
    clearance_order,
    dilated,
    join_volumes,
    negative_goal_region,
)
from planners.placing.surfaces import Surface
from planners.placing.swept_volume import path_volume
from planners.scene import Body, HeldObject, Scene
from planners.tamp.solution import BoundAction, Solution

Array = NDArray[np.float64]

_WORK_CELL = 0.025
"""Size [m] of the cells that are tested for reachability."""
_WORK_YAWS = 8
_WORK_TORSOS, _WORK_ROLLS = 3, 9
"""Gripper yaws, torso heights and upper-arm rolls to try for each cell."""
_ON_TOP = 0.001
"""Height [m] above the support. Obstacles below it do not stick out."""
_STRAIGHT = ("approach", "close", "lift")
"""Phases of a pick-up between its free motions."""
_SAME_BASE = 1e-3
"""Difference [m], [rad] below which two base poses are the same."""


@dataclass(frozen=True, eq=False)
class DrawnSurface:
    """Top face of a support: its cells, and the keep-out region of the object.

    If given, the mask of R_work over the grid, and the cells to avoid for the object's centre, are drawn.
    """

    grid: SupportGrid
    region: NegativeGoalRegion
    in_work: NDArray[np.bool_] | None = None
    grown: NDArray[np.bool_] | None = None


@dataclass(frozen=True, eq=False)
class ClearancePicture:
    """The supports at the choice of one clearance location, or before the target is taken.

    Attributes:
        surfaces, bodies: top faces of the supports, and all objects on them.
        target, obstacles: names of the target and of the objects still to clear after this one.
        candidates: (n, 2) placement locations [m].
        ordered: (m, 2) allowed candidates, best first.
        chosen: (2,) the chosen location, or None.
        moved: name of the object to put aside, "" for none.
        obstructed: name of the object that it obstructs, "" for no particular one.
        is_far: whether the base drives between pick and put-down.
        cleared: names of the objects put aside before.
        stands: (k, 2) base positions [m], first of the pick, then of the put-down.
        outlines: (k, 2) corners [m] of each static obstacle on the support.
    """

    surfaces: Sequence[DrawnSurface]
    bodies: Sequence[Body]
    target: str
    obstacles: Sequence[str] = ()
    candidates: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    ordered: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    chosen: NDArray[np.float64] | None = None
    moved: str = ""
    obstructed: str = ""
    is_far: bool = False
    cleared: Sequence[str] = ()
    stands: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    outlines: Sequence[NDArray[np.float64]] = ()

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Extent (x low, x high, y low, y high) [m] of all surfaces together."""
        low = np.min([surface.grid.extent for surface in self.surfaces], axis=0)
        high = np.max([surface.grid.extent for surface in self.surfaces], axis=0)
        return float(low[0]), float(high[1]), float(low[2]), float(high[3])

    @property
    def moved_body(self) -> Body | None:
        """Object to put aside. None if it is in the gripper from the start, or if none is put aside."""
        return next((body for body in self.bodies if body.name == self.moved), None)

    def kind(self, body: Body) -> str:
        """Role of an object in this picture."""
        if body.name == self.target:
            return "target"
        if body.name == self.moved:
            return "moved"
        if body.name in self.cleared:
            return "cleared"
        return "obstacle" if body.name in self.obstacles else "object"


@lru_cache(maxsize=1)  # the page and the pictures of an episode show the same plan
def choices_of(solution: Solution) -> tuple[ClearancePicture, ...]:
    """Choices of clearance locations in a plan, in order. A place that a goal gives is no choice."""
    pictures: list[ClearancePicture] = []
    for index, action in enumerate(solution.actions):
        if action.surfaces:
            picked = next((step for step in reversed(solution.actions[:index]) if step.name == "PickUp"), None)
            later = [step.target for step in solution.actions[index:] if step.name == "PickUp"]
            pictures.append(_choice(solution.target, action, picked, later, [picture.moved for picture in pictures]))
    return tuple(pictures)


def last_picture(solution: Solution) -> ClearancePicture:
    """The supports after all clearances, with NGR1, the swept volume of the target's pick."""
    if not solution.actions:
        raise ValueError("a plan without actions has nothing to draw")
    taken = solution.actions[-1]
    scene, volume = taken.scene, swept_by(taken)
    last = scene.body(solution.clearances[-1] if solution.clearances else solution.target)
    put = next((action for action in solution.actions if action.surfaces), None)
    supports = [scene.support] if put is None else [surface.support for surface in put.surfaces]
    grids = [SupportGrid.over(support) for support in supports]
    return ClearancePicture(
        [DrawnSurface(grid, negative_goal_region(grid, last.top - last.bottom, volume)) for grid in grids],
        scene.objects,
        solution.target,
        cleared=solution.clearances,
        stands=taken.trajectory.base[-1:, :2],
        outlines=_outlines_on_support(scene),
    )


def _outlines_on_support(scene: Scene) -> list[Array]:
    """Corners (k, 2) [m] seen from above of the static obstacles on or next to the support that are higher."""
    top = scene.support.top
    return [one.outline for one in scene.static_obstacles if one.lower[2] < top + _ON_TOP and one.top > top + _ON_TOP]


def _choice(
    target: str, put: BoundAction, picked: BoundAction | None, later: Sequence[str], cleared: Sequence[str]
) -> ClearancePicture:
    """Regions and candidates of a put-down. The regions are those that the planner kept clear.

    `picked` is the action that takes the object, None if it is in the gripper from the start. `later` has the names of
    objects taken afterwards, the target last. `cleared` has the names of objects put aside before.
    """
    scene = put.scene if picked is None else picked.scene
    assert put.grip is not None
    body, (put_state, held) = scene.body(put.target), put.grip
    start = put.scene.state.base if picked is None or picked.grip is None else picked.grip[0].base
    world, radius, released = CollisionWorld.from_scene(scene), body.radius, put.released
    drawn, candidates, free = [], [], []
    for surface in put.surfaces:
        grown = dilated(surface.grid, surface.blocked, radius)
        in_work = _work_mask(world, surface, start, held, body)
        drawn.append(DrawnSurface(surface.grid, surface.region, in_work, grown))
        candidates.append(placement_grid(surface.support))
        free.append(surface.free(candidates[-1], radius)[:, :2])
    allowed = np.concatenate(free)
    reached = np.any([_at(one.grid, one.in_work, allowed) for one in drawn if one.in_work is not None], axis=0)
    return ClearancePicture(
        drawn,
        scene.objects,
        target,
        [name for name in later if name != target],
        np.concatenate(candidates),
        allowed[clearance_order(allowed, reached, start[:2])],
        chosen=None if released is None else released.position[:2],
        moved=body.name,
        obstructed=put.obstructed,
        is_far=not np.allclose(start, put_state.base, atol=_SAME_BASE),
        cleared=cleared,
        stands=np.array([start[:2], put_state.base[:2]]),
        outlines=_outlines_on_support(scene),
    )


def swept_by(picked: BoundAction) -> SweptVolume:
    """Swept volume of a pick on its straight lines: of the robot, and from the lift on of the object too."""
    trajectory, world = picked.trajectory, CollisionWorld.from_scene(picked.scene)
    ends = [*(phase.start for phase in trajectory.phases[1:]), np.inf]
    volumes = []
    for phase, end in zip(trajectory.phases, ends, strict=True):
        during = (trajectory.times >= phase.start) & (trajectory.times <= end)
        if phase.name in _STRAIGHT and during.any():
            X = np.hstack((trajectory.base[during], trajectory.q[during]))
            opening = world.scene.robot.opening(float(trajectory.finger_position[during].max()))
            volumes.append(path_volume(world, X, opening, phase.touched if phase.held else None))
    return join_volumes(volumes)


def _work_mask(world: CollisionWorld, surface: Surface, base: Array, held: HeldObject, body: Body) -> NDArray[np.bool_]:
    """R_work: cells where the arm can put the object down without a drive, with other objects ignored."""
    grid, cells = surface.grid, SupportGrid.over(surface.support, _WORK_CELL)
    centres = cells.centres().reshape(-1, 2)
    yaws = np.arange(_WORK_YAWS) * (2 * np.pi / _WORK_YAWS)
    height = grid.height + (body.top - body.bottom) / 2 - held.T_tcp_object[2, 3]
    bases = np.tile(base, (_WORK_YAWS, 1))
    chain = ArmChain.from_robot(world.scene.robot)
    configurations = ConfigurationGrid.over(chain, _WORK_TORSOS, _WORK_ROLLS)
    everything = world.scene.mask(world.scene.names)
    reached = np.zeros(len(centres), dtype=np.bool_)
    for index, (x, y) in enumerate(centres):
        poses = GripperPoses(bases, np.array([(x, y, height, yaw, 0.0) for yaw in yaws]))
        found = scan_configurations(world, poses, configurations, 0.0, ignore=everything, first_free=True)
        reached[index] = len(found.q) > 0
    coarse = reached.reshape(cells.shape)
    return _at(cells, coarse, grid.centres().reshape(-1, 2)).reshape(grid.shape)


def _at(grid: SupportGrid, mask: NDArray[np.bool_], points: Array) -> NDArray[np.bool_]:
    """Values of the mask at points (n, 2), False outside the grid."""
    cells = np.floor((points - (grid.x0, grid.y0)) / grid.resolution).astype(int)
    is_inside = ((cells >= 0) & (cells < grid.shape)).all(axis=1)
    cells = np.clip(cells, 0, np.array(grid.shape) - 1)
    values: NDArray[np.bool_] = mask[cells[:, 0], cells[:, 1]] & is_inside
    return values
