"""Training of the end-to-end policy: its examples, and that a few steps of it give a policy that plays."""

from __future__ import annotations

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from clutter_env.errors import LearningError
from clutter_env.policies.protocol import PolicyError, PublicInfo
from clutter_env.policies.registry import load_policy, policy_files
from clutter_env.training.end_to_end import examples as examples_module
from clutter_env.training.end_to_end.examples import Examples, examples_of_plans
from clutter_env.training.end_to_end.fit import Steps, recoveries
from clutter_env.training.end_to_end.right_choices import right_objects
from clutter_env.training.end_to_end.train import train_end_to_end


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with the examples of two plans."""
    directory = tmp_path_factory.mktemp("run")
    examples_of_plans(directory / "plans", 2)
    return directory


def test_every_object_that_begins_a_shortest_sequence_is_right() -> None:
    free, a, b, c = [0], [0b0010], [0b0100], [0b1000]
    assert right_objects([free, free], 0) == (frozenset({0}), 0)
    assert right_objects([a, free], 0) == (frozenset({1}), 1)
    assert right_objects([[0b0110], free, free, free], 0) == (frozenset({1, 2}), 2)  # either first
    assert right_objects([a, b, c, free], 0) == (frozenset({3}), 3)
    assert right_objects([[0b0110, 0b1000], free, free, free], 0) == (frozenset({3}), 1)  # the way with fewer
    assert right_objects([a, [0b0001]], 0) == (frozenset(), -1)  # each in the way of the other
    assert right_objects([[], free], 0) == (frozenset(), -1)


def test_examples_are_consistent_and_survive_their_file(directory: Path) -> None:
    examples = examples_of_plans(directory / "plans", 2)
    picks, keyframes = examples.picks, examples.keyframes
    each = np.arange(len(picks.seed))
    assert picks.is_right[each, picks.index].all()
    exact = picks.direction >= 0
    assert picks.is_reached[each, picks.index, picks.direction][exact].all()
    itself = picks.blockers >> np.arange(picks.blockers.shape[1], dtype=np.uint64)[:, None] & np.uint64(1)
    assert not itself.any()  # no object is in its own way
    assert len(examples.places.seed) == len(picks.seed) - len(set(picks.seed))  # the last pick is the target's
    assert np.isfinite(keyframes.keyframe).all()
    picked, placed = keyframes.keyframe[~keyframes.is_place], keyframes.keyframe[keyframes.is_place]
    assert np.abs(picked[:, 3:5]).max(axis=1).min() < 1e-3  # at contacts the gripper is at the anchor
    assert len(placed)
    (directory / "other").mkdir()
    examples.save(directory / "other" / "plans-0000.npz")
    again = Examples.load(directory / "other" / "plans-0000.npz")
    for name in ("picks", "places", "place_labels", "keyframes"):
        for key, value in vars(getattr(examples, name)).items():
            np.testing.assert_array_equal(getattr(getattr(again, name), key), value)


def test_rules_after_failures_contradict_no_other() -> None:
    known: dict[tuple[int, ...], int] = {}
    for *situation, after in recoveries().tolist():
        assert known.setdefault(tuple(situation), after) == after


def test_a_short_training_gives_a_policy_and_keeps_its_examples(directory: Path) -> None:
    (file,) = (directory / "plans").iterdir()
    made = file.stat().st_mtime_ns
    told: list[str] = []
    weights = train_end_to_end(directory, 2, 0, told.append, Steps(2, 2, 2, 2))
    assert file.stat().st_mtime_ns == made
    assert [line.split(":")[0] for line in told[1:5]] == ["tables", "pointer", "places", "keyframes"]
    name = f"end-to-end:{weights}"
    assert list(policy_files(name)) == ["weights.npz"]
    policy = load_policy(name, 0)
    env = gym.make("clutter_env/Retrieve-o5-v0")
    observation, info = env.reset(seed=0)
    policy.check(PublicInfo.of(env))  # type: ignore[union-attr]  # an EndToEndPolicy
    policy.reset(info)  # type: ignore[call-arg]  # not a privileged one
    for _ in range(3):
        observation, *_ = env.step(policy.act(observation))
    with pytest.raises(LearningError, match="at least 1"):
        train_end_to_end(directory, 0)


def test_plans_of_another_seed_or_number_are_not_taken_for_those_that_are_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = list[tuple[int, int]]()

    def planned(seeds: range, wanted: int) -> Examples:
        asked.append((seeds.start, wanted))
        raise LearningError("asked")

    monkeypatch.setattr(examples_module, "_plans", planned)
    for plans, seed in ((6, 0), (40, 0), (6, 3)):
        with pytest.raises(LearningError, match="asked"):
            examples_of_plans(tmp_path, plans, seed)
    (tmp_path / f"plans-{asked[0][0]}-6.npz").write_bytes(b"PK damaged")
    with pytest.raises(PolicyError, match="damaged"):
        examples_of_plans(tmp_path, 6, 0)
    assert len(set(asked)) == 3
    with pytest.raises(LearningError, match="seed=-1"):
        train_end_to_end(tmp_path, 1, -1)
