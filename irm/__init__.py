"""Reachability maps and inverse reachability maps: base poses from which an arm reaches a TCP pose.

Example:
    from assets.robots import FETCH
    from irm import FreeSpace, InverseReachabilityMap, cached_map, robot_radius

    inverse_map = InverseReachabilityMap(cached_map(FETCH))  # built at the first call
    floor = FreeSpace.from_boxes([(0.0, 0.0, 0.7, 1.0)], radius=robot_radius(FETCH, 0.0, 0.75))
    placement = inverse_map.query((0.1, 0.0, 0.85), yaw_range=(-0.8, 0.8), free_space=floor, k=5)
    print(placement.status, placement.poses)
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from irm.answers import BasePlacement, PlacementBatch, Status
    from irm.chain import PRISMATIC, ArmChain, JointRow, frames_of, pose_of
    from irm.errors import QueryError, ReachabilityError
    from irm.free_space import FreeSpace
    from irm.grid import MapParameters
    from irm.ik.solvers import (
        CLOSED_FORM,
        ITERATIVE,
        PARALLEL,
        SPHERICAL,
        ExactSolver,
        SelfCollision,
        all_solutions,
        free_angles,
        solver_arrays,
    )
    from irm.inverse_map import ClassicalInverseReachabilityMap, InverseReachabilityMap
    from irm.kinematics import fk_frames, forward, link_origins
    from irm.reachability_map import ReachabilityMap, cache_folder, cached_map, is_map_at_hand
    from irm.robot_shape import SolidBoxes, robot_radius
    from irm.tolerance import TolerantPlacement, query_tolerant
    from irm.verification import NotVerified, Verified, classify, compare_with_model, decide, tcp_poses, verify

__all__ = [
    "CLOSED_FORM",
    "ITERATIVE",
    "PARALLEL",
    "PRISMATIC",
    "SPHERICAL",
    "ArmChain",
    "BasePlacement",
    "ClassicalInverseReachabilityMap",
    "ExactSolver",
    "FreeSpace",
    "InverseReachabilityMap",
    "JointRow",
    "MapParameters",
    "NotVerified",
    "PlacementBatch",
    "QueryError",
    "ReachabilityError",
    "ReachabilityMap",
    "SelfCollision",
    "SolidBoxes",
    "Status",
    "TolerantPlacement",
    "Verified",
    "all_solutions",
    "cache_folder",
    "cached_map",
    "classify",
    "compare_with_model",
    "decide",
    "fk_frames",
    "forward",
    "frames_of",
    "free_angles",
    "is_map_at_hand",
    "link_origins",
    "pose_of",
    "query_tolerant",
    "robot_radius",
    "solver_arrays",
    "tcp_poses",
    "verify",
]


_MODULES = (
    *("errors", "answers", "free_space", "chain", "grid", "kinematics", "robot_shape", "reachability_map"),
    *("inverse_map", "ik.solvers", "verification", "tolerance"),
)
"""Modules of the public names, in search order. The modules that import the least come first."""

if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        """Import a public name at its first use. Some users need only light modules, without any compiled kernel."""
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        for module in _MODULES:
            if (found := getattr(import_module(f"irm.{module}"), name, None)) is not None:
                globals()[name] = found
                return found
        raise AssertionError(f"no module of irm has {name}")
