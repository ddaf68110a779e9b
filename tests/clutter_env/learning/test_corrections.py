"""Learners that correct an imitation: their environment, their buffer, their critics."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

torch = pytest.importorskip("torch")
pytest.importorskip("sb3_contrib")

from clutter_env.data.episode import record  # noqa: E402
from clutter_env.errors import LearningError  # noqa: E402
from clutter_env.learning.policies.agents import load_agent, model_agent  # noqa: E402
from clutter_env.learning.policies.chosen import consider, forget_chosen  # noqa: E402
from clutter_env.learning.policies.corrections import (  # noqa: E402
    HELD_STEPS,
    CorrectedActions,
    CorrectedAgent,
    corrected_observations,
)
from clutter_env.learning.policies.progress import remaining_steps  # noqa: E402
from clutter_env.learning.training.averaging import AveragedActor  # noqa: E402
from clutter_env.learning.training.critics_first import CriticsFirst  # noqa: E402
from clutter_env.policies.cloning import POLICY_FILE  # noqa: E402
from clutter_env.policies.experts import make_expert  # noqa: E402
from clutter_env.policies.features import OBJECT_ROW, OBJECTS_FROM, TCP_POSITION, feature_vector
from clutter_env.policies.protocol import (
    Policy,
    begin_episode,
)
from clutter_env.policies.reinforcement import training_env  # noqa: E402
from clutter_env.task import Task  # noqa: E402
from clutter_env.training.reinforcement import make_model, save_model  # noqa: E402
from clutter_env.training.run import Run  # noqa: E402

PICK = Task("clutter_env/Pick-v0")


@pytest.fixture(scope="module")
def corrected() -> CorrectedActions:
    """Pick with an imitation that has learned nothing."""
    env = PICK.make()
    observation, _ = env.reset(seed=0)
    torch.manual_seed(0)
    made = training_env("sac", env, Policy(feature_vector(observation).size, 10, 8))
    assert isinstance(made, CorrectedActions)
    return made


def test_no_correction_is_the_imitation(corrected: CorrectedActions) -> None:
    seen, _ = corrected.reset(seed=0)
    assert corrected.observation_space.contains(seen)
    plain = PICK.make()
    observation, _ = plain.reset(seed=0)
    assert np.array_equal(seen, corrected_observations(corrected.imitation, observation))
    for _ in range(3):
        seen, reward, *_ = corrected.step(np.zeros(4))
        first, total = observation, 0.0
        for _ in range(HELD_STEPS):
            observation, other, *_ = plain.step(corrected.imitation.act(observation))
            total += float(other)
        assert np.allclose(seen, corrected_observations(corrected.imitation, observation), atol=1e-6)
        assert reward == pytest.approx(total + remaining_steps(first) - remaining_steps(observation))


def test_corrections_are_undone_as_far_as_they_reach(corrected: CorrectedActions) -> None:
    imitated, action = np.linspace(-0.5, 0.5, 10), np.linspace(0.4, -0.4, 4)
    changed = corrected.corrected(imitated, action)
    assert np.flatnonzero(np.abs(changed - imitated) > 1e-6).tolist() == corrected.indices.tolist()
    assert np.allclose(corrected.corrections(imitated, changed), action, atol=1e-4)
    assert np.abs(corrected.corrections(imitated, imitated + 9.0)).max() == 1.0


def test_an_agent_holds_its_corrections_and_forgets_them_at_the_start_of_an_episode(
    corrected: CorrectedActions,
) -> None:
    asked: list[int] = []

    def correct(seen: NDArray[np.float32]) -> NDArray[np.float64]:
        """Zero at first, then one."""
        asked.append(len(seen))
        return np.full(4, float(len(asked) > 1))

    agent = CorrectedAgent(corrected, correct)
    observation, _ = PICK.make().reset(seed=2)
    imitated = corrected.imitation.act(observation)
    for _ in range(HELD_STEPS):
        assert np.allclose(agent(observation), imitated)
    assert len(asked) == 1
    assert not np.allclose(agent(observation), imitated, atol=1e-3)
    begin_episode(agent)
    agent(observation)
    assert len(asked) == 3


def test_the_script_makes_progress_until_the_goal_is_reached() -> None:
    env = PICK.make()
    episode = record(PICK, env, make_expert(env), seed=3)
    remaining = remaining_steps(episode.observations)
    assert remaining.shape == (len(episode) + 1,)
    assert remaining[0] > 20 > 5 > remaining[-1]
    held = episode.observations["observation"][:, OBJECTS_FROM + OBJECT_ROW.index("held")] > 0
    assert remaining[~held].min() > remaining[held].min() + 5


def test_a_gripper_beside_the_object_has_to_rise_first() -> None:
    observation, _ = PICK.make().reset(seed=0)
    vector = observation["observation"]
    at = vector[OBJECTS_FROM + OBJECT_ROW["position"].start :][:3]

    def remaining(x: float, z: float) -> float:
        """With the TCP at an offset [m] from the object's centre."""
        moved = vector.copy()
        moved[TCP_POSITION] = at + (x, 0.0, z)
        return float(remaining_steps({**observation, "observation": moved}))

    beside, over, lower = remaining(0.1, 0.0), remaining(0.1, 0.15), remaining(0.0, 0.1)
    assert beside > over > remaining(0.0, 0.15) > lower
    assert remaining(0.06, 0.0) > over, "sliding towards the object pushes it away"


@pytest.mark.parametrize("algorithm", ["sac", "tqc"])
def test_a_new_learner_acts_as_its_imitation_with_normalised_critics(
    corrected: CorrectedActions, algorithm: str
) -> None:
    model = make_model(algorithm, corrected, 0, has_clone=True)
    observation, _ = PICK.make().reset(seed=1)
    act = model_agent(algorithm, model, PICK.make(), corrected.imitation)
    assert np.allclose(act(observation), corrected.imitation.act(observation), atol=1e-6)
    for network in model.critic.q_networks:
        kinds = [type(layer).__name__ for layer in network]
        assert kinds == ["Linear", "LayerNorm", "ReLU", "Linear", "LayerNorm", "ReLU", "Linear"]
    moved = {id(weight) for group in model.critic.optimizer.param_groups for weight in group["params"]}
    assert {id(weight) for weight in model.critic.parameters()} == moved


def test_half_of_every_batch_are_demonstrations(corrected: CorrectedActions) -> None:
    env = PICK.make()
    episode = record(PICK, env, make_expert(env), seed=3)
    buffer = make_model("sac", corrected, 0, has_clone=True).replay_buffer
    seen, _ = corrected.reset(seed=0)
    buffer.add(seen, seen, np.zeros(4), np.array([7.0]), np.array([False]), [{}])
    assert (buffer.sample(10).rewards == 7.0).all()
    assert buffer.keep(corrected, [episode]) == len(episode) - HELD_STEPS + 1
    batch = buffer.sample(10)
    assert (batch.rewards == 7.0).sum() == 5
    assert batch.observations.shape == (10, seen.size)
    shown = buffer.demonstrations
    assert not shown.dones.sum() - shown.timeouts.sum(), "an episode of Pick ends by its time limit"


def test_what_acts_are_the_weights_that_did_best_on_validation_scenes(
    corrected: CorrectedActions, tmp_path: Path
) -> None:
    Run(PICK, "sac", 10, tmp_path).write_record()
    corrected.imitation.save(tmp_path / POLICY_FILE)
    model = make_model("sac", corrected, 0, has_clone=True)
    assert consider(model.policy.actor, 0.5, tmp_path)
    with torch.no_grad():
        model.policy.actor.mu.bias.fill_(3.0)
    save_model(model, tmp_path)
    env = PICK.make()
    observation, _ = env.reset(seed=1)
    imitated, last = (
        corrected.imitation.act(observation),
        model_agent("sac", model, env, corrected.imitation)(observation),
    )
    assert not np.allclose(imitated, last, atol=1e-3)
    assert not consider(model.policy.actor, 0.5, tmp_path)
    assert np.allclose(load_agent(tmp_path, env)(observation), imitated, atol=1e-6)
    assert consider(model.policy.actor, 0.6, tmp_path)
    assert np.allclose(load_agent(tmp_path, env)(observation), last, atol=1e-6)
    forget_chosen(tmp_path)
    assert consider(model.policy.actor, 0.1, tmp_path)


def test_learning_retrieve_from_rewards_needs_demonstrations(tmp_path: Path) -> None:
    run = Run(Task("clutter_env/Retrieve-o1-v0", {"control_mode": "ee"}), "sac", 10, tmp_path / "run")
    with pytest.raises(LearningError, match="clutter-env collect"):
        run.check()


def test_the_average_of_the_weights_is_in_place_for_a_while() -> None:
    model = make_model("sac", PICK.make(), 0)
    averaged = AveragedActor()
    averaged.init_callback(model)
    weight = model.policy.actor.mu.bias
    with torch.no_grad():
        weight.fill_(0.0)
    averaged.on_training_start({}, {})
    for value in (1.0, 3.0):
        with torch.no_grad():
            weight.fill_(value)
        averaged.on_step()
    with averaged.in_place():
        assert torch.allclose(weight, torch.full_like(weight, 2.0))
    assert (weight == 3.0).all()


def test_the_critics_learn_alone_at_first() -> None:
    model = make_model("sac", PICK.make(), 0)
    first = CriticsFirst(10)
    first.init_callback(model)
    first.on_training_start({}, {})
    weight = model.policy.actor.mu.bias
    before = weight.detach().clone()
    for steps, stays in ((10, True), (11, False)):
        model.num_timesteps = steps
        with torch.no_grad():
            weight.fill_(7.0)
        first.on_step()
        assert torch.equal(weight, before) == stays
