"""Ray gives what local processes give."""

from __future__ import annotations

from functools import partial

import pytest

from clutter_env.learning.demonstrations.collect import demonstrate
from clutter_env.learning.demonstrations.dataset import Job
from clutter_env.learning.task import Task
from clutter_env.parallel import run_jobs

ray = pytest.importorskip("ray")
pytest.importorskip("h5py")


@pytest.mark.slow
def test_ray_collects_what_local_processes_collect() -> None:
    job = Job(Task("clutter_env/Pick-v0"), "pick", episodes=1)
    (here,), (there,) = (list(run_jobs(partial(demonstrate, job), [0], workers=1, ray=at)) for at in ("", "local"))
    assert here[1].content
    assert here == there
