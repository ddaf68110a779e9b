"""No success is given for what no robot should do; see `cheats` for the scripts."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.scene.layout import TABLE_HEIGHT
from tests.clutter_env.envs.cheats import CHEATS, OTHER, SCENE, TARGET, Cheat


def begin(*objects: dict) -> Cheat:
    return Cheat(RetrieveEnv(num_objects=4, control_mode="ee"), objects)


def test_an_object_that_is_carried_away_does_not_count_against_success() -> None:
    cheat = begin()
    cheat.grasp(OTHER)
    cheat.reach(cheat.point + (0, 0, 0.05))
    cheat.reach(cheat.point + (0, 0.12, 0))
    cheat.reach(cheat.point - (0, 0, 0.049))
    cheat.leave()
    info = cheat.take_target()
    assert info["is_success"]
    assert (info["num_cleared"], info["num_disturbed"]) == (1, 0)
    assert info["furniture_force"] < 10.0, "setting down is pressing, a little"
    assert info["total_path"] < 0.02
    cheat.env.data.warning.number[0] = 1
    assert not cheat.env.info["is_success"], "the simulation has diverged"


@pytest.mark.parametrize("script", CHEATS.values(), ids=CHEATS)
def test_a_target_that_is_lifted_after_a_cheat_is_no_clean_success(script: Callable[[Cheat], None]) -> None:
    cheat = begin(*SCENE)
    script(cheat)
    info = cheat.take_target()
    assert info["lifted"]
    assert not info["is_success"]
    assert info["num_cleared"] <= (script is CHEATS["shove_with_what_is_held"]), "what shoves is put down properly"


def test_a_target_that_is_lifted_with_a_neighbour_is_no_success() -> None:
    thin = {"shape": "cylinder", "radius": 0.011, "height": 0.14}
    cheat = begin({**thin, "position": (-0.18, -0.12)}, {**thin, "position": (-0.203, -0.12)})
    info = cheat.take_target()
    assert cheat.env.measurements.poses[OTHER, 2] > TABLE_HEIGHT + 0.15, "both were lifted"
    assert not info["is_success"]


def test_a_target_that_lies_on_the_gripper_is_no_success() -> None:
    cheat = begin()
    cheat.grip(0.0)
    env = cheat.env
    pose = env.data.qpos[env.world.index.object_qpos].reshape(-1, 7)[TARGET]
    pose[:3] = env.data.site_xpos[env.world.index.tcp_site] - (0.1, 0, -0.15)
    env.data.tree_asleep[:] = -1
    cheat.wait(3.0)
    assert not cheat.info["lifted"]


def test_an_object_that_is_released_in_the_air_falls() -> None:
    cheat = begin()
    cheat.grasp(OTHER)
    cheat.reach(cheat.point + (0, 0, 0.12))
    cheat.wait(1.0)  # long enough to fall asleep in the grip
    cheat.leave()
    assert cheat.env.measurements.poses[OTHER, 2] < TABLE_HEIGHT + 0.1
    assert cheat.info["num_disturbed"] == 1


def test_a_diverged_simulation_ends_the_episode() -> None:
    env = RetrieveEnv(num_objects=2)
    env.reset(seed=0)
    env.data.qvel[:] = 1e9
    *_, truncated, info = env.step(np.zeros(12))
    assert truncated
    assert info["unstable"]
    _, info = env.reset(seed=0)
    assert not info["unstable"]
