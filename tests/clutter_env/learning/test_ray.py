"""Ray gives what local processes give."""

from __future__ import annotations

import pytest

from clutter_env.learning.demonstrations.collect import demonstrate
from clutter_env.learning.demonstrations.dataset import Job
from clutter_env.learning.task import Task
from clutter_env.parallel.workers import LocalWorkers, RayWorkers

ray = pytest.importorskip("ray")
pytest.importorskip("h5py")


@pytest.mark.slow
def test_ray_collects_what_local_processes_collect() -> None:
    job = Job(Task("clutter_env/Pick-v0"), "pick", episodes=1)
    outcomes = []
    for workers in (LocalWorkers(demonstrate, job, 1), RayWorkers(demonstrate, job, 1, "local")):
        workers.submit(0)
        outcomes += workers.wait()
        workers.close()
    (_, here), (_, there) = outcomes
    assert here.content
    assert here == there
