"""The search expert: it finds and takes the target by camera data alone, and says when there is none."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import clutter_env
from planners import ExpertError, SearchExpert
from planners.cause import Cause
from planners.expert.actor import Actor
from planners.expert.executor import Command
from planners.scene import HeldObject
from planners.search.options import Prospect, spots
from planners.search.perception import Description, Seen
from planners.tamp.solution import Infeasible
from tests.planners.scenes import cylinder, table_scene

_SEEN = ("robot", "tcp", "gripper", "head", "target") + tuple(
    f"head_{kind}" for kind in ("rgb", "depth", "segmentation", "K", "T_base_camera")
)


def _search(env: Any, seed: int, colour: tuple[float, ...] = ()) -> tuple[SearchExpert, dict[str, Any]]:
    """An episode in which the expert gets some of the observation and five names of the environment."""
    observation, info = env.reset(seed=seed)
    inner = env.unwrapped
    starved = SimpleNamespace(
        robot=inner.robot,
        workplace=inner.workplace,
        support_name=inner.support_name,
        control_mode=inner.control_mode,
        joint_action=inner.joint_action,
    )
    expert, is_over, is_first = SearchExpert(starved), False, True
    while not (is_over or (not is_first and expert.done)):
        given = {name: np.array(observation[name]) for name in _SEEN}
        if colour:
            given["target"][:3] = colour
        if is_first:
            expert.reset(given)
        is_first = False
        observation, _, terminated, truncated, info = env.step(expert.act(given))
        is_over = truncated or (terminated and not colour)  # what is put aside may be the target of the scene
    return expert, info


@pytest.mark.slow
def test_it_finds_and_takes_a_hidden_target_by_camera_data_alone() -> None:
    env = gym.make("clutter_env/Search-o5-v0", frame_every=10)
    expert, info = _search(env, 1)
    assert info["is_success"]
    assert expert.report.found
    assert max(expert.report.belief_s) < 0.05


@pytest.mark.slow
def test_objects_put_aside_on_the_way_to_the_target_count_though_the_episode_ends_with_it() -> None:
    env = gym.make("clutter_env/Search-o10-v0", frame_every=10)
    expert, info = _search(env, 3)
    assert info["is_success"]
    assert len(expert.report.moves) == info["num_cleared"] > 0


@pytest.mark.slow
def test_it_looks_where_the_arm_would_pass_before_it_takes_the_target() -> None:
    """The target is in sight at once here, and an object that is not stands on the way to it."""
    scene = clutter_env.suite("hidden-shelf-10-v2").test[7]
    expert, info = _search(scene.make(frame_every=10), scene.seed)
    assert info["is_success"]
    assert expert.report.views > 0


@pytest.mark.slow
def test_it_says_that_an_absent_target_cannot_be_found() -> None:
    """No object is grey; all places have to be seen for that answer."""
    env = gym.make("clutter_env/Search-o5-v0", frame_every=10)
    expert, info = _search(env, 0, (0.5, 0.5, 0.5))
    assert expert.report.failure == "cannot be found"
    assert (info["num_fallen"], info["num_disturbed"]) == (0, 0)


@pytest.mark.slow
@pytest.mark.parametrize("index", [0, 4])
def test_among_ten_objects_too_it_says_so_before_the_time_is_up(index: int) -> None:
    """In the first scene the time was up before that, in the other one the last places were seen from too few sides."""
    scene = clutter_env.suite("hidden-shelf-10-v2").test[index]
    expert, info = _search(scene.make(frame_every=10), scene.seed, (0.5, 0.5, 0.5))
    assert expert.report.failure == "cannot be found"
    assert (info["num_fallen"], info["num_disturbed"]) == (0, 0)


def test_misuse_is_named() -> None:
    env = gym.make("clutter_env/Search-o5-v0", image_size=16)
    with pytest.raises(ExpertError, match="valid values: expected, random, front, shadow"):
        SearchExpert(env, order="luck")
    with pytest.raises(ExpertError, match=r"lacks workplace; use clutter_env/Search-o\{N\}-v0"):
        SearchExpert(gym.make("clutter_env/Retrieve-o5-v0"))
    with pytest.raises(ExpertError, match="control_mode must be 'joint', and base 'holonomic'"):
        SearchExpert(gym.make("clutter_env/Search-o5-v0", image_size=16, base="differential"))
    with pytest.raises(ExpertError, match="call SearchExpert"):
        SearchExpert(env).act({})
    with pytest.raises(ExpertError, match="noise=-1"):
        SearchExpert(env, noise=-1)
    above = gym.make("clutter_env/Search-o5-v0", image_size=16, cameras=("top",), visible_fraction=1.0)
    with pytest.raises(ExpertError, match=r"\('top',\) do not move with the robot; it has head, gripper"):
        SearchExpert(above).reset(above.reset(seed=1)[0])


def test_of_several_cameras_the_one_in_the_head_is_aimed() -> None:
    """By the alphabet it was the gripper's, which the head does not move."""
    env = gym.make("clutter_env/Search-o5-v0", image_size=16, cameras=("gripper", "head", "top"), visible_fraction=1.0)
    expert = SearchExpert(env)
    expert.reset(env.reset(seed=1)[0])
    assert expert._knowledge.cameras == ["head", "gripper", "top"]


def test_a_second_episode_begins_where_the_robot_is() -> None:
    env = gym.make("clutter_env/Search-o5-v0", image_size=32)
    used, fresh = SearchExpert(env), SearchExpert(env)
    given, _ = env.reset(seed=1)
    used.reset(given)
    used._actor.last = Command(used._knowledge.reading.drive + 1.0, 0.0)  # as an episode may leave it
    given, _ = env.reset(seed=2)
    for expert in (used, fresh):
        expert.reset(given)
    np.testing.assert_array_equal(used.act(given), fresh.act(given))


def _after_a_look() -> tuple[Any, SearchExpert, dict[str, Any]]:
    """An environment, the expert that has looked at all its supports, and the observation after that."""
    env = gym.make("clutter_env/Search-o5-v0", image_size=32, frame_every=10)
    expert = SearchExpert(env)
    given, _ = env.reset(seed=1)
    expert.reset(given)
    expert._actor = Actor(expert._actor.last, partial(expert._look, []))
    while not expert.done:
        given, *_ = env.step(expert.act(given))
    return env, expert, given


def test_it_looks_at_all_supports_where_no_place_is_left() -> None:
    """After a move that made way for the target, in sight by then, nothing was looked at."""
    _, expert, _ = _after_a_look()
    assert len(expert.report.belief_s) == len(expert._knowledge.supports)


def test_the_robot_hides_little_of_any_support_that_it_looks_at() -> None:
    """For the second and the third support the arm stayed where it was, and hid half of the image."""
    env = gym.make("clutter_env/Search-o5-v0", image_size=64, frame_every=10)
    expert = SearchExpert(env)
    given, _ = env.reset(seed=1)
    expert.reset(given)
    expert._actor, hidden = Actor(expert._actor.last, partial(expert._look, [])), []
    while not expert.done:
        updates = len(expert.report.belief_s)
        action = expert.act(given)
        if len(expert.report.belief_s) > updates:
            hidden.append((given["head_segmentation"] == 1).mean())
        given, *_ = env.step(action)
    assert len(hidden) == len(expert._knowledge.supports)
    assert max(hidden) < 0.1


def test_for_what_no_grasp_reaches_one_spot_is_planned_with() -> None:
    env = gym.make("clutter_env/Search-o5-v0", image_size=32)
    expert = SearchExpert(env)
    expert.reset(env.reset(seed=1)[0])
    body = cylinder("seen_00", -0.1, 0.0, radius=0.03).at((-0.1, 0.0, expert._knowledge.empty.support.top + 0.075))
    expert._knowledge.objects = (Seen(body, body.position[None], np.zeros(3), 0.0),)
    for level in expert._knowledge.belief._levels.values():
        level.is_unseen[:] = False
    tried: list[str] = []

    def refuse(scene: Any, _goal: Any) -> Infeasible:
        tried.append(scene.regions[0].name)
        return Infeasible(causes[len(tried) > 1], "")

    expert._decisions.solved = refuse  # type: ignore[method-assign]  # a planner that refuses
    causes = (Cause.MOTION, Cause.UNREACHABLE)
    assert expert._decisions.plan_aside(["seen_00"], expert._knowledge.places()) is None
    assert len(tried) == 2
    assert expert._decisions.refusals == {"seen_00": "unreachable"}


def test_the_end_of_a_search_says_no_more_than_was_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cannot be found: only if no place is left, and the target has not been seen before."""
    env = gym.make("clutter_env/Search-o5-v0", image_size=32)
    expert = SearchExpert(env)
    expert.reset(env.reset(seed=1)[0])
    for name in ("_look", "_go_home"):
        monkeypatch.setattr(expert, name, lambda *_: [])
    decisions = expert._decisions
    monkeypatch.setattr(decisions, "ranked", lambda *_: (None, ["seen_00"]))
    monkeypatch.setattr(decisions, "plan_aside", lambda *_: decisions.refusals.update(seen_00=Cause.UNREACHABLE))
    levels = expert._knowledge.belief._levels
    left = sum(int(cells.sum()) for cells in expert._knowledge.places().values())
    Actor(Command(np.zeros(11), 0.0), expert._decide).decide()
    assert expert.report.failure.startswith("not found where it can be seen;")
    assert sum(int(word) for word in expert.report.failure.split() if word.isdigit()) == left
    assert expert.report.failure.endswith("places stay hidden by seen_00 (unreachable)")
    for level in levels.values():
        level.is_possible[:] = False
    Actor(Command(np.zeros(11), 0.0), expert._decide).decide()
    assert expert.report.failure == "cannot be found"
    expert.report.found = True
    Actor(Command(np.zeros(11), 0.0), expert._decide).decide()
    assert expert.report.failure == "lost after it was seen"


def test_motions_to_views_are_planned_from_where_the_arm_is() -> None:
    """It went home after each view, for 4 s and up to 20 s where the torso had risen."""
    env, expert, given = _after_a_look()
    assert not np.allclose(expert._knowledge.reading.drive[3:], expert._env.robot.home, atol=0.1)
    expert._actor = Actor(expert._actor.last, expert._go_home)
    while not expert.done:
        given, *_ = env.step(expert.act(given))
    np.testing.assert_allclose(expert._knowledge.reading.drive[3:], expert._env.robot.home, atol=0.02)


def test_of_a_target_seen_as_two_things_the_surer_one_is_planned_with_among_all_others() -> None:
    env = gym.make("clutter_env/Search-o5-v0", image_size=32)
    expert = SearchExpert(env)
    expert.reset(env.reset(seed=1)[0])
    places = {"sliver": (-0.1, 0.0), "target": (-0.1, 0.005), "left": (-0.1, 0.3), "right": (-0.1, -0.3)}
    bodies = [cylinder(name, *place, radius=0.03) for name, place in places.items()]
    expert._knowledge.objects = tuple(
        Seen(
            body,
            np.zeros((10 if body.name == "sliver" else 100, 3)),
            np.zeros(3),
            0.0,
            body.name in ("sliver", "target"),
        )
        for body in bodies
    )
    assert expert._knowledge.scene().names == ("target", "left", "right")
    assert expert._knowledge.is_target("target")
    assert not expert._knowledge.is_target("sliver")


def test_what_is_held_is_not_given_up_though_its_place_is_seen_to_be_empty() -> None:
    env = gym.make("clutter_env/Search-o5-v0", image_size=32)
    expert = SearchExpert(env)
    expert.reset(env.reset(seed=1)[0])
    body = cylinder("seen_00", -0.1, 0.0, radius=0.03)
    expert._knowledge.objects = (Seen(body, body.position[None], np.zeros(3), 0.0),)
    for level in expert._knowledge.belief._levels.values():
        level.is_unseen[:] = False
    assert expert._knowledge.belief.emptied(body) == 1
    expert._knowledge.held = HeldObject(body.name, np.eye(4))
    expert._knowledge.reading = replace(expert._knowledge.reading, width=0.06, commanded=0.05)
    expert._knowledge.look()
    assert expert._knowledge.scene().held_names == ("seen_00",)
    np.testing.assert_allclose(
        expert._knowledge.scene().body("seen_00").position, expert._knowledge.reading.T_world_tcp[:3, 3]
    )
    expert._knowledge.reading = replace(expert._knowledge.reading, width=0.05)  # the fingers press on nothing: it fell
    expert._knowledge.carry()
    assert expert._knowledge.scene().held_names == ()
    assert expert._knowledge.scene().body("seen_00").bottom == pytest.approx(0.0, abs=1e-9)


def test_what_hides_more_counts_more_and_a_spot_hides_nothing() -> None:
    """A wide object before the unseen places, a slim one beside them."""
    from planners.search.belief import Belief

    wide, slim = cylinder("wide", -0.1, 0.0, radius=0.045, height=0.2), cylinder("slim", -0.1, 0.3, radius=0.015)
    scene = table_scene(wide, slim)
    belief = Belief.begin(scene, Description((1, 0, 0), "cylinder", (0.03, 0.03, 0.06)))
    places = belief.places(scene.objects)
    x, y = np.moveaxis(belief.grid("table_top").centres(), -1, 0)
    places["table_top"] &= (np.abs(y) < 0.05) & (x > 0.0)
    prospect, eye = Prospect(belief, places, scene), np.array([-1.2, 0.0, 1.0])
    shadows = prospect.shadows(eye)
    assert shadows["wide"] > 0.3 > shadows["slim"] == 0
    assert prospect.gain(eye) + shadows["wide"] == pytest.approx(1.0)
    for level in belief._levels.values():
        level.is_unseen[:] = False
    best = spots(scene, wide, belief, prospect, [eye], np.random.default_rng(0))[0]
    there = wide.at((*best.centre, wide.position[2]))
    assert prospect.hidden_by(there, [eye]) < 0.02 < prospect.hidden_by(wide, [eye])


@pytest.mark.parametrize("turn", [0.05, 0.6])
def test_motions_between_views_keep_the_limits(turn: float) -> None:
    """What exceeds them is overshot, and the plan that follows begins with a joint in motion, which then lags."""
    env = gym.make("clutter_env/Search-o5-v0", image_size=32)
    expert = SearchExpert(env)
    expert.reset(env.reset(seed=1)[0])
    robot, start = expert._env.robot, expert._knowledge.reading.drive
    goal = start + turn * np.eye(len(start))[4]
    actor = Actor(Command(start, 0.1), partial(expert._move_to, goal))
    actor.decide()
    sent = [start, start]
    while not actor.is_idle:
        sent.append(actor.command().drive)
        actor.decide()
    commanded = np.array(sent)
    np.testing.assert_array_equal(commanded[-1], goal)
    speeds = np.diff(commanded, axis=0) / 0.05
    assert (np.abs(speeds) <= np.array(robot.max_velocity)).all()
    assert (np.abs(np.diff(speeds, axis=0)) / 0.05 <= np.array(robot.max_acceleration)).all()
