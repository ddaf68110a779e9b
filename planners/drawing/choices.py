"""What each choice of a clearance location in a plan saw, worked out again from the plan: for drawing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irm.arm.kinematics import ArmChain
from planners.collision.world import CollisionWorld
from planners.drawing.region import ClearancePicture
from planners.grasping.arm_configurations import ConfigurationGrid, GripperPoses, scan_configurations
from planners.motion.arm import tcp_pose
from planners.placing.locations import placement_grid
from planners.placing.negative_goal_region import (
    SupportGrid,
    clearance_candidates,
    dilated,
    footprint_mask,
    negative_goal_region,
)
from planners.placing.static_footprint import static_mask
from planners.placing.swept_volume import configuration_volume
from planners.scene import Body, HeldObject, RobotState, Scene
from planners.strategies import Strategy
from planners.tamp.solution import BoundAction, Solution

__all__ = ["Choice", "choices_of", "final_scene", "outlines_on_support"]

Array = NDArray[np.float64]

_WORK_CELL = 0.025
"""[m] of the cells for which it is asked whether the arm reaches them."""
_WORK_YAWS = 8
_WORK_TORSOS, _WORK_ROLLS = 3, 9
"""Hand yaws, torso heights and upper-arm rolls tried for each of them."""
_ON_TOP = 0.001
"""[m] above the support: what is lower does not stand out of it."""
_MARGIN = 0.006
"""[m] between the object put down and what stands around."""


@dataclass(frozen=True, eq=False)
class Choice:
    """One clearance.

    Attributes:
        name: the object put aside.
        blocked: what it was in the way of.
        picture: of the table at that moment.
        base: (3,) where the robot stands when it takes the object.
        put_base: (3,) where it stands when it puts it down.
    """

    name: str
    blocked: str
    picture: ClearancePicture
    base: Array
    put_base: Array


@dataclass(frozen=True, eq=False)
class _Hold:
    """The moment at which the fingers close or open: the robot, and the object between them."""

    state: RobotState
    opening: float
    touched: HeldObject


def choices_of(solution: Solution, scene: Scene, target: str, strategy: Strategy) -> list[Choice]:
    """The choices of a plan made for a scene, in order."""
    choices: list[Choice] = []
    for index, action in enumerate(solution.actions):
        if action.name.startswith("PutDown"):
            later = [step for step in solution.actions[index:] if step.name == "PickUp"]
            picked = next(step for step in reversed(solution.actions[:index]) if step.name == "PickUp")
            choices.append(_choice(scene, target, strategy, picked, action, later, [c.name for c in choices]))
            scene = scene.with_body(_put_down(scene, action))
    return choices


def outlines_on_support(scene: Scene) -> list[Array]:
    """Corners (k, 2) [m] from above of each static obstacle that stands on the support or beside it and is higher."""
    top = scene.support.top
    return [one.outline for one in scene.static_obstacles if one.lower[2] < top + _ON_TOP and one.top > top + _ON_TOP]


def final_scene(solution: Solution, scene: Scene) -> Scene:
    """The scene with every cleared object where the plan leaves it."""
    for action in solution.actions:
        if action.name.startswith("PutDown"):
            scene = scene.with_body(_put_down(scene, action))
    return scene


def _choice(
    scene: Scene,
    target: str,
    strategy: Strategy,
    picked: BoundAction,
    put: BoundAction,
    later: Sequence[BoundAction],
    cleared: Sequence[str],
) -> Choice:
    grid = SupportGrid.over(scene.support)
    world = CollisionWorld.from_scene(scene)
    body = scene.body(put.target)
    taken, left = _hold(picked, "close"), _hold(put, "open")
    grasps = {step.target: _hold(step, "close") for step in later}
    volumes = {
        name: configuration_volume(world, hold.state.base, hold.state.q, hold.opening) for name, hold in grasps.items()
    }
    obstacles = [name for name in grasps if name != target and strategy.region == "ngr"]
    height = body.top - body.bottom
    region = negative_goal_region(
        grid,
        height,
        scene.body(target),
        volumes[target],
        [scene.body(name) for name in obstacles],
        [volumes[name] for name in obstacles],
    )
    others = [other for other in scene.objects if other.name != body.name]
    occupied = footprint_mask(grid, others, _MARGIN) | static_mask(scene, grid, height, _MARGIN)
    in_work = _work_mask(world, grid, taken.state.base, taken.touched, body)
    candidates = placement_grid(scene.support)
    forbidden = grid.empty() if strategy.region == "none" else region.mask
    reached = _at(grid, in_work, candidates)
    ordered = clearance_candidates(grid, forbidden, occupied, body.radius, candidates, reached, taken.state.base[:2])
    picture = ClearancePicture(
        grid,
        region,
        scene.objects,
        target,
        obstacles,
        in_work,
        candidates,
        ordered,
        chosen=_put_down(scene, put).position[:2],
        grown=dilated(grid, forbidden | occupied, body.radius),
        moved=body.name,
        cleared=cleared,
        stands=np.array([taken.state.base[:2], left.state.base[:2]]),
        outlines=outlines_on_support(scene),
    )
    blocked = put.args[1] if put.name == "PutDownForClearance" else ""
    return Choice(body.name, blocked, picture, taken.state.base, left.state.base)


def _hold(action: BoundAction, phase_name: str) -> _Hold:
    """The robot when a phase of the action's motion begins."""
    trajectory = action.trajectory
    phase = next(phase for phase in trajectory.phases if phase.name == phase_name)
    assert phase.touched is not None
    sample = trajectory.sample(phase.start)
    return _Hold(RobotState(sample.base, sample.q, sample.finger_position), 2 * sample.finger_position, phase.touched)


def _put_down(scene: Scene, action: BoundAction) -> Body:
    """The object where it is let go."""
    hold = _hold(action, "open")
    return scene.body(action.target).at_pose(tcp_pose(scene.robot, hold.state) @ hold.touched.T_tcp_object)


def _work_mask(
    world: CollisionWorld, grid: SupportGrid, base: Array, held: HeldObject, body: Body
) -> NDArray[np.bool_]:
    """R_work: cells at which the arm can put the object down without driving, whatever else stands there."""
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
        gripper_poses = np.column_stack((np.tile(centre, (_WORK_YAWS, 1)), np.full(_WORK_YAWS, height), yaws))
        found = scan_configurations(
            world, chain, GripperPoses(bases, gripper_poses), configurations, 0.0, ignore=everything, first_free=True
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
