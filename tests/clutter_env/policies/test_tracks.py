"""The learned policies of the package play on observations and public information alone."""

from __future__ import annotations

import inspect
from typing import Any

import gymnasium as gym
import pytest

from clutter_env.evaluation.policy_process import PolicyProcess
from clutter_env.policies.protocol import PublicInfo, check_public
from clutter_env.policies.registry import PolicyTraits, load_policy
from clutter_env.policies.reinforcement import MODEL_FILE
from clutter_env.task import Task
from clutter_env.training.run import Run
from clutter_env.training.settings import Settings
from clutter_env.training.train import make_model, save_model

SHIPPED = {"keyframes": "paper", "keyframes-all": "paper", "keyframes-shelf": "shelf", "end-to-end": "paper"}
TASKS = {
    "tqc": Task("clutter_env/Pick-v0"),
    **dict.fromkeys(("dqn", "maskable_ppo"), Task("clutter_env/Skill-o5-v0", {"simulation": "kinematic"})),
}


@pytest.fixture(scope="module", params=(*SHIPPED, *TASKS))
def learned(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, gym.Env[Any, Any]]:
    """The name of a learned policy, of untrained weights for a run, and an environment that it plays in."""
    name = request.param
    if name in SHIPPED:
        return name, gym.make("clutter_env/Retrieve-o5-v0", layout=SHIPPED[name])
    task, directory = TASKS[name], tmp_path_factory.mktemp("runs") / name
    Run(task, name, directory).write_record()
    env = task.make()
    save_model(make_model(name, Settings(steps=100), task.family, env), directory / MODEL_FILE)
    return str(directory), env


def test_no_learned_policy_receives_an_environment(learned: tuple[str, gym.Env[Any, Any]]) -> None:
    name, env = learned
    policy: Any = load_policy(name, 0)
    assert PolicyTraits.of(policy).track == "observations"
    observation, info = env.reset(seed=0)
    check_public(policy, PublicInfo.of(env))
    policy.reset(info)
    assert list(inspect.signature(policy.act).parameters) == ["observation"]
    for _ in range(3):
        observation, *_ = env.step(policy.act(observation))


@pytest.mark.slow
def test_every_learned_policy_plays_in_a_process_of_its_own(learned: tuple[str, gym.Env[Any, Any]]) -> None:
    name, env = learned
    here: Any = load_policy(name, 0)
    there = PolicyProcess(name, 0, "oracle")
    observation, info = env.reset(seed=0)
    for policy in (here, there):
        check_public(policy, PublicInfo.of(env))
        policy.reset(info)
    for _ in range(3):
        action = here.act(observation)
        assert there.act(observation) == action.tolist()
        observation, *_ = env.step(action)
    there.close()
