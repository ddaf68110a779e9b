"""`gym.make(layout=, robot=)` takes the user's own objects as it takes names."""

from __future__ import annotations

import pickle
from dataclasses import asdict, replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

import clutter_env  # noqa: F401 - registers the environments
from assets.robots import FETCH, RobotSpec
from clutter_env.errors import ClutterEnvError, ConfigError, OptionError, StateError
from clutter_env.scene.layout import Box, Layout

ID = "clutter_env/Retrieve-o5-v0"
BENCH = Layout("bench", depth=0.5, width=0.9, is_front_only=False)
PILLAR = Box("pillar", (0.1, 0.75, 0.6), (0.05, 0.05, 0.6))
MY_FETCH = replace(FETCH, name="my_fetch", home=(0.30, 0.1, *FETCH.home[2:]))
OBJECTS = [{"layout": BENCH}, {"robot": MY_FETCH}, {"layout": replace(BENCH, boxes=(PILLAR,)), "robot": MY_FETCH}]


def own_file(tmp_path: Path, **changes: str) -> RobotSpec:
    """Fetch from a file of the user's own, in which words are replaced."""
    text = FETCH.mjcf_path.read_text()
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    file = tmp_path / "robot.xml"
    file.write_text(text)
    return replace(FETCH, name="own", mjcf=str(file))


def same(mine: dict, theirs: dict) -> bool:
    return all(np.array_equal(mine[name], theirs[name]) for name in mine)


def test_states_of_another_layout_or_robot_are_refused(tmp_path: Path) -> None:
    made = {
        "layout 0.5": {"layout": BENCH},
        "layout 0.6": {"layout": replace(BENCH, depth=0.6)},
        "named like one of ours": {"layout": replace(BENCH, name="paper")},
        "robot": {"robot": MY_FETCH},
        "limits": {"robot": replace(MY_FETCH, max_finger_velocity=0.04)},
        "file": {"robot": own_file(tmp_path, **{'kp="2400"': 'kp="2300"'})},
        "ours": {},
    }
    envs = {name: gym.make(ID, **keywords).unwrapped for name, keywords in made.items()}
    for name, env in envs.items():
        env.reset(seed=0)
        state = env.save_state()
        env.restore_state(state)
        for other, target in envs.items():
            if other != name:
                with pytest.raises(StateError, match=r"layout=|robot="):
                    target.restore_state(state)


@pytest.mark.parametrize("keywords", OBJECTS)
def test_the_spec_makes_the_environment_again(keywords: dict) -> None:
    env = gym.make(ID, **keywords)
    first, _ = env.reset(seed=1)
    for spec in (env.spec, EnvSpec.from_json(env.spec.to_json()), pickle.loads(pickle.dumps(env.spec))):
        again = gym.make(spec)
        assert same(first, again.reset(seed=1)[0])
        assert again.unwrapped.robot == env.unwrapped.robot
        assert again.unwrapped.layout == env.unwrapped.layout


def test_a_modified_robot_starts_and_moves_as_its_data_say(tmp_path: Path) -> None:
    env = gym.make(ID, robot=replace(own_file(tmp_path), home=MY_FETCH.home, max_finger_velocity=0.02)).unwrapped
    observation, _ = env.reset(seed=0)
    assert np.allclose(env.data.qpos[env.world.index.drive_qpos[3:]], MY_FETCH.home)
    close = np.zeros(12)
    close[-1] = -1
    after, *_ = env.step(close)
    assert observation["gripper"][1] - after["gripper"][1] == pytest.approx(2 * 0.02 * 0.05, abs=1e-6)


WRONG_LAYOUTS = [
    ({"name": ""}, "non-empty"),
    ({"depth": 0.0}, "depth=0.0 must be a number from 0.3 to 3"),
    ({"width": -1.0}, "width"),
    ({"width": float("nan")}, "width"),
    ({"width": "1"}, "width"),
    ({"is_front_only": 1}, "is_front_only"),
    ({"board_height": 0.1}, "board_height"),
    ({"boxes": (PILLAR, PILLAR)}, "two boxes are named 'pillar'"),
    ({"boxes": (PILLAR._replace(name="table_top"),)}, "two boxes are named 'table_top'"),
    ({"boxes": (PILLAR._replace(name=""),)}, "non-empty"),
    ({"boxes": (PILLAR._replace(position=(0, 0)),)}, "three"),
    ({"boxes": (PILLAR._replace(half_extents=(0, 1, 1)),)}, "half_extents"),
    ({"boxes": (PILLAR._replace(position=(0.0, 0.0, 0.9)),)}, "above the table"),
    ({"boxes": (PILLAR._replace(position=(-1.0, 0.0, 0.6)),)}, "robot starts"),
    ({"boxes": "pillar"}, "Boxes"),
    ({"boxes": 3}, "Boxes"),
]


@pytest.mark.parametrize(("change", "hint"), WRONG_LAYOUTS)
def test_wrong_layouts_say_what_is_wrong(change: dict, hint: str) -> None:
    with pytest.raises(ConfigError, match=hint):
        replace(BENCH, **change)


@pytest.mark.parametrize("robot", ["wall-e", 3, None, {"name": "fetch"}, {**asdict(FETCH), "legs": 2}])
def test_what_is_no_robot_names_the_valid_ones(robot: object) -> None:
    with pytest.raises(ConfigError, match=r"known robots: .*fetch.*RobotSpec|fields of a RobotSpec"):
        gym.make(ID, robot=robot)


def test_boxes_named_like_the_robot_s_geoms_are_refused() -> None:
    with pytest.raises(ConfigError, match="'palm'"):
        gym.make(ID, layout=replace(BENCH, boxes=(PILLAR._replace(name="palm"),)))


def test_objects_under_a_low_board_are_refused() -> None:
    env = gym.make(ID, layout=replace(BENCH, board_height=0.25))
    env.reset(options={"objects": [{"radius": 0.03, "height": 0.24, "position": (0, 0)}]})
    with pytest.raises(OptionError, match=r"0\.25 m above"):
        env.reset(options={"objects": [{"radius": 0.03, "height": 0.26, "position": (0, 0)}]})


MISFITS = [
    ({'name="base_link"': 'name="bottom"'}, {}, "no body 'base_link'"),
    ({'name="elbow_flex_joint"': 'name="elbow"', 'joint="elbow_flex_joint"': 'joint="elbow"'}, {}, "no joint 'elbow"),
    ({'position name="base_yaw"': 'position name="turn"'}, {}, "no actuator 'base_yaw'"),
    ({'geom name="r_finger"': 'geom name="thumb"'}, {}, "no geom 'r_finger'"),
    ({'site name="tcp"': 'site name="tool"'}, {}, "no site 'tcp'"),
    ({'camera name="head"': 'camera name="eye"'}, {}, "no camera 'head'"),
    ({'axis="1 0 0" armature="0"': 'axis="0 0 1" armature="0"'}, {}, "'base_x' does not"),
    ({'pos="0.133 0 0"': 'pos="0.143 0 0"'}, {}, r"elbow_flex_joint.*\(0.143"),
    ({'range="-2.251 2.251"': 'range="-2.0 2.251"'}, {}, "elbow_flex_joint.*range"),
    ({'site name="tcp" pos="0.015 0 0"': 'site name="tcp" pos="0.02 0 0"'}, {}, "'tcp'"),
    ({"</mujoco>": ""}, {}, "no valid MJCF"),
    ({}, {"mjcf": "/nowhere/robot.xml"}, "nowhere"),
    ({}, {"head_joints": (), "head_configuration": ()}, "does not name: head_pan_joint, head_tilt_joint"),
]


@pytest.mark.parametrize(("changes", "fields", "hint"), MISFITS, ids=[hint for _, _, hint in MISFITS])
def test_a_spec_that_does_not_fit_its_file_names_what_is_missing(
    tmp_path: Path, changes: dict, fields: dict, hint: str
) -> None:
    robot = replace(own_file(tmp_path, **changes), **fields)
    with pytest.raises(ClutterEnvError, match=hint) as caught:
        gym.make(ID, robot=robot)
    assert "'own'" in str(caught.value)
