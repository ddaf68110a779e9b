"""Labels of skills, and the network that learns them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from clutter_env.policies.skill_network import ROUNDS, YAWS, SkillNetwork, clearances_without
from clutter_env.task import Task
from clutter_env.training.skills import (
    LabelledScenes,
    SkillExamples,
    clearances_left,
    collect_scenes,
    fit_skills,
    grasp_obstacles,
    skill_labels,
)
from planners import DIRECTIONS, SkillPlanner

OBSTRUCTED = Task("clutter_env/Skill-o10-v0", {"simulation": "kinematic", "obstructed": True})
OBJECTS = "abcdet"


def masks(*words: str) -> set[int]:
    """Masks of what is in the way of the grasps of an object, given as letters of `OBJECTS`."""
    return {sum(1 << OBJECTS.index(letter) for letter in word) for word in words}


CHAINS = [
    ([masks(""), masks(""), masks("d"), masks("e"), masks(""), masks("ab", "c")], 2, "ab"),
    ([masks(""), masks(""), masks("d"), masks(""), masks(""), masks("c")], 2, "d"),
    ([masks("b"), masks("a"), masks(""), masks(""), masks(""), masks("a")], -1, ""),
    ([masks("t"), masks(""), masks(""), masks(""), masks(""), masks("a", "b")], 1, "b"),
    ([masks(""), masks(""), masks(""), masks(""), masks(""), masks("abc", "")], 0, ""),
]


@pytest.mark.parametrize(("in_the_way", "count", "first"), CHAINS)
def test_search_and_network_count_the_fewest_clearances(in_the_way: list[set[int]], count: int, first: str) -> None:
    size, target = len(OBJECTS), OBJECTS.index("t")
    assert clearances_left(in_the_way, target) == (count, next(iter(masks(first))))
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
    return collect_scenes(OBSTRUCTED.make(), range(3), np.random.default_rng(0))


@pytest.fixture(scope="module")
def examples(scenes: LabelledScenes) -> SkillExamples:
    return SkillExamples.of(scenes)


def test_good_skills_are_free_and_bring_the_target_nearer() -> None:
    env: Any = OBSTRUCTED.make().unwrapped
    for seed in range(1):
        env.reset(seed=seed)
        planner, target = SkillPlanner.of(env.scene), env.scene.names.index(env.target)
        before = skill_labels(*grasp_obstacles(planner, env.scene), target)
        needed = before.clearances
        assert needed >= 1
        assert np.array_equal(before.is_free, env.action_masks(geometric=True))
        is_over = False
        while not is_over:
            _, _, is_over, _, info = env.step(int(np.flatnonzero(before.is_good)[0]))
            assert not info["failure"]
            if not is_over:
                after = skill_labels(*grasp_obstacles(planner, env.scene), target)
                assert after.clearances < before.clearances
                before = after
        assert info["is_success"]
        assert len(info["moved"]) == needed


def test_examples_have_a_good_skill(scenes: LabelledScenes, examples: SkillExamples, tmp_path: Path) -> None:
    assert examples.is_good.any(axis=1).all()
    assert not (examples.is_good & ~examples.is_free).any()
    assert np.array_equal(examples.is_good[:, -1], examples.clearances == 0)
    clears = examples.is_free[:, :-1].reshape(len(examples), -1, DIRECTIONS)
    rows = np.arange(len(examples))
    assert not clears[rows, examples.target].any()
    assert np.array_equal(examples.bodies(rows)[..., 1].argmax(axis=1), examples.target)
    LabelledScenes.kept(tmp_path / "new" / "scenes.npz", lambda: scenes)
    again = LabelledScenes.kept(tmp_path / "new" / "scenes.npz", lambda: pytest.fail("collected anew"))
    assert np.array_equal(again.masks, scenes.masks)
    assert np.array_equal(LabelledScenes.joined((again, scenes)).masks[len(scenes.masks) :], scenes.masks)


def test_the_order_of_the_objects_does_not_matter(scenes: LabelledScenes) -> None:
    torch.manual_seed(0)
    network, order = SkillNetwork(10), torch.randperm(10)
    rows = torch.cat((torch.from_numpy(scenes.bodies), torch.rand(3, 10, DIRECTIONS).round()), dim=2)
    rest = torch.tensor([[0.5, 1.0]]).expand(3, 2)
    logits = network(torch.cat((rows.flatten(1), rest), dim=1))[0]
    permuted = network(torch.cat((rows[:, order].flatten(1), rest), dim=1))[0]
    clears = logits[:, :-1].reshape(3, 10, DIRECTIONS)[:, order]
    torch.testing.assert_close(permuted[:, :-1], clears.flatten(1), rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(permuted[:, -1], logits[:, -1], rtol=1e-4, atol=1e-5)


@pytest.mark.slow
def test_the_network_learns_its_examples(examples: SkillExamples) -> None:
    losses: list[float] = []
    fit_skills(SkillNetwork(10), examples, steps=101, report=lambda _, loss: losses.append(loss))
    assert losses[-1] < 0.7 * losses[0]
