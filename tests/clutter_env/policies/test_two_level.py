"""Policies of two levels: what observations show, how keyframes are reached, who is asked when."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray

from assets import FETCH
from clutter_env.policies.motion.control import GripperError, IntegralOffset, action_towards, error_to
from clutter_env.policies.parsed_observation import Observation, parse_observation
from clutter_env.policies.protocol import SKILLS, PolicyError
from clutter_env.policies.two_level import TwoLevelPolicy
from planners import Contact, tcp_pose
from planners.scene import RobotState

Env = gym.Env[Any, Any]


def test_a_parsed_observation_is_the_state_of_the_simulation(env: Env) -> None:
    observation, _ = env.reset(seed=3)
    inner: Any = env.unwrapped
    rng = np.random.default_rng(0)
    for _ in range(20):
        observation, *_ = env.step(rng.uniform(-1, 1, 12))
    seen = parse_observation(observation)
    np.testing.assert_allclose(seen.whole_body, inner.data.qpos[inner.world.index.drive_qpos], atol=1e-5)
    np.testing.assert_allclose(seen.tcp, tcp_pose(FETCH, RobotState(seen.base, seen.q, 0.0)), atol=1e-4)
    for index, name in enumerate(inner.object_names):
        assert seen.index(name) == index
        np.testing.assert_allclose(seen.position(index), inner.measurements.poses[index, :3], atol=1e-5)
    with pytest.raises(PolicyError, match="object_04"):
        seen.index("cup")


def test_a_keyframe_is_reached_on_a_straight_line_in_joint_space(env: Env) -> None:
    observation, _ = env.reset(seed=5)
    start = parse_observation(observation).whole_body
    goal = start + np.array([0.1, -0.2, 0.3, 0.05, 0.4, 0.5, -0.3, -0.6, 0.2, 0.4, -0.5])
    off_line = []
    for _ in range(80):
        seen = parse_observation(observation)
        moved = seen.whole_body - start
        share = moved @ (goal - start) / np.sum((goal - start) ** 2)
        off_line.append(np.abs(moved - share * (goal - start)).max())
        observation, *_ = env.step(action_towards(FETCH, seen, goal, 0.02, False))
    assert np.abs(error_to(parse_observation(observation), goal)).max() < 2e-3
    assert max(off_line) < 0.04
    assert parse_observation(observation).widths[0] == pytest.approx(FETCH.opening(0.02), abs=2e-3)


def test_an_integral_offset_leads_a_gripper_that_is_off_to_the_contact() -> None:
    contact, off = np.eye(4), np.eye(4)
    off[:3, 3] = 0.02, -0.01, 0.005
    offset = IntegralOffset()
    for _ in range(60):
        offset.correct(GripperError.between(offset.applied_to(contact) @ off, contact))
    error = GripperError.between(offset.applied_to(contact) @ off, contact)
    assert error.is_small()
    assert np.linalg.norm(error.shift) < 1e-4


class Script:
    """Both levels in one that follow a script: what to decide, and whether each pick or place fails."""

    def __init__(self, contacts: list[Contact | None], failing: list[bool]) -> None:
        self.contacts, self.failing = contacts, failing
        self.failure = ""
        self.started: list[Contact] = []
        self.is_done, self.has_failed = True, False

    def reset(self, info: Mapping[str, Any]) -> None:  # noqa: ARG002  part of the protocol
        self.started = []

    def decide(self, observation: Observation) -> Contact | None:  # noqa: ARG002  part of the protocol
        contact = self.contacts[min(len(self.started), len(self.contacts) - 1)]
        self.failure = "nothing left" if contact is None else ""
        return contact

    def start(self, contact: Contact, observation: Observation) -> None:  # noqa: ARG002  part of the protocol
        self.has_failed = self.failing[len(self.started) % len(self.failing)]
        self.started.append(contact)

    def act(self, observation: Observation) -> NDArray[Any]:  # noqa: ARG002  part of the protocol
        return np.zeros(12)


def contact(skill: str, name: str) -> Contact:
    return Contact(skill, name, np.zeros(3), np.eye(4))


def played(script: Script, steps: int = 60) -> TwoLevelPolicy:
    policy = TwoLevelPolicy(script, script)
    policy.reset({"target": "target"})
    for _ in range(steps):
        if policy.done:
            break
        policy.act({})
    return policy


def test_picks_and_places_are_executed_in_turn_until_the_target_is_taken() -> None:
    contacts = [contact("pick", "a"), contact("place", "a"), contact("pick", "target")]
    script = Script([*contacts], [False])
    policy = played(script)
    assert script.started == contacts
    assert policy.done
    assert not policy.failure
    assert not policy.is_privileged


def test_a_policy_gives_up_with_its_high_level_or_once_the_budget_of_all_policies_is_spent() -> None:
    assert played(Script([contact("pick", "a"), None], [False])).failure == "nothing left"
    endless = played(Script([contact("pick", "a")], [True]), steps=200)
    assert endless.started == SKILLS
    assert str(SKILLS) in endless.failure
    turns = Script([contact(skill, "a") for _ in range(50) for skill in ("pick", "place")], [False])
    assert played(turns, steps=200).started == 2 * SKILLS
