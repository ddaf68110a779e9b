"""Many episodes of the expert in the simulation, in parallel: success rate and causes of failure."""

from __future__ import annotations

import itertools
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from clutter_env.experiments.clearance_table.statistics import CRASH
from clutter_env.experiments.clearance_table.trials import ASSESSMENT, Assessment, Attempt, Trial, run_trial
from clutter_env.parallel import Crash, Killed, run_jobs
from clutter_env.reporting.intervals import times, wilson
from clutter_env.reporting.progress import progress_bar

__all__ = ["Episode", "counts_text", "play_many"]

_LIMIT_S = 1200.0
"""[s] of wall time after which an episode is killed."""


@dataclass(frozen=True)
class Episode:
    """One episode: the minimum number of clearances, None if not proved or not known, and the expert's attempt."""

    floor: int | None
    attempt: Attempt


def play_many(first: Trial, episodes: int, only_obstructed: bool, jobs: int, path: Path) -> list[Episode]:
    """Play the scenes from a trial's seed on; each episode is written to `path` as soon as it is over.

    Args:
        first: the first scene, and all settings.
        episodes: number of episodes.
        only_obstructed: leave out scenes in which nothing has to be cleared, or no clearance frees the target.
        jobs: number of processes.
        path: file of the results, one JSON object a line.

    Returns:
        The episodes, by seed.
    """
    played: list[Episode] = []
    seeds = (replace(first, seed=seed) for seed in itertools.count(first.seed))
    wanted = itertools.takewhile(lambda _: len(played) < episodes, seeds)
    play = _play_obstructed if only_obstructed else _play
    with path.open("w") as file, progress_bar(total=episodes, unit="episode") as bar:
        for trial, result in run_jobs(play, wanted, jobs, _LIMIT_S):
            episode = _ended(trial, result) if isinstance(result, Crash | Killed) else result
            if episode is None:
                continue
            played.append(episode)
            file.write(json.dumps(asdict(episode)) + "\n")
            file.flush()
            bar.update()
            bar.set_postfix(succeeded=sum(entry.attempt.solved for entry in played), seed=trial.seed)
    return sorted(played, key=lambda entry: entry.attempt.seed)[:episodes]


def counts_text(played: Sequence[Episode]) -> str:
    """Rates of both kinds of success with 95% intervals, clearances, times, causes of failure and deviations."""
    ended = [entry for entry in played if entry.attempt.cause != CRASH]
    attempts = [entry.attempt for entry in ended]
    solved = [entry for entry in ended if entry.attempt.solved]
    success, lifted = wilson(len(solved), len(ended)), sum(attempt.lifted for attempt in attempts)
    floors = [entry for entry in solved if entry.floor is not None]
    simulated = times([entry.attempt.sim_s for entry in solved])
    planning = times([attempt.total_s for attempt in attempts])
    rows = {
        "episodes": f"{len(ended)}, and {len(played) - len(ended)} CRASHED",
        "clean success": f"{len(solved)} of {len(ended)}: {success}",
        "target lifted": f"{lifted} of {len(ended)}: {wilson(lifted, len(ended))}",
        "objects cleared": f"{_mean([len(entry.attempt.clearances) for entry in solved]):.2f} on average",
        "minimum number of clearances": f"{_mean([entry.floor or 0 for entry in floors]):.2f} on average",
        "cleared twice or more": f"{sum(attempt.duplicated for attempt in attempts)} objects",
        "replans after deviations": f"{sum(attempt.replans for attempt in attempts)}",
        "toppled or off the table": f"{sum(attempt.fallen for attempt in attempts)} objects",
        "disturbed": f"{sum(attempt.disturbed for attempt in attempts)} objects",
        "planning": f"{planning.median:.2f} s of CPU time (median), {planning.p95:.2f} s (95th percentile)",
        "simulated time of a success": f"{simulated.median:.1f} s (median), {simulated.p95:.1f} s (95th percentile)",
    }
    width = max(map(len, rows))
    lines = [f"  {name:<{width}}  {value}" for name, value in rows.items()]
    lines += _causes("causes of failure", Counter(entry.attempt.cause for entry in played if entry.attempt.cause))
    lines += _causes("deviations", Counter(_kind(text) for attempt in attempts for text in attempt.deviations))
    return "\n".join(lines)


def _play(trial: Trial) -> Episode:
    scene = run_trial(replace(trial, strategy=ASSESSMENT))
    attempt = run_trial(trial)
    assert isinstance(scene, Assessment)
    assert isinstance(attempt, Attempt)
    return Episode(scene.floor if scene.proved else None, attempt)


def _play_obstructed(trial: Trial) -> Episode | None:
    """The episode, or None if the target is not obstructed or cannot be freed."""
    scene = run_trial(replace(trial, strategy=ASSESSMENT))
    assert isinstance(scene, Assessment)
    return _play(trial) if scene.is_obstructed else None


def _ended(trial: Trial, result: Crash | Killed) -> Episode:
    """The record of an episode whose process crashed or was killed."""
    cause = CRASH if isinstance(result, Crash) else "killed"
    detail = result.detail if isinstance(result, Crash) else f"did not end within {result.seconds:.0f} s"
    return Episode(None, Attempt(*trial.key, cause=cause, detail=detail))


def _causes(title: str, counts: Counter[str]) -> list[str]:
    return [f"  {title}:", *(f"    {count} x {cause}" for cause, count in counts.most_common())] if counts else []


def _kind(deviation: str) -> str:
    """The text of a deviation without the name of its object."""
    return deviation.rpartition(": ")[2]


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else float("nan")
