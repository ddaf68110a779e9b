"""Regions and candidates behind each clearance location of a plan, computed again from the plan: for drawing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irm.arm.kinematics import ArmChain
from planners.collision.world import CollisionWorld
from planners.drawing.region import ClearancePicture
from planners.grasping.arm_configurations import ConfigurationGrid, GripperPoses, scan_configurations
from planners.placing.locations import placement_grid
from planners.placing.negative_goal_region import (
    SupportGrid,
    SweptVolume,
    clearance_candidates,
    dilated,
    footprint_mask,
    negative_goal_region,
)
from planners.placing.static_footprint import static_mask
from planners.placing.swept_volume import configuration_volume
from planners.scene import Body, HeldObject, RobotState, Scene
from planners.tamp.solution import BoundAction, Solution

__all__ = ["Choice", "choices_of", "last_picture"]

Array = NDArray[np.float64]

_WORK_CELL = 0.025
"""[m] size of the cells that are tested for reachability."""
_WORK_YAWS = 8
_WORK_TORSOS, _WORK_ROLLS = 3, 9
"""Gripper yaws, torso heights and upper-arm rolls tried for each of them."""
_ON_TOP = 0.001
"""[m] above the support; lower obstacles do not stand out of it."""
_MARGIN = 0.006
"""[m] between the object put down and the objects around it."""
_SAME_BASE = 1e-3
"""[m], [rad] below which two base poses are the same."""


@dataclass(frozen=True, eq=False)
class Choice:
    """One clearance.

    Attributes:
        name: the object put aside.
        obstructed: name of the object that it obstructs, "" if it is put aside for no particular object.
        picture: the table at that moment.
        is_far: whether the base drives between taking the object and putting it down.
    """

    name: str
    obstructed: str
    picture: ClearancePicture
    is_far: bool


@dataclass(frozen=True, eq=False)
class _Hold:
    """The moment at which the fingers close or open: the robot, and the object between them."""

    state: RobotState
    opening: float
    touched: HeldObject


def choices_of(solution: Solution) -> list[Choice]:
    """The choices of clearance locations in a plan, in order."""
    choices: list[Choice] = []
    for index, action in enumerate(solution.actions):
        if action.is_clearance:
            picked = next((step for step in reversed(solution.actions[:index]) if step.name == "PickUp"), None)
            later = [step for step in solution.actions[index:] if step.name == "PickUp"]
            choices.append(_choice(solution, action, picked, later, [choice.name for choice in choices]))
    return choices


def last_picture(solution: Solution) -> ClearancePicture:
    """The table when everything has been cleared, and NGR1: what taking the target sweeps.

    Raises:
        ValueError: the plan does not take the target, because it is in the gripper from the start.
    """
    if not solution.actions:
        raise ValueError("a plan without actions has nothing to draw")
    taken = solution.actions[-1]
    scene = taken.scene
    grid = SupportGrid.over(scene.support)
    last = scene.body(solution.clearances[-1] if solution.clearances else solution.target)
    return ClearancePicture(
        grid,
        negative_goal_region(grid, last.top - last.bottom, scene.body(solution.target), _swept(taken)),
        scene.objects,
        solution.target,
        cleared=solution.clearances,
        stands=taken.trajectory.base[-1:, :2],
        outlines=_outlines_on_support(scene),
    )


def _outlines_on_support(scene: Scene) -> list[Array]:
    """Corners (k, 2) [m] from above of each static obstacle that stands on the support or beside it and is higher."""
    top = scene.support.top
    return [one.outline for one in scene.static_obstacles if one.lower[2] < top + _ON_TOP and one.top > top + _ON_TOP]


def _choice(
    solution: Solution,
    put: BoundAction,
    picked: BoundAction | None,
    later: Sequence[BoundAction],
    cleared: Sequence[str],
) -> Choice:
    """The regions and candidates behind the location of a put-down.

    Args:
        solution: the plan.
        put: the put-down.
        picked: the action that takes the object, None if it is in the gripper from the start.
        later: the actions after the put-down that take objects, the target's last.
        cleared: names of the objects put aside before.
    """
    scene = put.scene if picked is None else picked.scene
    grid, body, left = SupportGrid.over(scene.support), scene.body(put.target), _hold(put, "open")
    start = put.scene.state.base if picked is None else _hold(picked, "close").state.base
    obstacles = [step for step in later if step.target != solution.target and solution.strategy.region == "ngr"]
    height = body.top - body.bottom
    region = negative_goal_region(
        grid,
        height,
        scene.body(solution.target),
        _swept(later[-1]),
        [scene.body(step.target) for step in obstacles],
        [_swept(step) for step in obstacles],
    )
    others = [other for other in scene.objects if other.name != body.name]
    occupied = footprint_mask(grid, others, _MARGIN) | static_mask(scene, scene.support, grid, height, _MARGIN)
    in_work = _work_mask(CollisionWorld.from_scene(scene), grid, start, left.touched, body)
    candidates = placement_grid(scene.support)
    forbidden = grid.empty() if solution.strategy.region == "none" else region.mask
    reached = _at(grid, in_work, candidates)
    released = put.released
    picture = ClearancePicture(
        grid,
        region,
        scene.objects,
        solution.target,
        [step.target for step in obstacles],
        in_work,
        candidates,
        clearance_candidates(grid, forbidden, occupied, body.radius, candidates, reached, start[:2]),
        chosen=None if released is None else released.position[:2],
        grown=dilated(grid, forbidden | occupied, body.radius),
        moved=body.name,
        cleared=cleared,
        stands=np.array([start[:2], left.state.base[:2]]),
        outlines=_outlines_on_support(scene),
    )
    return Choice(body.name, put.obstructed, picture, not np.allclose(start, left.state.base, atol=_SAME_BASE))


def _swept(picked: BoundAction) -> SweptVolume:
    """What the robot occupies when it grasps the object of a pick-up."""
    hold = _hold(picked, "close")
    world = CollisionWorld.from_scene(picked.scene)
    return configuration_volume(world, hold.state.base, hold.state.q, hold.opening)


def _hold(action: BoundAction, phase_name: str) -> _Hold:
    """The robot when a phase of the action's motion begins."""
    trajectory = action.trajectory
    phase = next(phase for phase in trajectory.phases if phase.name == phase_name)
    assert phase.touched is not None
    sample = trajectory.sample(phase.start)
    return _Hold(RobotState(sample.base, sample.q, sample.finger_position), 2 * sample.finger_position, phase.touched)


def _work_mask(
    world: CollisionWorld, grid: SupportGrid, base: Array, held: HeldObject, body: Body
) -> NDArray[np.bool_]:
    """R_work: cells at which the arm can put the object down without driving, other objects ignored."""
    cells = SupportGrid.over(world.scene.support, _WORK_CELL)
    centres = cells.centres().reshape(-1, 2)
    yaws = np.arange(_WORK_YAWS) * (2 * np.pi / _WORK_YAWS)
    height = grid.height + (body.top - body.bottom) / 2 - held.T_tcp_object[2, 3]
    bases = np.tile(base, (_WORK_YAWS, 1))
    chain = ArmChain.from_robot(world.scene.robot)
    configurations = ConfigurationGrid.over(chain, _WORK_TORSOS, _WORK_ROLLS)
    everything = world.scene.mask(world.scene.names)
    reached = np.zeros(len(centres), dtype=np.bool_)
    for index, centre in enumerate(centres):
        level = np.column_stack(
            (np.tile(centre, (_WORK_YAWS, 1)), np.full(_WORK_YAWS, height), yaws, np.zeros(_WORK_YAWS))
        )
        found = scan_configurations(
            world, GripperPoses(bases, level), configurations, 0.0, ignore=everything, first_free=True
        )
        reached[index] = len(found.q) > 0
    coarse = reached.reshape(cells.shape)
    return _at(cells, coarse, grid.centres().reshape(-1, 2)).reshape(grid.shape)


def _at(grid: SupportGrid, mask: NDArray[np.bool_], points: Array) -> NDArray[np.bool_]:
    """The mask's values at points (n, 2)."""
    cells = ((points - (grid.x0, grid.y0)) / grid.resolution).astype(int)
    cells = np.clip(cells, 0, np.array(grid.shape) - 1)
    values: NDArray[np.bool_] = mask[cells[:, 0], cells[:, 1]]
    return values
