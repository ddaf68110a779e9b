"""Policies of two levels: what observations tell, how keyframes are reached, who is asked when."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray

import clutter_env  # noqa: F401  registers the environments
from assets.robots import FETCH
from clutter_env.learning.contacts.hierarchical import MOST_CONTACTS, HierarchicalPolicy
from clutter_env.learning.contacts.planned_decider import PlannedDecider
from clutter_env.learning.contacts.planned_mover import PlannedMover
from clutter_env.learning.contacts.reading import planar_pose, read
from clutter_env.learning.contacts.tracking import action_towards, error_to
from planners.contact import Contact
from planners.motion.arm import tcp_pose
from planners.scene import RobotState

Observation = Mapping[str, NDArray[Any]]


@pytest.fixture(scope="module")
def env() -> gym.Env[Any, Any]:
    return gym.make("clutter_env/Retrieve-o5-v0")


def test_a_reading_is_the_state_of_the_simulation(env: gym.Env[Any, Any]) -> None:
    observation, _ = env.reset(seed=3)
    inner: Any = env.unwrapped
    rng = np.random.default_rng(0)
    for _ in range(20):
        observation, *_ = env.step(rng.uniform(-1, 1, 12))
    reading = read(observation)
    np.testing.assert_allclose(reading.whole_body, inner.data.qpos[inner.world.index.drive_qpos], atol=1e-5)
    tcp = tcp_pose(FETCH, RobotState(reading.base, reading.q, 0.0))
    np.testing.assert_allclose(reading.tcp, tcp, atol=1e-4)
    for index in range(5):
        np.testing.assert_allclose(reading.position(index), inner.measurements.poses[index, :3], atol=1e-5)


def test_readings_of_an_episode_are_those_of_its_steps(env: gym.Env[Any, Any]) -> None:
    observations = [env.reset(seed=4)[0], *(env.step(np.full(12, 0.3))[0] for _ in range(3))]
    together = read({name: np.stack([one[name] for one in observations]) for name in observations[0]})
    for step, observation in enumerate(observations):
        np.testing.assert_allclose(together.tcp[step], read(observation).tcp)
        np.testing.assert_allclose(together.position(1)[step], read(observation).position(1))


def test_a_keyframe_is_reached_on_a_straight_line_in_joint_space(env: gym.Env[Any, Any]) -> None:
    observation, _ = env.reset(seed=5)
    start = read(observation).whole_body
    goal = start + np.array([0.1, -0.2, 0.3, 0.05, 0.4, 0.5, -0.3, -0.6, 0.2, 0.4, -0.5])
    off_line = []
    for _ in range(80):
        reading = read(observation)
        way = reading.whole_body - start
        share = way @ (goal - start) / np.sum((goal - start) ** 2)
        off_line.append(np.abs(way - share * (goal - start)).max())
        observation, *_ = env.step(action_towards(FETCH, reading, goal, 0.02, False))
    assert np.abs(error_to(read(observation), goal)).max() < 2e-3
    assert max(off_line) < 0.04
    assert read(observation).widths[0] == pytest.approx(FETCH.opening(0.02), abs=2e-3)


class Script:
    """A decider and a mover in one that follow a script: what to decide, and whether each contact is missed."""

    def __init__(self, contacts: list[Contact | None], missed: list[bool]) -> None:
        self.contacts, self.missed = contacts, missed
        self.failure = ""
        self.started: list[Contact] = []
        self.is_done, self.has_missed = True, False

    def reset(self, env: gym.Env[Any, Any], info: Mapping[str, Any]) -> None:  # noqa: ARG002  part of the protocol
        self.started = []

    def decide(self, observation: Observation) -> Contact | None:  # noqa: ARG002  part of the protocol
        contact = self.contacts[min(len(self.started), len(self.contacts) - 1)]
        self.failure = "nothing left" if contact is None else ""
        return contact

    def start(self, contact: Contact, observation: Observation) -> None:  # noqa: ARG002  part of the protocol
        self.has_missed = self.missed[len(self.started) % len(self.missed)]
        self.started.append(contact)

    def act(self, observation: Observation) -> NDArray[Any]:  # noqa: ARG002  part of the protocol
        return np.zeros(12)


def contact(skill: str, name: str) -> Contact:
    return Contact(skill, name, np.zeros(3), np.eye(4))


def played(env: gym.Env[Any, Any], script: Script, steps: int = 60) -> HierarchicalPolicy:
    observation, info = env.reset(seed=1)
    policy = HierarchicalPolicy(script, script)
    policy.reset(env, {**info, "target": "target"})
    for _ in range(steps):
        if policy.done:
            break
        policy.act(observation)
    return policy


def test_contacts_are_brought_about_in_turn_until_the_target_is_taken(env: gym.Env[Any, Any]) -> None:
    contacts = [contact("pick", "a"), contact("place", "a"), contact("pick", "target")]
    script = Script([*contacts], [False])
    policy = played(env, script)
    assert script.started == contacts
    assert policy.done
    assert policy.failure == ""


def test_after_a_missed_target_the_decider_is_asked_again(env: gym.Env[Any, Any]) -> None:
    script = Script([contact("pick", "target")] * 3, [True, True, False])
    policy = played(env, script)
    assert (policy.contacts, policy.missed, policy.failure) == (3, 2, "")


def test_a_policy_gives_up_with_its_decider_or_after_many_contacts(env: gym.Env[Any, Any]) -> None:
    assert played(env, Script([contact("pick", "a"), None], [False])).failure == "nothing left"
    endless = played(env, Script([contact("pick", "a")], [True]), steps=2 * MOST_CONTACTS)
    assert endless.contacts == MOST_CONTACTS
    assert str(MOST_CONTACTS) in endless.failure


def test_planned_decisions_and_planned_motions_retrieve_a_target_that_is_obstructed() -> None:
    env = gym.make("clutter_env/Retrieve-o5-v0", obstructed=True)
    mover = PlannedMover()
    policy = HierarchicalPolicy(PlannedDecider(), mover)
    observation, info = env.reset(seed=11)
    policy.reset(env, info)
    while not (policy.done or info["lifted"]):
        observation, _, _, _, info = env.step(policy.act(observation))
    assert info["is_success"]
    assert policy.contacts >= 3
    assert (policy.missed, mover.refused) == (0, 0)


def test_a_contact_out_of_reach_is_refused_and_the_robot_stays(env: gym.Env[Any, Any]) -> None:
    observation, info = env.reset(seed=2)
    mover = PlannedMover()
    mover.reset(env, info)
    tcp = planar_pose(np.array([3.0, 0.0, 0.0]))
    mover.start(Contact("pick", "object_00", np.array([-1.2, 0.0, 0.0]), tcp), observation)
    assert (mover.is_done, mover.has_missed, mover.refused) == (True, True, 1)
    assert mover.reason
    before = read(observation).whole_body
    for _ in range(5):
        observation, *_ = env.step(mover.act(observation))
    np.testing.assert_allclose(read(observation).whole_body, before, atol=2e-3)
