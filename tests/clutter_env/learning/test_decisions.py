"""Decisions without physics: their labels, their files, resuming."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest

from clutter_env.learning.demonstrations import decision_collect
from clutter_env.learning.demonstrations.decision_collect import Chunk, DecisionJob, collect_decisions, decide_chunk
from clutter_env.learning.demonstrations.decision_file import DECISION_COLUMNS, Decisions, read_decisions
from clutter_env.learning.demonstrations.decision_labels import object_rows
from clutter_env.learning.errors import CollectionError, DatasetError, LearningError
from clutter_env.learning.task import Task
from clutter_env.parallel import Crash
from planners.scene import Scene

TASK = Task("clutter_env/Retrieve-o10-v0", {"obstructed": True})
JOB = DecisionJob(TASK, "side", decisions=1)


class Here:
    """Plans chunks in this process; fails on those of `crashes`."""

    def __init__(self, crashes: tuple[int, ...] = ()) -> None:
        self.made: list[int] = []
        self.crashes = crashes

    def __call__(
        self, function: Callable[[int], Chunk], jobs: Iterable[int | None]
    ) -> Iterator[tuple[int, Chunk | Crash]]:
        for first in jobs:
            assert first is not None
            self.made.append(first)
            yield first, Crash("out of memory") if first in self.crashes else function(first)


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The decisions of two scenes, in two chunks."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(decision_collect, "SEEDS_PER_CHUNK", 1)
        path = tmp_path_factory.mktemp("decisions") / "d"
        first = collect_decisions(JOB, path, Here())
        again = Here()
        both = collect_decisions(DecisionJob(TASK, "side", first["decisions"] + 1), path, again)
        assert again.made == [1]
        assert both["decisions"] == first["decisions"] + both["made"]
    return path


@pytest.fixture(scope="module")
def decisions(directory: Path) -> Decisions:
    return read_decisions(directory)


def test_every_plan_ends_with_the_target_and_counts_its_clearances_down(decisions: Decisions) -> None:
    for seed in np.unique(decisions["seed"]):
        rows = np.flatnonzero(decisions["seed"] == seed)
        assert (decisions["number"][rows] == np.arange(len(rows))).all()
        assert (decisions["kind"][rows] == np.arange(len(rows)) % 2).all()
        assert decisions["subject"][rows[-1]] == decisions["target"][rows[-1]]
        assert decisions["clearances_left"][rows].tolist() == [(len(rows) - k) // 2 for k in range(len(rows))]


def test_what_is_held_is_what_is_put_down(decisions: Decisions) -> None:
    is_place = decisions["kind"] == 1
    assert is_place.any()
    assert (decisions["held"] == np.where(is_place, decisions["subject"], -1)).all()
    held = decisions["objects"][..., -1]
    assert (held.sum(axis=1) == is_place).all()
    assert (held.argmax(axis=1)[is_place] == decisions["subject"][is_place]).all()


def test_the_plans_choice_is_one_of_the_valid_labels(decisions: Decisions) -> None:
    for k in range(len(decisions)):
        if decisions["kind"][k]:
            assert not decisions["is_free"][k].any()
            assert decisions["cell_is_free"][k, decisions["cell"][k]] or not decisions["is_straight"][k]
            assert ((decisions["cell_direction"][k] >= 0) == decisions["cell_is_free"][k]).all()
            continue
        choice = decisions["subject"][k], decisions["family"][k], decisions["direction"][k]
        assert decisions["is_optimal"][k][choice]
        assert decisions["is_free"][k][choice] or not decisions["is_straight"][k]
        others = decisions["is_optimal"][k].copy()
        others[choice] = False
        assert not (others & ~decisions["is_free"][k]).any()
        assert not decisions["cell_is_free"][k].any()


def test_object_rows_are_those_of_the_observation() -> None:
    env = TASK.make(shapes="mixed")
    observation, info = env.reset(seed=7)
    own = env.unwrapped
    scene = Scene.from_mujoco(own.model, own.data, own.robot, movable=own.object_names, support=own.support_name)
    rows = object_rows(scene, info["target"], 10)
    np.testing.assert_allclose(rows.ravel(), observation["objects"], atol=1e-6)


def test_every_column_is_described_and_has_its_type(decisions: Decisions) -> None:
    for name, (kind, columns) in DECISION_COLUMNS.items():
        assert decisions[name].dtype == kind
        assert len(decisions[name]) == len(decisions)
        assert columns.about
        assert len(columns.names) == len(columns.units)
    assert decisions["cell_is_free"].shape[1] == len(decisions.cells)
    assert decisions["is_free"].shape[2:] == (len(decisions.pitches), 24)
    assert decisions["objects"].shape[2] == len(DECISION_COLUMNS["objects"][1].names)


def test_decisions_of_another_job_or_damaged_ones_are_refused(directory: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="grasps"):
        collect_decisions(DecisionJob(TASK, "all", 1), directory, Here())
    with pytest.raises(DatasetError, match="no decisions"):
        read_decisions(tmp_path)
    (tmp_path / "chunks").mkdir()
    (tmp_path / "chunks" / "scenes_0000000.npz").write_bytes(b"nothing")
    with pytest.raises(DatasetError, match="scenes_0000000"):
        read_decisions(tmp_path)
    with pytest.raises(DatasetError, match="other files"):
        collect_decisions(JOB, tmp_path, Here())


def test_a_worker_that_dies_ends_the_collection_with_its_seed(tmp_path: Path) -> None:
    with pytest.raises(CollectionError, match=r"seed 0 .*out of memory"):
        collect_decisions(JOB, tmp_path / "d", Here(crashes=(0,)))


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"decisions": 0}, "decisions=0"),
        ({"first_seed": 1_000_000}, "seed=1000000"),
        ({"task": Task("clutter_env/Pick-v0")}, "Pick"),
    ],
)
def test_misuse_is_named(wrong: dict[str, object], named: str) -> None:
    with pytest.raises(LearningError, match=named):
        DecisionJob(**{"task": TASK, "grasps": "side", "decisions": 1, **wrong})


def test_a_chunk_is_the_same_when_it_is_made_again(directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decision_collect, "SEEDS_PER_CHUNK", 1)
    content = decide_chunk(JOB, 0).content
    assert content == (directory / "chunks" / "scenes_0000000.npz").read_bytes()
