"""Which arm does what: the grippers of the task problem, and the scene with an action's arm active."""

from __future__ import annotations

from assets.robots import RobotSpec
from planners.clearing.commitments import Commitments
from planners.scene import Scene
from planners.symbolic.problem import GRIPPER, SymbolicState
from planners.symbolic.references import reached_by

__all__ = ["gripper_symbol", "gripper_symbols", "held_by_gripper", "with_chosen_arms"]


def gripper_symbol(robot: RobotSpec, arm: str) -> str:
    """The symbol of an arm's gripper: `GRIPPER` of a robot that acts with one arm."""
    return f"{arm}_gripper" if robot.acts_with_all_arms else GRIPPER


def gripper_symbols(robot: RobotSpec) -> tuple[str, ...]:
    """The symbols of the grippers that plans use, that of the active arm first."""
    return tuple(gripper_symbol(robot, arm) for arm in robot.acting_arms)


def held_by_gripper(scene: Scene) -> dict[str, str]:
    """The objects in the grippers of a scene, by the symbols of these."""
    robot = scene.robot
    held = {gripper_symbol(robot, one.arm): one.held.name for one in scene.aside}
    return held if scene.held is None else {gripper_symbol(robot, robot.arm_name): scene.held.name, **held}


def with_chosen_arms(symbols: SymbolicState, scene: Scene, commitments: Commitments) -> SymbolicState:
    """The facts with the arm of each grasp that was chosen as the one that takes its object."""
    if not scene.robot.acts_with_all_arms:
        return symbols
    for name, grasp in commitments.grasps.items():
        symbols = reached_by(symbols, name, gripper_symbol(scene.robot, grasp.arm))
    return symbols
