"""The direct route of the inverse kinematics equals mink's; the pose arithmetic equals mink's Lie groups."""

from __future__ import annotations

import mink
import numpy as np
import pytest

from assets.robots import FETCH
from clutter_env.config import EnvConfig
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.errors import ConfigError
from clutter_env.simulation.ee_control import EndEffectorController
from clutter_env.simulation.pose_arithmetic import (
    inverse_left_jacobian,
    pose_difference,
    rotated,
    rotation_vector,
    turned_by,
)

CONFIGURATIONS = 900
LOWER = np.array([max(link.lower, -6.0) for link in FETCH.chain])
UPPER = np.array([min(link.upper, 6.0) for link in FETCH.chain])


def random_rotation(rng: np.random.Generator, size: float) -> tuple[float, float, float, float]:
    return turned_by((1.0, 0.0, 0.0, 0.0), tuple(rng.normal(0, size, 3)))


def test_the_direct_route_equals_mink() -> None:
    rng = np.random.default_rng(0)
    direct, reference = EndEffectorController(FETCH, "direct"), EndEffectorController(FETCH, "mink")
    num_moving = 0
    for case in range(CONFIGURATIONS):
        q = rng.uniform(LOWER, UPPER)
        if case % 3 == 0:  # some joints at their limits
            at_limit = np.where(rng.random(len(q)) < 0.5, LOWER, UPPER)
            q = np.where(rng.random(len(q)) < 0.4, at_limit, q)
        qd = rng.uniform(-1, 1, len(q)) * FETCH.max_velocity[3:] * rng.choice([0, 1])
        for controller in (direct, reference):
            controller.reset(q)
        w, x, y, z, *position = direct.wanted
        size = rng.choice([0.0, 0.1, 1.0])
        rotation = turned_by((w, x, y, z), tuple(rng.normal(0, 0.2 * size, 3)))
        wanted = [*rotation, *(np.array(position) + rng.normal(0, 0.05 * size, 3))]
        twist = rng.uniform(-1, 1, 6) * rng.choice([0, 1])
        for controller in (direct, reference):
            controller.wanted = wanted
        velocity, expected = (controller.joint_velocity(twist, q, qd) for controller in (direct, reference))
        assert np.abs(velocity - expected).max() < 1e-6
        assert np.abs(np.array(direct.wanted) - reference.wanted).max() < 1e-12
        num_moving += bool(np.abs(expected).max() > 0.01)
    assert num_moving > CONFIGURATIONS / 2


def test_both_routes_drive_the_same_way() -> None:
    actions = np.random.default_rng(1).uniform(-1, 1, (40, 10)).astype(np.float32)
    actions[:, 0] = -1
    ends = []
    for route in ("direct", "mink"):
        env = RetrieveEnv(num_objects=1, control_mode="ee", ik=route)
        env.reset(seed=2)
        for action in actions:
            env.step(action)
        ends.append(env.data.qpos.copy())
    assert np.abs(ends[0] - ends[1]).max() < 1e-6
    with pytest.raises(ConfigError, match="'direct', 'mink'"):
        EnvConfig(ik="numerical")


@pytest.mark.parametrize("size", [1e-6, 1e-4, 9e-3, 1.1e-2, 0.3, 1.5])
def test_pose_arithmetic_equals_minks(size: float) -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        start, end = random_rotation(rng, 1.0), random_rotation(rng, 1.0)
        end = turned_by(start, tuple(rng.normal(0, size, 3)))
        here, there = (tuple(rng.normal(0, 0.5, 3)) for _ in range(2))
        vector = np.array(here)
        assert rotated(here, start) == pytest.approx(mink.SO3(np.array(start)).apply(vector), abs=1e-14)
        assert rotation_vector(end) == pytest.approx(mink.SO3(np.array(end)).log(), abs=1e-12)
        poses = [mink.SE3(np.array((*rotation, *point))) for rotation, point in ((start, here), (end, there))]
        twist = (poses[0].inverse() @ poses[1]).log()
        linear, angular = pose_difference(here, start, there, end)
        assert np.concatenate((linear, angular)) == pytest.approx(twist, abs=1e-8)
        rows = inverse_left_jacobian(linear, angular)
        blocks = np.array(rows) if rows is not None else np.vstack((np.eye(3), np.zeros((3, 3))))
        expected = mink.SE3.ljacinv(twist)
        assert blocks[:3] == pytest.approx(expected[:3, :3], abs=1e-7)
        assert blocks[3:] == pytest.approx(expected[:3, 3:], abs=1e-6)
