"""Record five demonstrations that replay bit for bit, and read them back."""

from functools import partial
from pathlib import Path

from clutter_env.data.collect import collect
from clutter_env.data.dataset import Dataset, Job
from clutter_env.parallel import run_jobs
from clutter_env.task import Task

if __name__ == "__main__":
    job = Job(Task("clutter_env/Retrieve-o5-v0"), expert="lookahead", episodes=5)
    dataset = Dataset.open_for(job, Path("outputs/example_demos"))
    run = partial(run_jobs, workers=2)
    collect(job, dataset, run, report=lambda result: print("seed", result.seed, result.reason or "kept"))

    for episode in dataset:
        print(f"seed {episode.seed}: {len(episode)} steps, first skill {episode.skills[0]!r}")
        print(episode.plan)
