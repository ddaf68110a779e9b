"""Maps small enough for tests, and a second robot: six joints on a lift, without a closed form."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from assets.robots import FETCH, ChainLink
from irm.free_space import FreeSpace
from irm.inverse_map import InverseReachabilityMap
from irm.reachability_map import ReachabilityMap

LIFT_ARM = dataclasses.replace(
    FETCH,
    name="lift_arm",
    ahead=(),
    mjcf=str(Path(__file__).resolve().parents[1] / "data" / "arms" / "lift_arm.xml"),
    head_joints=(),
    head_configuration=(),
    finger_joints=("finger_r", "finger_l"),
    max_finger_position=0.04,
    chain=(
        ChainLink("lift", (0.05, 0.0, 0.4), "z", 0.0, 0.3, prismatic=True),
        ChainLink("pan", (0.0, 0.0, 0.2), "z", -2.9, 2.9),
        ChainLink("shoulder", (0.0, 0.0, 0.1), "y", -2.0, 2.0),
        ChainLink("elbow", (0.42, 0.0, 0.0), "y", -2.6, 2.6),
        ChainLink("wrist_pitch", (0.39, 0.05, 0.0), "y", -2.2, 2.2),
        ChainLink("wrist_yaw", (0.09, 0.0, 0.0), "z", -1.8, 1.8),
        ChainLink("wrist_roll", (0.08, 0.0, 0.0), "x", -2.5, 2.5),
    ),
    tcp_offset=(0.12, 0.0, 0.0),
    max_velocity=FETCH.max_velocity[:10],
    max_acceleration=FETCH.max_acceleration[:10],
    home=(0.1, 0.0, -0.9, 1.6, -0.7, 0.0, 0.0),
    closed_form_ik="",
)


@pytest.fixture(scope="session")
def lift_arm():
    return LIFT_ARM


@pytest.fixture(scope="session")
def coarse_map():
    """Fetch, every pitch and height, coarse."""
    return ReachabilityMap.build(FETCH, voxel=0.1, orientations=62)


@pytest.fixture(scope="session")
def coarse_inverse(coarse_map):
    return InverseReachabilityMap(coarse_map)


@pytest.fixture(scope="session")
def level_map():
    """Fetch with a level gripper above tables, as a planner would want it."""
    return ReachabilityMap.build(FETCH, orientations=266, pitches=(0.0,), heights=(0.7, 1.2))


@pytest.fixture(scope="session")
def level_inverse(level_map):
    return InverseReachabilityMap(level_map)


@pytest.fixture(scope="session")
def lift_arm_map():
    return ReachabilityMap.build(LIFT_ARM, voxel=0.15, orientations=26, samples=100_000)


@pytest.fixture(scope="session")
def table_floor():
    """Floor around the paper's table, grown by 0.3 m as in its Fig. 2."""
    return FreeSpace.from_boxes([(0.0, 0.0, 0.8, 1.6)], radius=0.3)


@pytest.fixture
def cups():
    """(n, 3) TCP positions above that table."""
    rng = np.random.default_rng(7)
    return np.column_stack([rng.uniform(-0.35, 0.35, 60), rng.uniform(-0.75, 0.75, 60), rng.uniform(0.78, 0.98, 60)])
