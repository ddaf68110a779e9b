"""Where may the base stand so that the arm reaches a TCP pose? Reachability maps and their inverse.

Example:
    from assets.robots import FETCH
    from irm import FreeSpace, InverseReachabilityMap, cached_map, robot_radius

    inverse_map = InverseReachabilityMap(cached_map(FETCH))  # built at the first call
    floor = FreeSpace.from_boxes([(0.0, 0.0, 0.7, 1.0)], radius=robot_radius(FETCH, 0.0, 0.75))
    placement = inverse_map.query((0.1, 0.0, 0.85), yaw_range=(-0.8, 0.8), free_space=floor, k=5)
    print(placement.status, placement.poses)
"""

from irm.arm.frames import PRISMATIC, frames_of, pose_of
from irm.arm.kinematics import ArmChain
from irm.checks.classification import classify, predict
from irm.checks.decide import decide
from irm.checks.verification import NotVerified, Verified, tcp_poses, verify
from irm.errors import ReachabilityError
from irm.floor.free_space import FreeSpace
from irm.floor.robot_outline import robot_radius
from irm.floor.solid_boxes import SolidBoxes
from irm.maps.cache import cache_folder, cached_map, cached_table, is_map_at_hand
from irm.maps.certificate.table import CertificateTable
from irm.maps.parameters import MapParameters
from irm.maps.pose_tables import read_pose_table, read_reuleaux
from irm.maps.reachability import ReachabilityMap
from irm.queries.classical import ClassicalInverseReachabilityMap
from irm.queries.inverse import InverseReachabilityMap
from irm.queries.placement import BasePlacement, PlacementBatch
from irm.queries.status import Status
from irm.visibility.map import VisibilityMap, cached_visibility

__all__ = [
    "PRISMATIC",
    "ArmChain",
    "BasePlacement",
    "CertificateTable",
    "ClassicalInverseReachabilityMap",
    "FreeSpace",
    "InverseReachabilityMap",
    "MapParameters",
    "NotVerified",
    "PlacementBatch",
    "ReachabilityError",
    "ReachabilityMap",
    "SolidBoxes",
    "Status",
    "Verified",
    "VisibilityMap",
    "cache_folder",
    "cached_map",
    "cached_table",
    "cached_visibility",
    "classify",
    "decide",
    "frames_of",
    "is_map_at_hand",
    "pose_of",
    "predict",
    "read_pose_table",
    "read_reuleaux",
    "robot_radius",
    "tcp_poses",
    "verify",
]
