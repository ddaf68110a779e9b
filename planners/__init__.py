"""Task and motion planning: what to do, in which order, along which path.

Example:
    scene = Scene.from_mujoco(env.unwrapped.model, env.unwrapped.data, env.unwrapped.robot)
    solution = solve(scene, "object_03")
"""

from planners.expert import EpisodeReport, TampExpert
from planners.scene import Scene
from planners.solution import Infeasible, Solution
from planners.solve import Planner, clearance_floor, solve

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
