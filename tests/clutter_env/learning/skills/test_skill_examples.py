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
from clutter_env.policies.skill_network import ROUNDS, clearances_without  # noqa: E402
from clutter_env.training.skill_examples import SkillExamples  # noqa: E402
from clutter_env.learning.training.bc import examples_of  # noqa: E402
from clutter_env.learning.skills.fitting import FitConfig, fit  # noqa: E402
from clutter_env.training.skill_fit import choices_are_good  # noqa: E402
from clutter_env.training.skill_examples import clearances_left, skill_labels  # noqa: E402
from clutter_env.policies.skill_network import SkillNetwork  # noqa: E402
from clutter_env.learning.skills.obstacles import YAWS  # noqa: E402
from clutter_env.training.skill_examples import grasp_obstacles  # noqa: E402
from clutter_env.training.skill_examples import LabelledScenes, collect_scenes  # noqa: E402
from clutter_env.learning.task import Task  # noqa: E402
from clutter_env.learning.training.run import Run  # noqa: E402
from clutter_env.learning.training.training import train  # noqa: E402
from planners.skills.geometry import DIRECTIONS, skill_geometry  # noqa: E402

OBSTRUCTED = Task("clutter_env/Skill-o10-v0", {"simulation": "kinematic", "obstructed": True})
OBJECTS = "abcdet"


def masks(*words: str) -> set[int]:
    """What is in the way of the grasps of an object, as letters of `OBJECTS`."""
    return {sum(1 << OBJECTS.index(letter) for letter in word) for word in words}


CHAINS = [
    ([masks(""), masks(""), masks("d"), masks("e"), masks(""), masks("ab", "c")], 2, "ab"),
    ([masks(""), masks(""), masks("d"), masks(""), masks(""), masks("c")], 2, "d"),
    ([masks("b"), masks("a"), masks(""), masks(""), masks(""), masks("a")], -1, ""),
    ([masks("t"), masks(""), masks(""), masks(""), masks(""), masks("a", "b")], 1, "b"),
    ([masks(""), masks(""), masks(""), masks(""), masks(""), masks("abc", "")], 0, ""),
]


@pytest.mark.parametrize(("in_the_way", "count", "first"), CHAINS)
def test_clearances_are_the_fewest(in_the_way: list[set[int]], count: int, first: str) -> None:
    assert clearances_left(in_the_way, OBJECTS.index("t")) == (count, next(iter(masks(first))))
    if count > 0:
        assert clearances_left(in_the_way, OBJECTS.index("t"), most=count - 1) == (-1, 0)


@pytest.mark.parametrize(("in_the_way", "count", "first"), CHAINS)
def test_sums_and_minima_count_the_same_clearances(in_the_way: list[set[int]], count: int, first: str) -> None:
    size, target = len(OBJECTS), OBJECTS.index("t")
    blocks, unreachable = torch.zeros(1, size, YAWS, size), torch.ones(1, size, YAWS)
    for i, grasps in enumerate(in_the_way):
        for yaw, mask in enumerate(sorted(grasps)):
            blocks[0, i, yaw] = torch.tensor([float(mask >> j & 1) for j in range(size)])
            unreachable[0, i, yaw] = 0
    is_target = torch.tensor([[float(i == target) for i in range(size)]])
    needed = clearances_without(blocks, unreachable, is_target)[0, target]
    assert needed[-1].item() == pytest.approx(ROUNDS if count < 0 else count, abs=0.1)
    for name in first:
        assert needed[OBJECTS.index(name)].item() == pytest.approx(count - 1, abs=0.1)


@pytest.fixture(scope="module")
def scenes() -> LabelledScenes:
    env = OBSTRUCTED.make()
    found = collect_scenes(env, range(6), np.random.default_rng(0))
    env.close()
    return found


@pytest.fixture(scope="module")
def examples(scenes: LabelledScenes) -> SkillExamples:
    return examples_of(scenes)


def test_good_skills_are_free_and_bring_the_target_nearer() -> None:
    env: Any = OBSTRUCTED.make().unwrapped
    for seed in range(3):
        env.reset(seed=seed)
        geometry, target = skill_geometry(env.scene), env.scene.names.index(env.target)
        before = skill_labels(grasp_obstacles(geometry, env.scene), target)
        needed = before.clearances
        assert needed >= 1
        assert np.array_equal(before.is_free, env.action_masks(geometric=True))
        is_over = False
        while not is_over:
            _, _, is_over, _, info = env.step(int(np.flatnonzero(before.is_good)[0]))
            assert not info["failure"]
            if not is_over:
                after = skill_labels(grasp_obstacles(geometry, env.scene), target)
                assert after.clearances < before.clearances
                before = after
        assert info["is_success"]
        assert len(info["moved"]) == needed


def test_examples_have_a_good_skill(scenes: LabelledScenes, examples: SkillExamples, tmp_path: Path) -> None:
    assert examples.is_good.any(axis=1).all()
    assert not (examples.is_good & ~examples.is_free).any()
    assert np.array_equal(examples.is_good[:, -1], examples.clearances == 0)
    clears = examples.is_free[:, :-1].reshape(len(examples), -1, DIRECTIONS)
    assert not clears[np.arange(len(examples)), examples.target].any()
    rows = np.arange(len(examples))
    assert np.array_equal(examples.bodies(rows)[..., 1].argmax(axis=1), examples.target)
    scenes.save(tmp_path / "scenes.npz")
    again = LabelledScenes.load(tmp_path / "scenes.npz")
    assert np.array_equal(again.masks, scenes.masks)
    assert len(LabelledScenes.joined((again, scenes))) == 2 * len(scenes)


def test_the_order_of_the_objects_does_not_matter(scenes: LabelledScenes) -> None:
    torch.manual_seed(0)
    network, order = SkillNetwork(10), torch.randperm(10)
    rows = torch.cat((torch.from_numpy(scenes.bodies), torch.rand(len(scenes), 10, DIRECTIONS).round()), dim=2)
    rest = torch.tensor([[0.5, 1.0]]).expand(len(scenes), 2)
    logits = network.scores(torch.cat((rows.flatten(1), rest), dim=1)).logits
    permuted = network.scores(torch.cat((rows[:, order].flatten(1), rest), dim=1)).logits
    clears = logits[:, :-1].reshape(len(scenes), 10, DIRECTIONS)[:, order]
    torch.testing.assert_close(permuted[:, :-1], clears.flatten(1), rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(permuted[:, -1], logits[:, -1], rtol=1e-4, atol=1e-5)


def test_the_network_learns_its_examples(examples: SkillExamples) -> None:
    torch.manual_seed(0)
    network = SkillNetwork(10)
    before = choices_are_good(network, examples).mean()
    fit(network, examples, FitConfig(steps=300, scenes=6, learning_rate=4e-3))
    assert choices_are_good(network, examples).mean() > max(0.85, before)


def test_a_clone_of_skills_is_improved_and_resumes(tmp_path: Path) -> None:
    task = Task("clutter_env/Skill-o5-v0", {"simulation": "kinematic", "obstructed": True})
    run = Run(task, "maskable_ppo", 1024, tmp_path / "run", episodes=2, imitation_steps=5, evaluation_episodes=1)
    history = train(run).history
    assert [entry["steps"] for entry in history] == [0]
    assert history[0].keys() == {"steps", "success", "validation"}
    train(run, resume=True)
    env = task.make()
    assert play(env, load_agent(tmp_path / "run", env), held_out_seeds(1)[0]).steps > 0
