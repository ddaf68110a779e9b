"""Collect expert demonstrations in parallel. Each is kept only if it replays bit for bit in a new process.

    clutter-env collect --env clutter_env/Retrieve-o15-v0 --episodes 200 --out outputs/demos/o15

An episode takes two to three seconds of CPU time, most of them its replay in a new Python process. Run the same command
again after an interruption: seeds that are decided already are not tried again.

Of LIBERO's tasks, `--env libero:libero_goal/3 --states 0-19`, one after another into one file of LIBERO's layout.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

_EPISODE_S = 3.0
"""[s] An episode of the expert with 15 objects, its replay in a new process included."""
_IMAGE_SIZE = 96
"""Pixels along each side of images, if not said otherwise."""
_LIBERO = "libero:"
WHEN_INTERRUPTED = "run the same command again to go on"


@dataclass(frozen=True)
class Arguments:
    """Collect demonstrations."""

    env: str = "clutter_env/Retrieve-o15-v0"
    """Environment id, or a task of LIBERO, for example libero:libero_goal/3."""
    episodes: int = 200
    """Successful episodes wanted."""
    out: Path | None = None
    """Directory of the episodes' files. One that the same command made is continued. Without it, one in outputs/demos/
    named by environment and strategy."""
    strategy: str = ""
    """The expert: a strategy of the planner, "canonical" (plans that can be learned), one of these with "-all" for all
    grasps, or "scripted". Empty for the first one of the environment."""
    control_mode: Literal["joint", "ee", ""] = ""
    """Control mode. Empty for the environment's own."""
    layout: str = ""
    """Layout. Empty for the environment's own."""
    task: str = ""
    """Task of a Rearrange environment. Empty for the environment's own."""
    obstructed: bool = False
    """Collect on scenes whose target no side grasp reaches before another object moves."""
    obs_mode: Literal["state", "rgbd"] = "state"
    """With "rgbd", observations have images of the robot's cameras too, rendered after an episode has replayed."""
    image_size: int | None = None
    """Pixels along each side of these images. 96 if not given, of LIBERO's tasks 128."""
    states: str = "0-19"
    """Of LIBERO's tasks: numbers of frozen initial states."""
    python: Path = Path("venv-libero/bin/python")
    """Of LIBERO's tasks: the Python with LIBERO."""
    seed: int = 0
    """First seed. The others follow in ascending order. Seeds from 1,000,000 on are for evaluation."""
    workers: int = 2
    """Number of processes."""
    ray: str = ""
    """Address of Ray ("auto", "local", …): collect there instead of in processes of this machine."""
    json: Path | None = None
    """Write the counts to this file."""


def run(arguments: Arguments) -> None:
    """Collect, and print the counts."""
    if arguments.env.startswith(_LIBERO):
        _run_libero(arguments)
        return
    import time
    from collections import Counter
    from functools import partial

    from clutter_env.config import IMAGE_SIZE_RANGE
    from clutter_env.data.collect import SeedResult, collect, make_job
    from clutter_env.data.dataset import Dataset
    from clutter_env.errors import check_integer
    from clutter_env.parallel import run_jobs
    from clutter_env.reporting.files import write_json
    from clutter_env.reporting.progress import progress_bar
    from clutter_env.task import Task

    chosen = {name: getattr(arguments, name) for name in ("control_mode", "layout", "obstructed", "task")}
    task = Task(arguments.env, {name: value for name, value in chosen.items() if value})
    wanted_size = _IMAGE_SIZE if arguments.image_size is None else arguments.image_size
    check_integer("image_size", wanted_size, *IMAGE_SIZE_RANGE)
    image_size = wanted_size if arguments.obs_mode == "rgbd" else 0
    job = make_job(task, arguments.strategy, arguments.episodes, arguments.seed, image_size)
    kind = "-".join(filter(None, (arguments.env.rpartition("/")[2].removesuffix("-v0").lower(), arguments.task)))
    name = f"{kind}-{job.expert}"
    dataset = Dataset.open_for(job, arguments.out or Path("outputs/demos") / name)
    started, made = time.perf_counter(), 0
    there = min(len(list(dataset.episodes_directory.glob("*.hdf5"))), job.episodes)
    seconds = _EPISODE_S * (job.episodes - there) / arguments.workers
    bar_of = partial(progress_bar, total=job.episodes, initial=there, unit="episode", seconds=seconds)
    with dataset.locked(), bar_of() as bar:

        def report(result: SeedResult) -> None:
            nonlocal made
            if result.content:
                made += 1
                bar.update()
            bar.set_postfix(seed=result.seed, last=result.reason.partition(":")[0] or "kept")

        seeds = collect(job, dataset, partial(run_jobs, workers=arguments.workers, ray=arguments.ray), report)
    wall_s = time.perf_counter() - started
    rejected = Counter(reason.splitlines()[0] for reason in dataset.reasons().values())
    print(f"{len(seeds)} episodes in {dataset.directory}, seeds {seeds[0]} to {seeds[-1]}")
    rate = f": {made / wall_s * 3600:.0f} per hour, replay included" if made else ""
    print(f"{made} of them collected now, in {wall_s:.0f} s{rate}")
    for reason, count in rejected.most_common():
        print(f"  {count} rejected: {reason}")
    if arguments.json is not None:
        content = {"seeds": seeds, "made": made, "wall_s": wall_s, "rejected": rejected, "job": job.identity()}
        write_json(arguments.json, content)


def _run_libero(arguments: Arguments) -> None:
    """Collect from frozen initial states of a task of LIBERO, and print the counts."""
    import resource
    import time

    from clutter_env.bridges.libero_demos import IMAGE_SIZE, StateResult, collect_states, parse_states
    from clutter_env.bridges.remote import BridgeError, Remote

    suite, _, number = arguments.env.removeprefix(_LIBERO).partition("/")
    if not (suite and number.isdigit()):
        raise BridgeError(f"env={arguments.env!r} is not valid; for example: libero:libero_goal/3")
    states = parse_states(arguments.states)
    folder = arguments.out or Path("outputs/demos") / suite
    file = folder / f"{suite}_{number}_demo.hdf5"
    size = arguments.image_size or IMAGE_SIZE

    def report(result: StateResult) -> None:
        print(f"state {result.state}: {result.reason or f'kept, {result.steps} steps'}", flush=True)

    with Remote(arguments.python, "libero_worker.py") as libero:
        results = collect_states(libero, suite, int(number), states, file, size, report)
    worker, kept = resource.getrusage(resource.RUSAGE_CHILDREN), sum(not one.reason for one in results)
    cpu_s = time.process_time() + worker.ru_utime + worker.ru_stime
    rate = f": {kept / cpu_s * 3600:.0f} per hour, replay included" if kept else ""
    size_mb = f", {file.stat().st_size / 1e6:.1f} MB" if file.exists() else ""
    print(f"{kept} of {len(results)} states tried now were kept, in {cpu_s:.0f} s of CPU time{rate}; {file}{size_mb}")
