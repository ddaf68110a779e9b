"""Examples for the high-level policy, the fit of its network, and rollouts without physics."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

torch = pytest.importorskip("torch")

from assets import FETCH  # noqa: E402
from clutter_env.policies.high_level.candidates import CandidateRule  # noqa: E402
from clutter_env.policies.high_level.network import CandidateNetwork  # noqa: E402
from clutter_env.policies.high_level.policy import LearnedHighLevelPolicy  # noqa: E402
from clutter_env.policies.runs import DECISIONS_FILE  # noqa: E402
from clutter_env.scene.layout import find_layout  # noqa: E402
from clutter_env.task import Task  # noqa: E402
from clutter_env.training.high_level import accuracy, batch_of, fit_high_level  # noqa: E402
from clutter_env.training.high_level_examples import (  # noqa: E402
    CandidateExamples,
    examples_of_scene,
    label_picks,
    scene_of,
)
from clutter_env.training.high_level_rollouts import (  # noqa: E402
    after_contact,
    as_observed,
    roll_out,
    visited_examples,
    why_not_free,
)
from clutter_env.training.run import Run  # noqa: E402
from clutter_env.training.settings import DecisionsDAgger  # noqa: E402
from clutter_env.training.train import train  # noqa: E402
from planners import CollisionWorld  # noqa: E402

RULE = CandidateRule(FETCH, find_layout("paper"))
TASK = Task("clutter_env/Retrieve-o5-v0")


@pytest.fixture(scope="module")
def env() -> gym.Env[Any, Any]:
    return TASK.make()


@pytest.fixture(scope="module")
def examples(env: gym.Env[Any, Any]) -> CandidateExamples:
    parts = []
    for seed in range(3):
        env.reset(seed=seed)
        parts.append(examples_of_scene(scene_of(env), RULE, np.random.default_rng(seed)))
    return CandidateExamples.joined(parts)


@pytest.fixture(scope="module")
def network(examples: CandidateExamples) -> CandidateNetwork:
    return fit_high_level(examples, 60, network=CandidateNetwork(32), learning_rate=1e-2)


def test_a_label_does_not_depend_on_the_other_candidates(env: gym.Env[Any, Any]) -> None:
    env.reset(seed=3)
    scene = scene_of(env)
    world, picks = CollisionWorld.from_scene(scene), RULE.picks(scene.objects)
    some = picks.take(np.arange(0, len(picks), 20))
    together = label_picks(world, some)
    alone = [label_picks(world, some.take(slice(row, row + 1))) for row in range(len(some))]
    assert together.is_reached.tolist() == [label.is_reached[0] for label in alone]
    assert together.blockers.tolist() == [label.blockers[0] for label in alone]
    assert together.is_free.any()
    assert not together.is_free.all()


def test_a_placed_object_stands_where_the_candidate_says(env: gym.Env[Any, Any]) -> None:
    env.reset(seed=3)
    scene = scene_of(env)
    picks = RULE.picks(scene.objects)
    free = int(np.flatnonzero(label_picks(CollisionWorld.from_scene(scene), picks).is_free)[0])
    pick = picks.contact(free, "pick", scene.objects[picks.index[free]].name)
    holding = after_contact(scene, pick)
    assert holding.held is not None
    body, points = scene.body(pick.object), RULE.points()
    places = RULE.places(body, holding.held, points)
    for row in (0, len(places) // 2, len(places) - 1):
        placed = after_contact(holding, places.contact(row, "place", body.name)).body(body.name)
        assert np.allclose(placed.position[:2], points[places.index[row], :2])
        assert placed.bottom == pytest.approx(scene.support.top)


def test_neither_order_nor_absent_objects_matter(examples: CandidateExamples, network: CandidateNetwork) -> None:
    batch, order = batch_of(examples, np.arange(40)), torch.tensor([3, 0, 4, 1, 2])
    permuted = batch._replace(others=batch.others[:, order], is_present=batch.is_present[:, order])
    others = torch.where(batch.is_present[..., None], batch.others, torch.tensor(0.3))
    with torch.no_grad():
        one, other = network(batch), network(permuted)
        assert torch.equal(network(batch._replace(others=others)).blocks, one.blocks)
    assert torch.allclose(one.blocks[:, order], other.blocks, atol=1e-5)
    assert torch.equal(one.reach, other.reach)
    assert torch.equal(network.reach_logits(batch), network(batch).reach)


def test_mirroring_changes_the_sign_of_y_and_yaw(examples: CandidateExamples) -> None:
    rows = np.arange(9)
    one, mirrored = batch_of(examples, rows), batch_of(examples, rows, is_mirrored=True)
    assert torch.equal(mirrored.own[:, 1], -one.own[:, 1])
    assert torch.equal(mirrored.base[:, 1:], -one.base[:, 1:])
    assert torch.equal(mirrored.tcp[:, (0, 2, 4)], one.tcp[:, (0, 2, 4)])


def test_fitting_learns(examples: CandidateExamples, network: CandidateNetwork) -> None:
    untrained, trained = accuracy(CandidateNetwork(32), examples), accuracy(network, examples)
    reached = examples.is_reached
    pairs = batch_of(examples, reached.nonzero()[0]).is_present.numpy().sum()
    always_clear = 1 - examples.blockers[reached].sum() / pairs
    assert trained["blocks"] > max(untrained["blocks"], always_clear + 0.01)
    assert trained["reach"] > max(untrained["reach"], reached.mean())


def test_examples_survive_their_file(examples: CandidateExamples, tmp_path: Path) -> None:
    examples.save(tmp_path / "examples.npz")
    read = CandidateExamples.load(tmp_path / "examples.npz")
    assert np.array_equal(read.blockers, examples.blockers)


class _FirstFree:
    """Takes the target by the first candidate that is free by the planner's geometry."""

    def __init__(self, scene: Any) -> None:
        self._scene = scene

    def reset(self) -> None:
        """Nothing to forget."""

    def choose(self, scene: Any) -> Any:
        picks = RULE.picks(scene.bodies)
        rows = np.flatnonzero(picks.index == scene.target)
        contacts = (picks.contact(int(row), "pick", scene.bodies[scene.target].name) for row in rows)
        return next((one for one in contacts if not why_not_free(self._scene, one)), None)


def test_a_rollout_ends_with_the_target_taken_or_with_a_pick_that_is_not_free(env: gym.Env[Any, Any]) -> None:
    endings = set()
    for seed in range(3):
        _, info = env.reset(seed=seed)
        scene = scene_of(env)
        rollout = roll_out(_FirstFree(scene), scene, info["target"])
        assert rollout.clearances == 0
        assert len(rollout.scenes) == len(rollout.contacts) == (0 if rollout.failure == "gave up" else 1)
        endings.add(rollout.failure)
    assert "" in endings
    assert as_observed(scene, info["target"]).held is None


def test_the_states_that_the_learner_visits_are_labelled(env: gym.Env[Any, Any], network: CandidateNetwork) -> None:
    _, info = env.reset(seed=1)
    rollout = roll_out(LearnedHighLevelPolicy(network, RULE), scene_of(env), info["target"])
    examples = visited_examples([rollout], RULE, np.random.default_rng(0))
    assert examples is not None
    assert len(examples.objects) == len(rollout.contacts)
    assert visited_examples([], RULE, np.random.default_rng(0)) is None


def test_training_writes_a_policy_and_its_history(tmp_path: Path) -> None:
    settings = DecisionsDAgger(steps=40, scenes=2, rounds=1, round_episodes=1, evaluation_episodes=1)
    trained = train(Run(TASK, settings, tmp_path / "run"))
    assert [entry["round"] for entry in trained.history] == [0, 1]
    assert {"success", "clearances", "reach", "free"} <= set(trained.history[0])
    policy = LearnedHighLevelPolicy.load(tmp_path / "run" / DECISIONS_FILE)
    assert policy.info.layout == "paper"
