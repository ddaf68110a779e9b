"""PR2 in the planner: the arm that does not act is part of the robot, the torso stays, plans are carried out."""

from __future__ import annotations

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

import clutter_env  # noqa: F401  registers the environments
from assets.robots import PR2
from irm.chain import BASE, ArmChain
from irm.kernel_arguments import packed
from planners import Planner, Solution
from planners.collision.scene_arrays import robot_arrays
from planners.collision.world import CollisionWorld
from planners.expert.config import ExpertConfig
from planners.expert.expert import TampExpert
from planners.scene import SELF_BIT, Scene
from tests.planners.plans import assert_free, play


@pytest.fixture(scope="module")
def scene() -> Scene:
    env = gym.make("clutter_env/Retrieve-o5-v0", robot="pr2").unwrapped
    env.reset(seed=1)
    return Scene.from_mujoco(env.model, env.data, PR2)


def test_the_torso_stays_at_home() -> None:
    chain = ArmChain.from_robot(PR2)
    assert chain.lower[0] == chain.upper[0] == PR2.home[0]
    free = ArmChain.from_robot(replace(PR2, plans_torso=True))
    assert (free.lower[0], free.upper[0]) == (0.0, 0.33)
    assert ArmChain.from_robot(PR2.using("left")).robot == "pr2_left"


def test_idle_arms_are_solids_of_the_torso_behind_those_of_the_gripper() -> None:
    arrays = robot_arrays(PR2)
    last = len(PR2.chain) - 1
    assert (arrays.link[: arrays.held_from] == last).all()
    assert (arrays.link[arrays.held_from :] < last).all()
    first_idle = int(np.flatnonzero(arrays.link == BASE).max()) + 1
    assert (arrays.link[first_idle:] == 0).all()
    assert len(arrays.link) - first_idle == 11


def test_the_active_arm_collides_with_the_idle_one(scene: Scene) -> None:
    """An arm that swings to the other side meets the other arm, and only that."""
    world = CollisionWorld.from_scene(scene)
    base, home = np.array([-3.0, 0.0, 0.0]), np.array(PR2.home)
    assert not world.hits(base, home, opening=0.05)
    across = home.copy()
    across[1:] = (0.7, 0.0, -1.5, -0.6, 0.0, -0.1, 0.0)
    assert world.hits(base, across, opening=0.05) == 1 << SELF_BIT
    assert not _without_idle_arms(world).hits(base, across, opening=0.05)


def _without_idle_arms(world: CollisionWorld) -> CollisionWorld:
    """The same without the solids that follow those of the base: the idle arms'."""
    robot = world.robot
    first_idle = int(np.flatnonzero(robot.link == BASE).max()) + 1
    pairs = robot.self_pairs[(robot.self_pairs < first_idle).all(axis=1)]
    return replace(world, robot=packed(robot._replace(self_pairs=pairs)))


@pytest.mark.slow
def test_plans_are_free_of_penetration_in_mujoco(scene: Scene) -> None:
    found = Planner(PR2, grasps="side").solve(scene, scene.names[0])
    assert isinstance(found, Solution), found
    assert_free(found)
    assert all(np.ptp(action.trajectory.q[:, 0]) == 0.0 for action in found.actions), "the torso stays"


@pytest.mark.slow
def test_an_episode_with_clearances_succeeds() -> None:
    env = gym.make("clutter_env/Retrieve-o15-v0", robot="pr2")
    _, info = env.reset(seed=22)
    expert = TampExpert(env, grasps="side", config=ExpertConfig(with_floor=False))
    expert.reset(info["target"])
    assert play(env, expert)["is_success"], expert.report
    assert expert.report.clearances
