"""Shares of the head camera's image are those of a rendered one; at home no robot hides what the camera would see."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import clutter_env  # noqa: F401  registers the environments
from clutter_env.errors import UsageError
from clutter_env.rendering.cameras import FIRST_OBJECT, ROBOT
from scripts.view_shares import Arguments, main, view

ROBOTS = ("fetch", "pr2", "panda_mobile")


@pytest.mark.usefixtures("needs_gl")
def test_shares_are_those_of_a_rendered_image() -> None:
    size, images = 64, {"obs_mode": "rgbd", "cameras": ("head",), "segmentation": True}
    env: Any = gym.make("clutter_env/Retrieve-o10-v0", robot="pr2", image_size=size, **images).unwrapped
    for seed in range(3):
        observation, _ = env.reset(seed=seed)
        labels, found = observation["head_segmentation"], view(env, size)
        wanted = np.array([(labels == FIRST_OBJECT + slot).mean() for slot in range(10)])
        assert np.abs(found.objects - wanted).max() < 0.003
        assert found.target == found.objects[env.target_slot]
        assert abs(found.robot - (labels == ROBOT).mean()) < 0.1, "meshes and collision shapes differ"
    env.close()


@pytest.mark.parametrize("robot", ROBOTS)
def test_at_home_the_robot_hides_none_of_the_objects_that_its_head_faces(robot: str) -> None:
    seen, facing = 0, 0
    for layout in ("paper", "shelf", "island"):
        env: Any = gym.make("clutter_env/Retrieve-o10-v0", robot=robot, layout=layout).unwrapped
        groups, roots = env.model.geom_group.copy(), env.model.body_rootid[env.model.geom_bodyid]
        is_robot = roots == env.model.body_rootid[env.world.index.base_body]
        for seed in range(5):
            env.reset(seed=seed)
            seen += np.count_nonzero(view(env, 48).objects)
            env.model.geom_group[is_robot] = 5  # not drawn
            facing += np.count_nonzero(view(env, 48).objects)
            env.model.geom_group[:] = groups
        env.close()
    assert facing > 90, "the head faces the table"
    assert seen >= 0.97 * facing


def test_a_home_is_that_of_one_robot() -> None:
    with pytest.raises(UsageError, match="--robots names 2"):
        main(Arguments(robots=("fetch", "pr2"), home=(0.2,) * 8))


def test_a_table_of_first_images_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    main(Arguments(robots=("fetch",), layouts=("cabinet",), scenes=2, paths=0, size=24))
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    assert [line.count("|") for line in lines] == [7, 7, 7]
    assert "fetch | cabinet" in lines[-1]
    assert "of 2" in lines[-1]
