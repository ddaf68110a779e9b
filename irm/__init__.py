"""Where may the base stand so that the hand reaches? Reachability maps and their inverse.

Example:
    from assets.robots import FETCH
    from irm import FreeSpace, InverseReachabilityMap, ReachabilityMap

    inverse_map = InverseReachabilityMap(ReachabilityMap.build(FETCH))
    floor = FreeSpace.from_boxes([(0.0, 0.0, 0.7, 1.0)], radius=FETCH.base_radius)
    placement = inverse_map.query((0.1, 0.0, 0.85), yaw_range=(-0.8, 0.8), free_space=floor, k=5)
    print(placement.status, placement.poses)
"""

from irm.cache import cached_map
from irm.classical import ClassicalInverseReachabilityMap
from irm.classification import classify, predict
from irm.errors import ReachabilityError
from irm.free_space import FreeSpace
from irm.inverse import InverseReachabilityMap
from irm.kinematics import ArmChain
from irm.placement import BasePlacement, PlacementBatch
from irm.reachability import ReachabilityMap
from irm.status import Status
from irm.verification import NotVerified, Verified, hand_poses, verify

__all__ = [
    "ArmChain",
    "BasePlacement",
    "ClassicalInverseReachabilityMap",
    "FreeSpace",
    "InverseReachabilityMap",
    "NotVerified",
    "PlacementBatch",
    "ReachabilityError",
    "ReachabilityMap",
    "Status",
    "Verified",
    "cached_map",
    "classify",
    "hand_poses",
    "predict",
    "verify",
]
