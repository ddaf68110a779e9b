"""Task and motion planning: what to do, in which order, along which path.

Example:
    scene = Scene.from_mujoco(env.unwrapped.model, env.unwrapped.data, env.unwrapped.robot)
    solution = solve(scene, "object_03")
"""

from planners.execution.expert import EpisodeReport, TampExpert
from planners.planner import Planner, clearance_floor, solve
from planners.scene import Scene
from planners.tamp.solution import Infeasible, Solution

__all__ = [
    "EpisodeReport",
    "Infeasible",
    "Planner",
    "Scene",
    "Solution",
    "TampExpert",
    "clearance_floor",
    "solve",
]
