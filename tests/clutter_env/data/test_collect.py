"""Collection: which seeds become the dataset, and what interruptions, deaths and full disks leave."""

from __future__ import annotations

import dataclasses
import json
import logging
import os
import signal
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest

from clutter_env.data import collect as collecting
from clutter_env.data.collect import SeedResult, collect, demonstrate, make_job
from clutter_env.data.dataset import Dataset, Job
from clutter_env.data.episode import Episode
from clutter_env.errors import CollectionError, DatasetError, LearningError, UnknownExpert
from clutter_env.parallel import Crash, Killed, run_jobs
from clutter_env.policies.experts import expert_names
from clutter_env.task import Task

PICK = Task("clutter_env/Pick-v0")
JOB = Job(PICK, "pick", episodes=5)


class Here:
    """Runs jobs in this process, `count` of them at a time, the last one first; seeds in `deaths` die so often.

    Every third seed fails.
    """

    def __init__(self, count: int = 2, deaths: dict[int, int] | None = None, end: Crash | Killed | None = None) -> None:
        self.count, self.deaths = count, dict(deaths or {})
        self.end = end or Crash("the process ended with exit code -9")

    def __call__(self, _: object, jobs: Iterable[int | None]) -> Iterator[tuple[int, SeedResult | Crash | Killed]]:
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
            elif seed % 3 == 1:
                yield seed, SeedResult(seed, reason="no success: blocked")
            else:
                yield seed, SeedResult(seed, content=b"episode")


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    return Dataset.open_for(JOB, tmp_path / "d")


@pytest.mark.parametrize("count", [1, 2, 5])
def test_the_dataset_is_the_first_seeds_that_succeed(dataset: Dataset, count: int) -> None:
    assert collect(JOB, dataset, Here(count)) == [0, 2, 3, 5, 6] == dataset.seeds
    assert sorted(dataset.reasons()) == [1, 4]


def test_an_interrupted_collection_goes_on(dataset: Dataset) -> None:
    made: list[int] = []

    def stop(result: SeedResult) -> None:
        made.append(result.seed)
        if len(made) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        collect(JOB, dataset, Here(), stop)
    collect(JOB, Dataset.open_for(JOB, dataset.directory), Here(), lambda result: made.append(result.seed))
    assert sorted(made) == [0, 1, 2, 3, 4, 5, 6]
    assert dataset.seeds == [0, 2, 3, 5, 6]


def test_a_dead_worker_is_forgiven_twice(dataset: Dataset, tmp_path: Path) -> None:
    assert collect(JOB, dataset, Here(deaths={0: 2})) == [0, 2, 3, 5, 6]
    with pytest.raises(CollectionError, match="seed 0 ended 3 times"):
        collect(JOB, Dataset.open_for(JOB, tmp_path / "e"), Here(deaths={0: 3}))
    # No space in a worker ends the collection at once.
    full = Crash("Traceback ...\nOSError: [Errno 28] No space left on device", is_final=True)
    with pytest.raises(CollectionError, match=r"seed 1 .*No space left on device"):
        collect(JOB, Dataset.open_for(JOB, tmp_path / "f"), Here(deaths={1: 1}, end=full))


def test_a_full_disk_says_so_and_leaves_nothing_half_written(dataset: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(CollectionError, match="No space left"):
        collect(JOB, dataset, Here())
    assert list(dataset.episodes_directory.iterdir()) == []


def test_the_directory_of_another_job_or_process_is_refused(dataset: Dataset, tmp_path: Path) -> None:
    Dataset.open_for(dataclasses.replace(JOB, episodes=9), dataset.directory)
    with pytest.raises(DatasetError, match="first_seed"):
        Dataset.open_for(dataclasses.replace(JOB, first_seed=7), dataset.directory)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").touch()
    with pytest.raises(DatasetError, match="other files"):
        Dataset.open_for(JOB, tmp_path / "other")
    with dataset.locked(), pytest.raises(DatasetError, match="another process"), dataset.locked():
        pass


def test_a_changed_environment_is_named_and_its_episodes_are_not_mixed_with_old_ones(
    dataset: Dataset, caplog: pytest.LogCaptureFixture
) -> None:
    described = dataset.directory / "dataset.json"
    content = json.loads(described.read_text())
    assert content["provenance"]["version"]
    assert dataset.warn_if_outdated() == []
    content["provenance"]["environment"]["reward"] = "0" * 16
    described.write_text(json.dumps(content))
    with pytest.raises(DatasetError, match="The environment's reward has changed"):
        Dataset.open_for(JOB, dataset.directory)
    with caplog.at_level(logging.WARNING):
        assert len(dataset.warn_if_outdated()) == 1
    assert "The environment's reward has changed" in caplog.text
    del content["provenance"]  # version 0.1
    described.write_text(json.dumps(content))
    assert "version 0.1" in dataset.warn_if_outdated()[0]


@pytest.mark.parametrize("content", ["", "[]", "{", '{"seeds": 3}', '{"seeds": ["a"]}'])
def test_a_damaged_index_or_description_is_a_plain_error(dataset: Dataset, content: str) -> None:
    (dataset.directory / "index.json").write_text(content)
    with pytest.raises(DatasetError, match=r"index\.json"):
        list(dataset)
    (dataset.directory / "dataset.json").write_text(content)
    with pytest.raises(DatasetError, match=r"dataset\.json"):
        assert dataset.task


def test_only_clean_successes_are_demonstrations(pick_episode: Episode, monkeypatch: pytest.MonkeyPatch) -> None:
    disturbed = dataclasses.replace(pick_episode, num_disturbed=pick_episode.num_disturbed + 1)
    monkeypatch.setattr(collecting, "record", lambda *_: disturbed)
    result = demonstrate(JOB, 0)
    assert result.reason.startswith("not clean")
    assert not result.content


def test_what_cannot_be_collected_is_refused() -> None:
    assert "lookahead" in expert_names("clutter_env/Retrieve-o15-v0")
    with pytest.raises(UnknownExpert, match="known ones: pick"):
        make_job(PICK, "nobody", 1)
    with pytest.raises(UnknownExpert, match="Retrieve"):
        make_job(Task("clutter_env/Skill-o5-v0"), "", 1)
    with pytest.raises(LearningError, match="episodes=0"):
        make_job(PICK, "", 0)
    with pytest.raises(LearningError, match="'scripted' needs control_mode='ee': --control-mode ee"):
        make_job(Task("clutter_env/Retrieve-o1-v0"), "scripted", 1)
    with pytest.raises(LearningError, match="for evaluation"):
        make_job(PICK, "", 1, first_seed=1_000_000)


@pytest.mark.slow
def test_processes_collect_episodes_that_replay(tmp_path: Path) -> None:
    job = Job(PICK, "pick", episodes=2)
    dataset = Dataset.open_for(job, tmp_path / "d")
    seeds = collect(job, dataset, partial(run_jobs, workers=2))
    assert [episode.seed for episode in dataset] == seeds


@pytest.mark.slow
def test_ray_collects_what_local_processes_collect() -> None:
    pytest.importorskip("ray")
    job = Job(PICK, "pick", episodes=1)
    (here,), (there,) = (list(run_jobs(partial(demonstrate, job), [0], workers=1, ray=at)) for at in ("", "local"))
    assert here[1].content
    assert here == there


def a_second(tried: Path, seed: int) -> SeedResult:
    """In place of `demonstrate`: takes a second and tells its process; every third seed fails."""
    with tried.open("a") as file:
        file.write(f"{seed} ")
    time.sleep(1.0)
    content = str(os.getpid()).encode()
    return SeedResult(seed, reason="no success: blocked") if seed % 3 == 1 else SeedResult(seed, content)


@pytest.mark.slow
def test_nothing_is_lost_or_doubled_on_a_cluster_whose_nodes_and_workers_die(tmp_path: Path) -> None:
    """Of two nodes one dies and another one joins; then all workers are killed, of which one has a job."""
    ray = pytest.importorskip("ray")
    cluster = pytest.importorskip("ray.cluster_utils").Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    nodes = [cluster.add_node(num_cpus=1) for _ in range(2)]
    ray.init(cluster.address, include_dashboard=False, log_to_driver=False)
    job, tried = dataclasses.replace(JOB, episodes=8), tmp_path / "tried"
    dataset = Dataset.open_for(job, tmp_path / "d")
    decided: list[int] = []
    workers: set[int] = set()

    def disturb(result: SeedResult) -> None:
        decided.append(result.seed)
        if result.content:
            workers.add(int(result.content))
        if len(decided) == 2:
            cluster.remove_node(nodes[0], allow_graceful=False)
            cluster.add_node(num_cpus=1)
        if len(decided) == 7:
            for worker in workers:
                with suppress(ProcessLookupError):
                    os.kill(worker, signal.SIGKILL)

    try:
        run = partial(run_jobs, partial(a_second, tried), workers=2, ray=cluster.address)
        seeds = collect(job, dataset, lambda _, seeds: run(seeds), disturb)
    finally:
        ray.shutdown()
        cluster.shutdown()
    assert len(tried.read_text().split()) > 12, "no job was lost, so none was tried again"
    assert sorted(decided) == list(range(12))
    assert seeds == dataset.seeds == [seed for seed in range(12) if seed % 3 != 1]
    assert sorted(dataset.reasons()) == [1, 4, 7, 10]
