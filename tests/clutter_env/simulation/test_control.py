"""Control: trajectories within the limits are followed exactly, limits are never broken, nothing raises."""

from __future__ import annotations

import math

import gymnasium as gym
import numpy as np
import pytest

import clutter_env  # noqa: F401 - registers the environments
from assets.robots import FETCH
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.simulation.control import CONTROL_STEP, SEGMENTS

MAX_VELOCITY = np.array(FETCH.max_velocity)
MAX_ACCELERATION = np.array(FETCH.max_acceleration)
ROUNDING = 1e-8
"""[m] or [rad] that an action moves a target less or more because its numbers are rounded to float32."""


def make(mode: str = "joint", count: int = 1) -> RetrieveEnv:
    env = gym.make(f"clutter_env/Retrieve-o{count}-v0", control_mode=mode).unwrapped
    env.reset(seed=3)
    return env


def smooth_motion(start: np.ndarray, change: np.ndarray) -> np.ndarray:
    """(n, 11) samples at 20 Hz of a cosine motion that uses at most 0.9 of velocity and acceleration limits."""
    peak_velocity, peak_acceleration = math.pi / 2 * np.abs(change), math.pi**2 / 2 * np.abs(change)
    base = np.array([1 / math.sqrt(2), 1 / math.sqrt(2), *[1] * 9])
    seconds = max(
        (peak_velocity / (0.9 * base * MAX_VELOCITY)).max(),
        np.sqrt(peak_acceleration / (0.9 * base * MAX_ACCELERATION)).max(),
    )
    t = np.linspace(0, 1, math.ceil(seconds / CONTROL_STEP) + 1)[1:, None]
    return start + (1 - np.cos(math.pi * t)) / 2 * change


@pytest.mark.parametrize("seed", range(2))
def test_trajectories_within_the_limits_are_followed_exactly(seed: int) -> None:
    env = make()
    rng = np.random.default_rng(seed)
    start = env.world.controller.state.target.copy()
    change = rng.uniform(-1, 1, 11) * [0.3, 0.4, 1.0, 0.1, 0.8, 0.4, 1.0, 0.6, 1.0, 0.5, 1.0]
    change[[0, 7]] = -np.abs(change[[0, 7]])
    worst = 0.0
    for q in smooth_motion(start, change):
        env.step(env.joint_action(q, 0.08))
        assert np.abs(env.world.controller.state.target - q).max() < ROUNDING
        worst = max(worst, float(np.abs(env.data.qpos[env.world.index.drive_qpos] - q).max()))
    assert worst < 0.01, "the motors stay within 1 cm and 0.01 rad of a moving target"
    for _ in range(10):
        env.step(env.joint_action(q, 0.08))
    assert np.abs(env.data.qpos[env.world.index.drive_qpos] - q).max() < 1e-3
    opening = FETCH.finger_gap_closed + env.data.qpos[env.world.index.finger_qpos].sum()
    assert opening == pytest.approx(0.08, abs=1e-4)


def test_far_goals_are_reached_with_hardly_any_overshoot() -> None:
    env = make()
    start = env.world.controller.state.target.copy()
    goal = start + [-0.6, 0.3, -1.0, 0.1, 0.7, 0.3, -1.0, -0.5, 1.0, -0.5, 1.0]
    side = np.sign(goal - start)
    for _ in range(120):
        env.step(env.joint_action(goal, 0.05))
        beyond = (env.world.controller.state.target - goal) * side
        assert beyond.max() < 0.05
    assert np.abs(env.world.controller.state.target - goal).max() < 1e-9


@pytest.mark.parametrize("mode", ["joint", "ee"])
def test_targets_keep_velocity_and_acceleration_limits(mode: str) -> None:
    env = make(mode)
    rng = np.random.default_rng(0)
    controller = env.world.controller
    tolerance = 1 + 1e-6
    for step in range(300):
        before = controller.state
        if step % 7 == 0:
            action = rng.choice([-1.0, 1.0], env.action_space.shape)
        env.step(action)
        after = controller.state
        moved = (after.target - before.target) / CONTROL_STEP
        assert (np.abs(moved[2:]) <= MAX_VELOCITY[2:] * tolerance).all()
        assert np.linalg.norm(moved[:2]) <= math.sqrt(2) * MAX_VELOCITY[0] * tolerance
        lower, upper = np.array(controller._bounds)[:, :2].T
        is_inside = (after.target > lower + 1e-9) & (after.target < upper - 1e-9)
        is_free = is_inside & (np.abs(after.target - env.data.qpos[env.world.index.drive_qpos]) < 0.02)
        change = np.abs(after.velocity - before.velocity) / CONTROL_STEP
        assert (change[2:][is_free[2:]] <= MAX_ACCELERATION[2:][is_free[2:]] * tolerance).all()
        assert (after.target >= lower).all()
        assert (after.target <= upper).all()


def test_loaded_robots_turn_slowly() -> None:
    env = make()
    controller, spin = env.world.controller, np.array([0.0, 0.0, MAX_VELOCITY[2], *[0.0] * 8])
    for is_loaded, fastest in ((True, FETCH.max_loaded_yaw_rate), (False, MAX_VELOCITY[2])):
        for _ in range(40):
            commands = controller.advance(env.data, spin, [1.0], is_loaded)
            env.data.qpos[env.world.index.drive_qpos] = controller.state.target
        assert commands.shape == (SEGMENTS, env.model.nu)
        assert controller.state.velocity[2] == pytest.approx(fastest)


def test_blocked_targets_do_not_run_away() -> None:
    env = make()
    forward = np.zeros(12)
    forward[0] = 1.0
    for _ in range(200):
        env.step(forward)
    lead = env.world.controller.state.target[:2] - env.data.qpos[:2]
    assert np.linalg.norm(lead) < 0.2, "the table stops the base and the target with it"
    for _ in range(21):
        env.step(-forward)
    assert env.world.controller.state.velocity[0] < -0.5


@pytest.mark.parametrize("seed", range(2))
def test_end_effector_follows_straight_lines(seed: int) -> None:
    env = make("ee")
    rng = np.random.default_rng(seed)
    site = env.world.index.tcp_site
    pose = np.eye(4)
    pose[:3, :3] = env.data.site_xmat[site].reshape(3, 3)
    pose[:3, 3] = env.data.site_xpos[site]
    base = env.world.controller.state.target[:3].copy()
    goal = pose[:3, 3] + rng.uniform((-0.05, -0.15, -0.15), (0.1, 0.15, 0.05))
    start = pose[:3, 3].copy()
    for share in np.linspace(0, 1, 60):
        pose[:3, 3] = start + share * share * (3 - 2 * share) * (goal - start)
        env.step(env.ee_action(base, pose, 0.1))
    for _ in range(20):
        env.step(env.ee_action(base, pose, 0.1))
    assert np.linalg.norm(env.data.site_xpos[site] - goal) < 2e-3
    assert np.abs(env.data.site_xmat[site].reshape(3, 3) - pose[:3, :3]).max() < 0.01


@pytest.mark.parametrize(("direction", "sign"), [(0, 1.0), (1, -1.0), (2, 1.0), (3, -1.0), (4, 1.0), (5, -1.0)])
def test_end_effector_survives_targets_out_of_reach(direction: int, sign: float) -> None:
    env = make("ee")
    action = np.zeros(10)
    action[3 + direction] = sign
    for _ in range(120):
        observation, *_ = env.step(action)
        assert all(np.isfinite(value).all() for value in observation.values())
    speeds = []
    for _ in range(40):
        env.step(-action)
        speeds.append(np.abs(env.data.qvel[env.world.index.drive_dof[3:]]).max())
    assert max(speeds) > 0.02, "it comes back when told to"
