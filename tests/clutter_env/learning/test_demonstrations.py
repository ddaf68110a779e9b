"""Recording, storing, replaying, collecting, resuming."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from clutter_env.learning.comparison.evaluation import play_scene
from clutter_env.learning.comparison.scene_sets import SeededScene
from clutter_env.learning.comparison.suite_policies import load_policy
from clutter_env.learning.demonstrations.collect import Outcome, collect
from clutter_env.learning.demonstrations.dataset import Dataset, Job
from clutter_env.learning.demonstrations.episode import Episode, record, replay
from clutter_env.learning.demonstrations.experts import expert_names, make_expert
from clutter_env.learning.demonstrations.step_labels import StepLabels
from clutter_env.learning.errors import CollectionError, DatasetError, UnknownExpert
from clutter_env.learning.task import Task
from clutter_env.parallel import Crash, Killed, run_jobs

pytest.importorskip("h5py")
from clutter_env.learning.demonstrations.episode_file import read_episode, write_episode
from clutter_env.learning.exports.minari import export_minari

PICK = Task("clutter_env/Pick-v0")


@pytest.fixture(scope="module")
def episode() -> Episode:
    env = PICK.make()
    return record(PICK, env, make_expert(env), seed=3)


class Here:
    """Runs jobs in this process, `count` of them at a time, the last one first; seeds in `deaths` die so often."""

    def __init__(self, count: int = 2, deaths: dict[int, int] | None = None, end: Crash | Killed | None = None) -> None:
        self.count, self.deaths = count, dict(deaths or {})
        self.end = end or Crash("the process ended with exit code -9")

    def __call__(self, _: object, jobs: Iterable[int | None]) -> Iterator[tuple[int, Outcome | Crash | Killed]]:
        waiting, running = iter(jobs), []
        while True:
            while len(running) < self.count and (seed := next(waiting, None)) is not None:
                running.append(seed)
            if not running:
                return
            seed = running.pop()
            if self.deaths.get(seed, 0) > 0:
                self.deaths[seed] -= 1
                yield seed, self.end
            else:
                yield seed, outcome_of(seed)


def outcome_of(seed: int) -> Outcome:
    """Every third seed fails."""
    return Outcome(seed, reason="no success: blocked") if seed % 3 == 1 else Outcome(seed, content=b"episode")


def test_the_script_retrieves() -> None:
    env = Task("clutter_env/Retrieve-o1-v0", {"control_mode": "ee"}).make()
    assert play_scene(SeededScene("clutter_env/Retrieve-o1-v0", {}, 0), env, load_policy("scripted", 0)).clean
    with pytest.raises(UnknownExpert, match="ee"):
        make_expert(Task("clutter_env/Retrieve-o1-v0").make(), "scripted")
    with pytest.raises(UnknownExpert, match="Retrieve"):
        make_expert(Task("clutter_env/Skill-o5-v0").make())


def test_the_script_succeeds_and_its_episode_replays(episode: Episode) -> None:
    assert episode.succeeded
    result = replay(episode)
    assert result.is_identical
    assert result.is_success


def test_a_changed_action_does_not_replay(episode: Episode) -> None:
    actions = episode.actions.copy()
    actions[10] = -actions[10] + 0.01
    result = replay(dataclasses.replace(episode, actions=actions))
    assert not result.is_identical
    assert result.first_difference == 11


def test_an_episode_survives_its_file(episode: Episode, tmp_path: Path) -> None:
    write_episode(tmp_path / "e.hdf5", episode)
    back = read_episode(tmp_path / "e.hdf5")
    for field in dataclasses.fields(Episode):
        before, after = getattr(episode, field.name), getattr(back, field.name)
        if isinstance(before, np.ndarray):
            assert before.dtype == after.dtype
            assert before.tobytes() == after.tobytes()
        elif field.name == "observations":
            assert all(before[name].tobytes() == after[name].tobytes() for name in before)
        elif field.name == "labels":
            assert_same_labels(before, after)
        else:
            assert before == after


def assert_same_labels(before: StepLabels, after: StepLabels) -> None:
    assert before.phases == after.phases
    for field in dataclasses.fields(StepLabels)[1:]:
        np.testing.assert_array_equal(getattr(before, field.name), getattr(after, field.name))


def test_what_is_no_episode_is_refused(tmp_path: Path) -> None:
    (tmp_path / "e.hdf5").write_text("nothing")
    with pytest.raises(DatasetError, match=r"e\.hdf5"):
        read_episode(tmp_path / "e.hdf5")


def test_an_unknown_expert_is_refused() -> None:
    with pytest.raises(UnknownExpert, match="pick"):
        make_expert(PICK.make(), "nobody")
    assert "lookahead" in expert_names("clutter_env/Retrieve-o15-v0")


@pytest.mark.parametrize("count", [1, 2, 5])
def test_the_dataset_is_the_first_seeds_that_succeed(tmp_path: Path, count: int) -> None:
    job = Job(PICK, "pick", episodes=5)
    dataset = Dataset.open_for(job, tmp_path / "d")
    assert collect(job, dataset, Here(count)) == [0, 2, 3, 5, 6] == dataset.seeds
    assert sorted(dataset.reasons()) == [1, 4]


def test_an_interrupted_collection_goes_on(tmp_path: Path) -> None:
    job = Job(PICK, "pick", episodes=5)
    dataset = Dataset.open_for(job, tmp_path / "d")
    made: list[int] = []

    def stop(outcome: Outcome) -> None:
        made.append(outcome.seed)
        if len(made) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        collect(job, dataset, Here(), stop)
    collect(job, Dataset.open_for(job, tmp_path / "d"), Here(), lambda outcome: made.append(outcome.seed))
    assert sorted(made) == [0, 1, 2, 3, 4, 5, 6]
    assert dataset.seeds == [0, 2, 3, 5, 6]


def test_a_dead_worker_is_forgiven_thrice_at_most(tmp_path: Path) -> None:
    job = Job(PICK, "pick", episodes=3)
    dataset = Dataset.open_for(job, tmp_path / "d")
    assert collect(job, dataset, Here(deaths={0: 2})) == [0, 2, 3]
    with pytest.raises(CollectionError, match="seed 0 ended 3 times"):
        collect(job, Dataset.open_for(job, tmp_path / "e"), Here(deaths={0: 3}))


def test_no_room_in_a_worker_ends_the_collection_at_once(tmp_path: Path) -> None:
    job = Job(PICK, "pick", episodes=3)
    full = Crash("Traceback ...\nOSError: [Errno 28] No space left on device", is_final=True)
    with pytest.raises(CollectionError, match=r"seed 1 .*No space left on device"):
        collect(job, Dataset.open_for(job, tmp_path / "d"), Here(deaths={1: 1}, end=full))


def test_a_full_disk_says_so_and_leaves_nothing_half_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    job = Job(PICK, "pick", episodes=3)
    dataset = Dataset.open_for(job, tmp_path / "d")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(CollectionError, match="No space left"):
        collect(job, dataset, Here())
    assert list(dataset.episodes_directory.iterdir()) == []


def test_another_job_s_directory_is_refused(tmp_path: Path) -> None:
    Dataset.open_for(Job(PICK, "pick", episodes=3), tmp_path / "d")
    Dataset.open_for(Job(PICK, "pick", episodes=9), tmp_path / "d")
    with pytest.raises(DatasetError, match="first_seed"):
        Dataset.open_for(Job(PICK, "pick", episodes=3, first_seed=7), tmp_path / "d")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").touch()
    with pytest.raises(DatasetError, match="other files"):
        Dataset.open_for(Job(PICK, "pick", episodes=3), tmp_path / "other")


def test_two_collections_do_not_share_a_directory(tmp_path: Path) -> None:
    dataset = Dataset.open_for(Job(PICK, "pick", episodes=3), tmp_path / "d")
    with dataset.locked(), pytest.raises(DatasetError, match="another process"), dataset.locked():
        pass


def test_collect_and_export_with_processes(tmp_path: Path) -> None:
    job = Job(PICK, "pick", episodes=2)
    dataset = Dataset.open_for(job, tmp_path / "d")
    seeds = collect(job, dataset, partial(run_jobs, workers=2))
    assert [episode.seed for episode in dataset] == seeds
    folder = export_minari(dataset, tmp_path / "minari", "clutter_env/pick-v0")
    with pytest.raises(DatasetError, match="exists"):
        export_minari(dataset, tmp_path / "minari", "clutter_env/pick-v0")
    assert json.loads((folder / "data" / "metadata.json").read_text())["total_episodes"] == 2
    minari = pytest.importorskip("minari")
    loaded = minari.MinariDataset(str(folder / "data"))
    for theirs, ours in zip(loaded.iterate_episodes(), dataset, strict=True):
        assert np.array_equal(theirs.actions, ours.actions)
        assert np.array_equal(theirs.observations["observation"], ours.observations["observation"])
        assert np.array_equal(theirs.infos["state"], ours.states)
