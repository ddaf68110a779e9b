"""The network of decisions, its fit, its file, and deciders made of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

torch = pytest.importorskip("torch")

from assets.robots import FETCH  # noqa: E402  after the check for torch
from clutter_env.learning.decisions.contact_rule import ContactRule  # noqa: E402
from clutter_env.learning.decisions.dagger import visit  # noqa: E402
from clutter_env.learning.decisions.decider import LearnedDecider  # noqa: E402
from clutter_env.learning.decisions.examples import ContactExamples  # noqa: E402
from clutter_env.training.high_level_examples import examples_of_scene, scene_of  # noqa: E402
from clutter_env.learning.decisions.fitting import FitConfig, fit  # noqa: E402
from clutter_env.training.high_level_fit import accuracy, batch_of  # noqa: E402
from clutter_env.learning.decisions.kinematic import apply_contact  # noqa: E402
from clutter_env.training.high_level_rollouts import as_observed  # noqa: E402
from clutter_env.learning.decisions.model_file import DecisionModel  # noqa: E402
from clutter_env.learning.decisions.network import ContactNetwork  # noqa: E402
from clutter_env.learning.errors import LearningError  # noqa: E402
from clutter_env.learning.task import Task  # noqa: E402
from clutter_env.learning.training.run import Run  # noqa: E402
from clutter_env.learning.training.training import train  # noqa: E402
from clutter_env.scene.layout import find_layout  # noqa: E402

RULE = ContactRule(FETCH, find_layout("paper"))


@pytest.fixture(scope="module")
def env():
    made = gym.make("clutter_env/Retrieve-o5-v0")
    yield made
    made.close()


@pytest.fixture(scope="module")
def examples(env) -> ContactExamples:
    parts = []
    for seed in range(3):
        env.reset(seed=seed)
        parts.append(examples_of_scene(scene_of(env), RULE, np.random.default_rng(seed)))
    return ContactExamples.joined(parts)


@pytest.fixture(scope="module")
def network(examples: ContactExamples) -> ContactNetwork:
    return fit(examples, FitConfig(steps=500, batch=64, width=32))


def test_a_permutation_of_the_objects_permutes_what_is_in_the_way(examples, network) -> None:
    batch, order = batch_of(examples, np.arange(40)), torch.tensor([3, 0, 4, 1, 2])
    permuted = batch._replace(others=batch.others[:, order], is_present=batch.is_present[:, order])
    with torch.no_grad():
        one, other = network(batch), network(permuted)
    assert torch.allclose(one.blocks[:, order], other.blocks, atol=1e-5)
    assert torch.equal(one.reach, other.reach)
    assert torch.allclose(one.log_free, other.log_free, atol=1e-5)


def test_absent_objects_do_not_matter(examples, network) -> None:
    batch = batch_of(examples, np.arange(40))
    others = torch.where(batch.is_present[..., None], batch.others, torch.tensor(0.3))
    with torch.no_grad():
        assert torch.equal(network(batch).log_free, network(batch._replace(others=others)).log_free)


def test_mirrored_twice_is_the_same(examples) -> None:
    mirrored = batch_of(examples, np.arange(9), is_mirrored=True)
    assert torch.equal(mirrored.own[:, 1], -batch_of(examples, np.arange(9)).own[:, 1])
    assert torch.equal(mirrored.base[:, 2], -batch_of(examples, np.arange(9)).base[:, 2])


def test_fitting_learns(examples, network) -> None:
    untrained = accuracy(ContactNetwork(32), examples)
    trained = accuracy(network, examples)
    reached = examples.is_reached
    always_clear = (
        1 - examples.blockers[reached].sum() / batch_of(examples, reached.nonzero()[0]).is_present.numpy().sum()
    )
    always_reached = reached.mean()
    assert trained.blocks > max(untrained.blocks, always_clear + 0.01)
    assert trained.reach > max(untrained.reach, always_reached)


def test_examples_and_models_survive_their_files(examples, network, tmp_path: Path) -> None:
    examples.save(tmp_path / "examples.npz")
    read = ContactExamples.load(tmp_path / "examples.npz")
    assert np.array_equal(read.blockers, examples.blockers)
    DecisionModel(network, replace(RULE, grasps="all")).save(tmp_path / "model.npz")
    model = DecisionModel.load(tmp_path / "model.npz")
    assert model.rule == replace(RULE, grasps="all")
    batch = batch_of(examples, np.arange(5))
    with torch.no_grad():
        assert torch.equal(model.network(batch).blocks, network(batch).blocks)
    (tmp_path / "other.npz").write_bytes(b"nothing")
    for name in ("other.npz", "absent.npz"):
        with pytest.raises(LearningError, match="holds no learned decider"):
            DecisionModel.load(tmp_path / name)


def test_a_decider_takes_an_object_and_puts_it_down(env, network) -> None:
    observation, info = env.reset(seed=1)
    scene, decider = scene_of(env), LearnedDecider(network, RULE)
    pick = decider.decide(observation)
    assert pick is not None
    assert pick.skill == "pick"
    other = next(name for name in scene.names if name != pick.object)
    holding = apply_contact(scene, pick)
    place = LearnedDecider(network, RULE).choose(as_observed(holding, other))
    assert place is not None
    assert (place.skill, place.object) == ("place", pick.object)
    assert LearnedDecider(network, RULE).choose(as_observed(holding, pick.object)) is None
    assert info["target"] in scene.names


def test_after_a_miss_it_decides_otherwise(env, network) -> None:
    observation, _ = env.reset(seed=1)
    decider = LearnedDecider(network, RULE)
    chosen = [decider.decide(observation) for _ in range(3)]
    bases = {tuple(np.round([*one.base, *one.tcp[:2, 3]], 6)) for one in chosen if one is not None}
    assert len(bases) == 3
    decider.reset()
    again = decider.decide(observation)
    assert again is not None
    assert np.array_equal(again.base, chosen[0].base)  # type: ignore[union-attr]  # it is not None, see above


def test_a_decider_gives_up_when_nothing_is_left(env, network) -> None:
    observation, _ = env.reset(seed=1)
    rule = replace(RULE, layout=replace(find_layout("paper"), depth=3.0))
    decider = LearnedDecider(network, rule)
    assert decider.decide(observation) is None
    assert decider.failure


def test_dagger_labels_the_states_of_the_learner(env, network) -> None:
    _, info = env.reset(seed=1)
    visited = visit(LearnedDecider(network, RULE), [(scene_of(env), info["target"])], RULE, np.random.default_rng(0))
    assert len(visited.outcomes) == 1
    assert visited.examples is not None
    assert len(visited.examples.objects) == len(visited.outcomes[0].contacts)


def test_training_writes_a_decider_and_its_history(tmp_path: Path) -> None:
    run = Run(
        task=Task("clutter_env/Retrieve-o5-v0"),
        algorithm="decisions_dagger",
        steps=40,
        directory=tmp_path / "run",
        episodes=2,
        rounds=1,
        round_episodes=1,
        evaluation_episodes=1,
    )
    trained = train(run)
    assert [entry["round"] for entry in trained.history] == [0, 1]
    assert trained.history[1]["examples"] > trained.history[0]["examples"]
    assert json.loads((tmp_path / "run" / "history.json").read_text()) == trained.history
    decider = LearnedDecider.load(tmp_path / "run" / "decisions.npz")
    assert decider.rule == RULE
    with pytest.raises(LearningError, match="holds a training run"):
        train(run)
