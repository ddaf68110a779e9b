"""Labels of skills, and the network that learns them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("sb3_contrib")

from clutter_env.learning.comparison.evaluation import held_out_seeds, play  # noqa: E402
from clutter_env.learning.policies.agents import load_agent  # noqa: E402
from clutter_env.learning.skills.examples import SkillExamples, collect_skills  # noqa: E402
from clutter_env.learning.skills.fitting import FitConfig, accuracy, fit, mirrored  # noqa: E402
from clutter_env.learning.skills.labels import clearances_left, skill_labels  # noqa: E402
from clutter_env.learning.skills.network import SkillNetwork  # noqa: E402
from clutter_env.learning.task import Task  # noqa: E402
from clutter_env.learning.training.run import Run  # noqa: E402
from clutter_env.learning.training.training import train  # noqa: E402
from planners.skills.geometry import DIRECTIONS, skill_geometry  # noqa: E402

OBSTRUCTED = Task("clutter_env/Skill-o10-v0", {"simulation": "kinematic", "obstructed": True})


def sets(*words: str) -> list[frozenset[str]]:
    return [frozenset(word) for word in words]


def test_clearances_are_the_fewest() -> None:
    in_the_way = {"t": sets("ab", "c"), "a": sets(""), "b": sets(""), "c": sets("d"), "d": sets("e"), "e": sets("")}
    assert clearances_left(in_the_way, "t") == 2
    assert clearances_left(in_the_way, "t", cleared={"a"}) == 1
    assert clearances_left(in_the_way, "t", cleared={"e"}) == 2
    assert clearances_left(in_the_way, "t", most=1) == -1
    assert clearances_left({"t": sets("")}, "t") == 0
    assert clearances_left({"t": sets("a"), "a": sets("b"), "b": sets("a")}, "t") == -1


@pytest.fixture(scope="module")
def examples() -> SkillExamples:
    env = OBSTRUCTED.make()
    found = collect_skills(env, range(6), np.random.default_rng(0))
    env.close()
    return found


def test_good_skills_are_free_and_bring_the_target_nearer() -> None:
    env: Any = OBSTRUCTED.make().unwrapped
    for seed in range(3):
        env.reset(seed=seed)
        geometry = skill_geometry(env.scene)
        left = skill_labels(geometry, env.scene, env.target)
        assert left.clearances >= 1
        assert left.is_good.any()
        geometric = env.action_masks(geometric=True)
        assert np.array_equal(left.is_free[left.is_known], geometric[left.is_known] & left.is_known[left.is_known])
        is_over = False
        while not is_over:
            before = skill_labels(geometry, env.scene, env.target)
            _, _, is_over, _, info = env.step(int(np.flatnonzero(before.is_good)[0]))
            assert not info["failure"]
            if not is_over:
                assert skill_labels(geometry, env.scene, env.target).clearances < before.clearances
        assert info["is_success"]
        assert len(info["moved"]) == left.clearances


def test_examples_have_a_good_skill_that_is_worth_trying(examples: SkillExamples, tmp_path: Path) -> None:
    assert (examples.is_good & examples.mask).any(axis=1).all()
    assert not (examples.is_good & ~examples.is_free).any()
    assert not (examples.is_free & ~examples.is_known).any()
    assert np.array_equal(examples.is_good[:, -1], examples.clearances == 0)
    examples.save(tmp_path / "examples.npz")
    again = SkillExamples.load(tmp_path / "examples.npz")
    assert np.array_equal(again.observation, examples.observation)
    assert len(SkillExamples.joined((again, examples))) == 2 * len(examples)


def test_a_mirrored_state_mirrored_is_the_state(examples: SkillExamples) -> None:
    parts = [torch.from_numpy(part) for part in (examples.observation, examples.mask, examples.is_good)]
    once = mirrored(*parts)
    assert not torch.equal(once[0], parts[0])
    assert all(torch.equal(one, other) for one, other in zip(mirrored(*once), parts, strict=True))
    clears = once[2][:, :-1].reshape(len(examples), -1, DIRECTIONS)
    assert torch.equal(clears[..., 1], parts[2][:, :-1].reshape(len(examples), -1, DIRECTIONS)[..., -1])


def test_the_network_learns_its_examples(examples: SkillExamples) -> None:
    torch.manual_seed(0)
    network = SkillNetwork(10)
    before = accuracy(network, examples)
    fit(network, examples, FitConfig(steps=300, batch=len(examples), learning_rate=4e-3))
    assert accuracy(network, examples) > max(0.8, before)


def test_a_clone_of_skills_is_improved_and_resumes(tmp_path: Path) -> None:
    task = Task("clutter_env/Skill-o5-v0", {"simulation": "kinematic", "obstructed": True})
    run = Run(task, "maskable_ppo", 1024, tmp_path / "run", episodes=2, imitation_steps=5, evaluation_episodes=1)
    history = train(run).history
    assert [entry["steps"] for entry in history] == [0]
    assert history[0].keys() == {"steps", "success", "validation"}
    train(run, resume=True)
    env = task.make()
    assert play(env, load_agent(tmp_path / "run", env), held_out_seeds(1)[0]).steps > 0
