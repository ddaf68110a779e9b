"""Task and motion planning: what to do, in which order, along which path.

Example:
    scene = Scene.from_mujoco(env.unwrapped.model, env.unwrapped.data, env.unwrapped.robot)
    solution = solve(scene, "object_03")

A strategy and a task planner of your own are passed as objects: a `Strategy`, anything with the `TaskPlanner` protocol.
"""

from planners.arms import ArmsError
from planners.cause import Cause
from planners.clearing.minimum_clearances import ClearanceFloor, FloorLimits
from planners.execution.controlled_env import ControlledEnv
from planners.execution.direct import ExecutionResult, execute
from planners.execution.expert import EpisodeReport, ExpertConfig, ExpertError, TampExpert
from planners.planner import Planner, clearance_floor, solve, warmup
from planners.scene import Scene
from planners.strategies import STRATEGIES, Strategy
from planners.symbolic.problem import GroundAction, NoPlan, SymbolicState, TaskPlan, TaskPlanner, TaskProblem
from planners.tamp.solution import BoundAction, Infeasible, PlanFileError, Solution

__all__ = [
    "STRATEGIES",
    "ArmsError",
    "BoundAction",
    "Cause",
    "ClearanceFloor",
    "ControlledEnv",
    "EpisodeReport",
    "ExecutionResult",
    "ExpertConfig",
    "ExpertError",
    "FloorLimits",
    "GroundAction",
    "Infeasible",
    "NoPlan",
    "PlanFileError",
    "Planner",
    "Scene",
    "Solution",
    "Strategy",
    "SymbolicState",
    "TampExpert",
    "TaskPlan",
    "TaskPlanner",
    "TaskProblem",
    "clearance_floor",
    "execute",
    "solve",
    "warmup",
]
