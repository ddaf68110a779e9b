"""Skills: the kinematic model agrees with physics, masks and the ends of episodes are right."""

from __future__ import annotations

import math
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import clutter_env
from assets import PR2
from clutter_env.envs.skill import BODY_FIELDS, LENGTH_UNIT, SIMULATIONS, SKILL_COST, SkillEnv
from clutter_env.envs.success import is_as_placed
from clutter_env.errors import ActionError, ConfigError
from clutter_env.scene.layout import TABLE_HEIGHT
from planners import DIRECTIONS
from planners.scene import Body

BLOCKED_SEED = 2
"""Of ten objects, the target's grasps are all blocked."""


@pytest.fixture(scope="module")
def kinematic() -> SkillEnv:
    return SkillEnv(simulation="kinematic", num_objects=10)


@pytest.fixture(scope="module")
def physics() -> SkillEnv:
    return SkillEnv(simulation="physics", num_objects=10)


def free_clearance(env: SkillEnv) -> int:
    """The first clearance with a free grasp."""
    return int(np.flatnonzero(env.action_masks(geometric=True)[:-1])[0])


def test_every_id_is_registered_and_follows_the_interface() -> None:
    for count in clutter_env.SKILL_OBJECT_COUNTS:
        env = gym.make(f"clutter_env/Skill-o{count}-v0", simulation="kinematic")
        observation, info = env.reset(seed=0)
        assert env.observation_space.contains(observation)
        assert env.action_space.n == count * DIRECTIONS + 1
        assert gym.spec(f"clutter_env/Skill-o{count}-v0").max_episode_steps == env.unwrapped.budget == 4 + count // 5
        assert set(info) >= {"is_success", "target", "held", "num_fallen", "failure", "moved"}


def test_the_kinematic_model_agrees_with_physics(kinematic: SkillEnv, physics: SkillEnv) -> None:
    for env in (kinematic, physics):
        env.reset(seed=0)
    action = free_clearance(physics)
    for chosen in (action, 10 * DIRECTIONS):
        one, other = kinematic.step(chosen), physics.step(chosen)
        assert np.abs(one[0] - other[0]).max() < 0.02 / LENGTH_UNIT
        assert one[1:4] == other[1:4]
        unknown = dict.fromkeys(("num_fallen", "furniture_force", "furniture_impulse", "total_slide", "total_path"), 0)
        assert {**one[4], **unknown} == {**other[4], **unknown}
        assert other[4]["total_path"] < 0.01
    assert other[4]["is_success"]
    assert other[4]["held"] == other[4]["target"]


@pytest.mark.parametrize("simulation", SIMULATIONS)
def test_a_robot_with_two_arms_does_skills_with_its_active_one(simulation: str) -> None:
    env = SkillEnv(simulation=simulation, num_objects=5, robot="pr2")
    env.reset(seed=0)
    for action in (free_clearance(env), 5 * DIRECTIONS):
        *_, info = env.step(action)
        assert info["failure"] == ""
    assert info["is_success"]
    with pytest.raises(ConfigError, match="one arm"):
        SkillEnv(num_objects=5, robot=PR2.with_all_arms())


def test_the_same_seed_and_skills_give_the_same_episode(kinematic: SkillEnv) -> None:
    runs = []
    for _ in range(2):
        kinematic.reset(seed=5)
        runs.append([kinematic.step(action)[0] for action in (3, 17, 30)])
    assert all(np.array_equal(one, other) for one, other in zip(*runs, strict=True))


def test_failed_attempts_are_flagged_and_masked_until_something_is_cleared(kinematic: SkillEnv) -> None:
    kinematic.reset(seed=BLOCKED_SEED)
    take = 10 * DIRECTIONS
    observation, reward, is_over, _, info = kinematic.step(take)
    assert (info["failure"], info["num_refused"], info["num_disturbed"]) == ("blocked", 1, 0)
    assert observation[-1] == 1
    assert not kinematic.action_masks()[take]
    assert reward == -SKILL_COST
    assert not is_over
    observation, *_, info = kinematic.step(free_clearance(kinematic))
    assert info["failure"] == ""
    assert len(info["moved"]) == 1
    assert observation[-1] == 0
    assert kinematic.action_masks()[take]


def test_the_target_is_never_to_be_cleared_and_geometry_only_removes(kinematic: SkillEnv) -> None:
    kinematic.reset(seed=7)
    plain, geometric = kinematic.action_masks(), kinematic.action_masks(geometric=True)
    assert not plain[:DIRECTIONS].any()
    assert not (geometric & ~plain).any()
    assert plain.sum() == 9 * DIRECTIONS + 1


def test_the_budget_ends_the_episode() -> None:
    env = SkillEnv(simulation="kinematic", num_objects=5, budget=2)
    observation, _ = env.reset(seed=0)
    assert observation[-2] == 1.0
    clear_the_target = 3
    assert not env.step(clear_the_target)[2]
    observation, _, is_over, _, info = env.step(clear_the_target)
    assert is_over
    assert not info["is_success"]
    assert observation[-2] == 0.0


def tamper(env: SkillEnv, height: float) -> None:
    """Put an object that is not the target at another height [m]; that stops the next skill."""
    physics_env = env.physics_env
    poses = physics_env.data.qpos[physics_env.world.index.object_qpos].reshape(-1, 7)
    poses[(physics_env.target_slot + 1) % len(poses), 2] += height


@pytest.mark.parametrize("success", ["clean", "lifted"])
def test_a_target_taken_after_a_disturbance_ends_the_episode_without_clean_success(success: str) -> None:
    env = SkillEnv(simulation="physics", num_objects=5, success=success)
    env.reset(seed=0)
    tamper(env, 0.06)
    *_, is_over, _, info = env.step(5 * DIRECTIONS)
    assert not is_over
    assert info["num_disturbed"] == 1
    _, reward, is_over, _, info = env.step(5 * DIRECTIONS)
    assert info["lifted"]
    assert is_over
    assert info["is_success"] == (success == "lifted")
    assert reward == info["is_success"] - SKILL_COST


@pytest.mark.parametrize("ends", [False, True])
def test_a_fall_ends_the_episode_if_it_shall(ends: bool) -> None:
    env = SkillEnv(simulation="physics", num_objects=5, terminate_on_fallen=ends)
    env.reset(seed=0)
    tamper(env, -0.5)
    _, _, is_over, _, info = env.step(5 * DIRECTIONS)
    assert info["num_fallen"] == 1
    assert is_over == ends


def test_rows_describe_the_scene_from_the_target_outwards(kinematic: SkillEnv) -> None:
    observation, info = kinematic.reset(seed=3)
    rows = observation[:-2].reshape(10, len(BODY_FIELDS) + DIRECTIONS)
    assert rows[:, 0].all()
    target = kinematic.scene.body(info["target"]).position[:2]
    assert np.allclose(rows[0, 1:3] * LENGTH_UNIT, target, atol=1e-6)
    distances = np.linalg.norm(rows[1:, 1:3], axis=1)
    assert (np.diff(distances) >= 0).all()
    for row in range(1, 10):
        body = kinematic.scene.body(kinematic.skill(row * DIRECTIONS).object)
        assert np.allclose(rows[row, 1:3] * LENGTH_UNIT, body.position[:2] - target, atol=1e-6)
        assert np.allclose(rows[row, 3:6] * LENGTH_UNIT, body.half_extents * (1, 1, 2), atol=1e-6)


def test_a_cleared_object_moves_down_the_rows_and_a_failure_stays_with_its_object(kinematic: SkillEnv) -> None:
    kinematic.reset(seed=7)
    action = free_clearance(kinematic)
    cleared = kinematic.skill(action).object
    kinematic.step(action)
    rows_of = {kinematic.skill(row * DIRECTIONS).object: row for row in range(10)}
    assert rows_of[cleared] > action // DIRECTIONS
    blocked = np.flatnonzero(kinematic.action_masks() & ~kinematic.action_masks(geometric=True))[0]
    observation, *_, info = kinematic.step(blocked)
    assert info["failure"]
    assert observation[:-2].reshape(10, -1)[blocked // DIRECTIONS, len(BODY_FIELDS) + blocked % DIRECTIONS] == 1
    assert (observation[:-2].reshape(10, -1)[:, len(BODY_FIELDS) :].sum(), observation[-1]) == (1, 0)


@pytest.mark.parametrize("action", [-1, 61, 1.5, "take", None])
def test_invalid_actions_are_refused_and_name_no_skill(kinematic: SkillEnv, action: object) -> None:
    kinematic.reset(seed=0)
    for call in (kinematic.step, kinematic.skill):
        with pytest.raises(ActionError, match="0 to 60"):
            call(action)
    assert kinematic.actions == []


def test_invalid_keywords_are_refused() -> None:
    with pytest.raises(ConfigError, match="kinematic"):
        gym.make("clutter_env/Skill-o5-v0", simulation="dream")
    with pytest.raises(ConfigError, match="budget"):
        SkillEnv(budget=0)


@pytest.mark.parametrize("simulation", ["kinematic", pytest.param("physics", marks=pytest.mark.slow)])
def test_gymnasium_checker_is_silent_without_a_display(simulation: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The checker renders in every mode that the environment lists; "human" needs a display."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    env = gym.make("clutter_env/Skill-o5-v0", simulation=simulation)
    assert "human" not in env.metadata["render_modes"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=True)


def test_calls_before_the_first_reset_are_refused() -> None:
    env = SkillEnv(simulation="kinematic", num_objects=5)
    for call in (lambda: env.step(0), lambda: env.skill(0), env.action_masks, env.render):
        with pytest.raises(ActionError, match="reset"):
            call()
    for name in ("scene", "target"):
        with pytest.raises(ActionError, match="reset"):
            getattr(env, name)


@pytest.mark.parametrize("simulation", SIMULATIONS)
def test_lying_cylinders_have_not_fallen(simulation: str) -> None:
    env = SkillEnv(simulation=simulation, num_objects=5, object_set="lying")
    observation, _ = env.reset(seed=0)
    rows = observation[:-2].reshape(5, -1)
    assert rows[:, BODY_FIELDS.index("present")].all()
    _, _, terminated, _, info = env.step(0)
    assert not terminated, "the target has not been lost"
    assert info["num_fallen"] == 0


def test_a_lying_cylinder_that_stands_up_has_fallen() -> None:
    body = Body("object_00", "cylinder", (0.025, 0.025, 0.07), (0.0, 0.0, TABLE_HEIGHT + 0.07), (1.0, 0.0, 0.0, 0.0))
    lying = body.at((0.0, 0.0, TABLE_HEIGHT + 0.025), (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0))
    assert (placed(body, is_lying=False), placed(lying, is_lying=True)) == (True, True)
    assert (placed(body, is_lying=True), placed(lying, is_lying=False)) == (False, False)
    assert not placed(lying.at((0.0, 0.0, 0.025)), is_lying=True), "it lies on the floor"


def placed(body: Body, is_lying: bool) -> bool:
    return is_as_placed(body.quaternion, body.bottom, is_lying)


def test_without_the_oracle_a_blocked_attempt_spoils_the_episode_on_the_kinematic_model() -> None:
    env = SkillEnv(simulation="kinematic", num_objects=10, feasibility="none")
    env.reset(seed=BLOCKED_SEED)
    _, reward, is_over, _, info = env.step(10 * DIRECTIONS)
    assert is_over
    assert reward == -SKILL_COST
    assert (info["failure"], info["num_refused"], info["is_success"]) == ("collision", 0, False)
    assert info["num_disturbed"] >= 1


def test_without_the_oracle_the_robot_pushes_what_is_in_the_way() -> None:
    env = SkillEnv(simulation="physics", num_objects=10, feasibility="none")
    env.reset(seed=BLOCKED_SEED)
    before = env.physics_env.measurements.poses[:, :2].copy()
    *_, info = env.step(10 * DIRECTIONS)
    shifted = np.linalg.norm(env.physics_env.measurements.poses[:, :2] - before, axis=1)
    shifted[env.physics_env.target_slot] = 0.0
    assert shifted.max() > 0.02
    assert info["num_refused"] == 0
    assert not info["is_success"]


@pytest.mark.parametrize("simulation", SIMULATIONS)
def test_a_described_scene_may_have_fewer_objects(simulation: str) -> None:
    """It was an IndexError. Actions of the rows without an object are refused, and masked."""
    env = SkillEnv(simulation=simulation, num_objects=5)
    place = {"shape": "cylinder", "radius": 0.03, "height": 0.16}
    objects = [{**place, "position": (-0.1, y)} for y in (-0.2, 0.2)]
    observation, _ = env.reset(seed=0, options={"objects": objects, "target": "object_01"})
    rows = observation[:-2].reshape(5, -1)
    assert rows[:, 0].tolist() == [1, 1, 0, 0, 0]
    assert not env.action_masks()[2 * DIRECTIONS : -1].any()
    with pytest.raises(ActionError, match="row 2 has no object; this scene has 2"):
        env.skill(2 * DIRECTIONS)
    _, reward, is_over, _, info = env.step(2 * DIRECTIONS)
    assert (reward, is_over, info["failure"], info["num_refused"]) == (-SKILL_COST, False, "absent", 1)
    assert env.step(5 * DIRECTIONS)[-1]["is_success"]
