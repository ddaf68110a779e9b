"""Every keyword and option given wrongly: a ValueError that names what is valid, and nothing has changed."""

from __future__ import annotations

import re

import gymnasium as gym
import numpy as np
import pytest

import clutter_env  # noqa: F401 - registers the environments
from clutter_env.config import EnvConfig
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.errors import ClutterEnvError
from clutter_env.scene.layout import LAYOUTS

VALID_CHOICES = {"layout": "paper", "control_mode": "ee", "reward_mode": "dense", "obs_mode": "rgbd", "robot": "fetch"}
VALID_CHOICES |= {"shapes": "mixed", "camera": "top", "success": "clean", "object_set": "low", "render_mode": "human"}
WRONG_NUMBERS = {
    "num_objects": (("1", 0, -3), ("at most", 61, 10**9), ("integer", 5.0, "5", True, None, float("nan"))),
    "width": (("16", 0, "big", None),),
    "height": (("2048", 1e6, 10**6),),
    "image_size": (("16", "big", 3.5),),
}


@pytest.mark.parametrize("name", VALID_CHOICES)
def test_a_wrong_choice_names_the_valid_ones(name: str) -> None:
    for value in ("round", 3, 1.5, b"state", True, ["paper"], *[None] * (name != "render_mode")):
        with pytest.raises(ClutterEnvError, match=f"{name}(.|\n)*{VALID_CHOICES[name]}"):
            RetrieveEnv(**{name: value})


@pytest.mark.parametrize("name", WRONG_NUMBERS)
def test_a_wrong_number_names_the_limits(name: str) -> None:
    for hint, *values in WRONG_NUMBERS[name]:
        for value in values:
            with pytest.raises(ClutterEnvError, match=f"{name}.*{hint}"):
                RetrieveEnv(**{name: value})


def test_unknown_keywords_name_the_known_ones() -> None:
    with pytest.raises(ClutterEnvError, match=r"'n_objects'; known ones: num_objects, layout"):
        RetrieveEnv(n_objects=5)


@pytest.mark.parametrize("shapes", ["cylinder", "box", "mixed"])
def test_too_many_objects_say_how_many_fit(shapes: str) -> None:
    for layout in LAYOUTS:
        with pytest.raises(ClutterEnvError, match=r"at most \d+ fit"):
            EnvConfig(num_objects=61, layout=layout, shapes=shapes)


def test_too_many_household_objects_are_refused_without_a_word_on_shapes() -> None:
    with pytest.raises(ClutterEnvError, match=r"layout 'paper' with object_set='household': at most \d+ fit"):
        EnvConfig(num_objects=60, object_set="household")


@pytest.mark.parametrize("of_images", [{"cameras": ("head",)}, {"segmentation": True}])
def test_what_is_said_of_images_needs_images(of_images: dict[str, object]) -> None:
    (name,) = of_images
    with pytest.raises(ClutterEnvError, match=f"{name}=.*'rgbd', 'pointcloud'.*'state'"):
        EnvConfig(**of_images)
    assert EnvConfig(obs_mode="pointcloud", **of_images).observed_cameras[0] == "head"


CYLINDER = {"shape": "cylinder", "radius": 0.03, "height": 0.15, "position": (0.0, 0.0)}
BOX = {"shape": "box", "depth": 0.05, "width": 0.05, "height": 0.15, "position": (0.0, 0.0)}
WRONG_CYLINDERS = [
    ({"shape": "cone"}, "cylinder, box"),
    ({"color": "red"}, "radius"),
    ({"radius": 0.5}, "0.01 to 0.1"),
    ({"radius": "3"}, "number"),
    ({"radius": float("nan")}, "number"),
    ({"height": 0.0}, "0.04"),
    ({"mass": -1}, "0.01 to 5"),
    ({"yaw": float("inf")}, "number"),
    ({"lying": 1}, "True or False"),
    ({"position": 0.1}, "(x, y)"),
    ({"position": (0.1, 0.1, 0.8)}, "(x, y)"),
    ({"position": ("a", 0.1)}, "number"),
    ({"position": (0.34, 0.0)}, "edge"),
]
WRONG_OPTIONS = [
    (5, "dictionary"),
    ({"goal": 1}, "target, objects, state, obstructed"),
    ({"target": "object_99"}, "object_04"),
    ({"target": 3}, "object_00"),
    ({"state": "abc"}, "save_state"),
    ({"state": b"abc"}, "no saved state"),
    ({"state": b"abc", "target": "object_00"}, "alone"),
    ({"objects": "cylinder"}, "list"),
    ({"objects": []}, "1 to 5"),
    ({"objects": [CYLINDER] * 6}, "1 to 5"),
    ({"objects": [3]}, "dictionaries"),
    ({"objects": [{"shape": "box", "radius": 0.1}]}, "depth"),
    ({"objects": [{"position": (0, 0)}]}, "missing"),
    ({"objects": [{**BOX, "lying": True}]}, "unknown key 'lying'"),
    ({"objects": [{**BOX, "position": (0.322, 0.0), "yaw": 0.7}]}, "edge"),
    *(({"objects": [thing, thing]}, "overlap") for thing in (CYLINDER, BOX, {**BOX, "yaw": 0.7})),
    ({"objects": [{**CYLINDER, "position": (0.025, 0.025)}, BOX]}, "overlap"),
    ({"objects": [CYLINDER, {**BOX, "position": (0.05, 0.0)}]}, "overlap"),
    ({"objects": [BOX, {**BOX, "position": (0.055, 0.0), "yaw": 0.78}]}, "overlap"),
    ({"objects": [CYLINDER], "target": "object_01"}, "object_00"),
    *(({"objects": [{**CYLINDER, **change}]}, hint) for change, hint in WRONG_CYLINDERS),
]


@pytest.fixture(scope="module")
def env() -> RetrieveEnv:
    made: RetrieveEnv = gym.make("clutter_env/Retrieve-o5-v0").unwrapped
    made.reset(seed=0)
    return made


def generator_of(env: gym.Env) -> tuple[object, ...]:
    generator = env._np_random
    return generator, env._np_random_seed, None if generator is None else repr(generator.bit_generator.state)


@pytest.mark.parametrize(("options", "hint"), WRONG_OPTIONS)
def test_wrong_options_name_the_valid_ones_and_change_nothing(env: RetrieveEnv, options: object, hint: str) -> None:
    state, generator = env.save_state(), generator_of(env)
    for seed in (None, 11):
        with pytest.raises(ValueError, match=re.escape(hint)):
            env.reset(seed=seed, options=options)
        assert (env.save_state(), generator_of(env)) == (state, generator)


@pytest.mark.parametrize("name", ["clutter_env/Pick-v0", "clutter_env/Skill-o5-v0"])
def test_a_refused_first_reset_leaves_the_generator_alone(name: str) -> None:
    env = gym.make(name).unwrapped
    for inner in (env, getattr(env, "physics_env", env)):
        before = generator_of(inner)
        for options in ({"target": "object_99"}, {"objects": [CYLINDER, CYLINDER]}, {"state": b"nothing"}, 5):
            with pytest.raises(ClutterEnvError):
                env.reset(seed=11, options=options)
        assert generator_of(inner) == before


@pytest.mark.parametrize("seed", [-1, "three", 1.5])
def test_a_wrong_seed_changes_nothing(env: RetrieveEnv, seed: object) -> None:
    state, generator = env.save_state(), generator_of(env)
    with pytest.raises(gym.error.Error):
        env.reset(seed=seed)
    assert (env.save_state(), generator_of(env)) == (state, generator)


def test_touching_boxes_are_no_overlap() -> None:
    env = gym.make("clutter_env/Retrieve-o5-v0").unwrapped
    env.reset(options={"objects": [BOX, {**BOX, "position": (0.05, 0.0)}, {**CYLINDER, "position": (0.0, 0.055)}]})
    assert env.world.shapes == ("box", "box", "cylinder")


WRONG_ACTIONS = [np.full(12, np.nan), np.full(12, np.inf), np.zeros(11), np.zeros((1, 12)), np.zeros(0), 0.0, None]
WRONG_ACTIONS += ["forward", ["a"] * 12, {"x": 1}, [[1, 2], [3]], ["0.5"] * 12, [b"1"] * 12, np.full(12, 0.5j)]
WRONG_ACTIONS += [np.full(12, "2020-01-01", "datetime64[D]"), np.zeros(12, "timedelta64[s]"), np.array([None] * 12)]


@pytest.mark.parametrize("action", WRONG_ACTIONS, ids=range(len(WRONG_ACTIONS)))
def test_wrong_actions_leave_the_environment_unchanged(env: RetrieveEnv, action: object) -> None:
    before = env.save_state()
    with pytest.raises(ValueError, match="12"):
        env.step(action)
    assert env.save_state() == before


def test_calls_before_the_first_reset_are_refused() -> None:
    env = gym.make("clutter_env/Retrieve-o5-v0").unwrapped
    ee = gym.make("clutter_env/Retrieve-o5-v0", control_mode="ee").unwrapped
    for call in (
        lambda: env.step(np.zeros(12)),
        lambda: env.joint_action(np.zeros(11), 0.1),
        lambda: ee.ee_action(np.zeros(3), np.eye(4), 0.1),
        env.save_state,
        env.render,
    ):
        with pytest.raises(ClutterEnvError, match="reset"):
            call()


def test_action_helpers_check_their_input() -> None:
    joint = gym.make("clutter_env/Retrieve-o1-v0").unwrapped
    ee = gym.make("clutter_env/Retrieve-o1-v0", control_mode="ee").unwrapped
    joint.reset(seed=0)
    ee.reset(seed=0)
    for wrong in (np.zeros(10), np.full(11, np.nan), "home", None, ["0.1"] * 11, np.zeros(11, complex)):
        with pytest.raises(ClutterEnvError, match="11"):
            joint.joint_action(wrong, 0.1)
    for width in (float("nan"), "0.1", 1j):
        with pytest.raises(ClutterEnvError, match="gripper_width"):
            joint.joint_action(np.zeros(11), width)
    with pytest.raises(ClutterEnvError, match="ee_action"):
        ee.joint_action(np.zeros(11), 0.1)
    with pytest.raises(ClutterEnvError, match="joint_action"):
        joint.ee_action(np.zeros(3), np.eye(4), 0.1)
    for base, pose in ((np.zeros(3), np.eye(3)), ("home", np.eye(4)), (["0"] * 3, np.eye(4)), (np.zeros(3), [[1], 2])):
        with pytest.raises(ClutterEnvError, match="ee_action"):
            ee.ee_action(base, pose, 0.1)


def test_a_count_of_numpys_is_one_of_pythons() -> None:
    assert type(EnvConfig(num_objects=np.int64(2)).num_objects) is int  # type: ignore[arg-type]  # what users compute
