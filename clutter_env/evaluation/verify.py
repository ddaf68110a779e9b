"""Verification of a results file: its recorded actions are played again, and must give the scores that it claims."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from clutter_env.errors import LearningError
from clutter_env.evaluation.evaluate import Played, evaluate, judged_in, replay
from clutter_env.evaluation.recording import Recording
from clutter_env.evaluation.scenes import SceneSet
from clutter_env.evaluation.score import Score
from clutter_env.evaluation.tables import FORMAT, score_values
from clutter_env.parallel import Crash, Killed, run_jobs
from clutter_env.policies.registry import policy_files
from clutter_env.provenance import differences, provenance
from clutter_env.reporting.intervals import Interval, wilson
from clutter_env.suites import content_digest, suite

_PLAYED = (
    *("scenes", "suite", "suite_sha256", "split", "env_id", "obstructed", "layout", "first_seed"),
    *("policy", "track", "weights", "seed", "feasibility", "grasps", "environment", "judged_in", "episodes"),
)
"""Entries of a results file that its digest covers."""


@dataclass(frozen=True)
class Verification:
    """What was found in a results file.

    Attributes:
        policy: that the file names. A replay proves the scores, not who made them: policy, track and weights are
            claims until the policy itself has been run.
        episodes: number of episodes.
        clean: claimed successes.
        differences: one sentence for everything in the file that is not as a replay gives it; empty if all is.
        not_comparable: why a replay on this machine says nothing, such as another version of MuJoCo; empty if it does.
        fresh: success of the policy itself on fresh scenes, None if it was not run.
        weights: "the same", "different" from those that the file names, or "not here".
    """

    policy: str
    episodes: int
    clean: int
    differences: tuple[str, ...]
    not_comparable: tuple[str, ...]
    fresh: Interval | None = None
    weights: str = "not here"

    @property
    def is_confirmed(self) -> bool:
        """Whether every score of the file is that of its actions."""
        return not self.differences and not self.not_comparable


def verify(path: Path, workers: int = 1, tick: Callable[[], object] = lambda: None) -> Verification:
    """Play the recorded actions of a results file again, each in a fresh environment of its scene.

    Args:
        path: file that `clutter-env evaluate` wrote.
        workers: number of processes.
        tick: called after every episode.

    Raises:
        LearningError: the file is no results file of this version, or it is damaged.
        SuiteError: there is no such suite.
    """
    content = read_results(path)
    scenes, episodes = scenes_of(content), content["episodes"]
    found: list[str] = []
    if content_digest({name: content[name] for name in _PLAYED}) != content["digest"]:
        found.append("the content does not have the digest that the file states")
    if content["suite"] and suite(content["suite"]).digest != content["suite_sha256"]:
        found.append(f"suite {content['suite']} of this package has other scenes")
    jobs = []
    for index, (claim, values) in enumerate(zip(episodes, content["recordings"], strict=True)):
        if values is not None:
            jobs.append((index, Recording.from_json(values)))
        elif claim["clean"] or claim["lifted"]:
            found.append(f"episode {index} claims a success, and has no recording")
    for (index, recording), result in run_jobs(partial(_replay, scenes), jobs, workers):
        if isinstance(result, Crash | Killed):
            raise LearningError(f"the replay of episode {index} failed: {result}")
        found += [f"episode {index}: {text}" for text in _compare(episodes[index], recording, result)]
        tick()
    successes = sum(bool(claim["clean"]) for claim in episodes)
    weights = policy_files(content["policy"])
    here = "not here" if not weights else "the same" if weights == content["weights"] else "different"
    modes = [recording.control_mode for _, recording in jobs]
    other = tuple(_other_machine(content, judged_in(scenes, modes)))
    return Verification(content["policy"], len(episodes), successes, tuple(sorted(found)), other, weights=here)


def play_fresh(
    path: Path,
    policy: str,
    count: int,
    workers: int = 1,
    tick: Callable[[], object] = lambda: None,
    trust: bool = False,
) -> Interval:
    """Success of the policy itself on fresh scenes of the same kind, seeds after those of the suites.

    Raises:
        See `evaluate`.
    """
    scenes = scenes_of(read_results(path))
    first = scenes.scenes[0]
    fresh = SceneSet(
        env_id=first.env_id,
        obstructed=first.keywords.get("obstructed", False),
        layout=str(first.keywords.get("layout", "")),
        count=count,
        first_seed=FRESH_SEED,
    )
    scores = evaluate(policy, fresh, trust=trust, workers=workers, tick=tick).scores
    return wilson(sum(score.clean for score in scores), count)


FRESH_SEED = 5_000_000
"""First seed of the scenes on which `play_fresh` runs a policy: after those of all suites."""


def read_results(path: Path) -> dict[str, Any]:
    """The content of a results file, its entries and their types checked.

    Raises:
        LearningError: it is no results file of this version, or it is damaged.
    """
    try:
        content = json.loads(path.read_text())
        if content["format"] != FORMAT:
            raise ValueError(f"its format is {content['format']}; this version reads {FORMAT}")
        lists = {name: list(content[name]) for name in ("episodes", "recordings")}
        if len(lists["episodes"]) != len(lists["recordings"]):
            raise ValueError("it has not one recording for each episode")
        for name in (*_PLAYED, "digest"):
            content[name]
        dict(content["provenance"]), dict(content["weights"]), dict(content["judged_in"])
        for claim in lists["episodes"]:
            Score(wall_s=0.0, **{name: claim[name] for name in claim if name not in ("index", "floor", "actions")})
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as problem:
        raise LearningError(f"{path} is no results file that can be verified: {problem!r}") from problem
    return dict(content)


def scenes_of(content: Mapping[str, Any]) -> SceneSet:
    """The scenes of a results file."""
    count = len(content["episodes"])
    if content["suite"]:
        return SceneSet(content["suite"], content["split"], count=count)
    return SceneSet(
        env_id=content["env_id"],
        obstructed=content["obstructed"],
        layout=content["layout"],
        count=count,
        first_seed=content["first_seed"],
    )


def _other_machine(content: Mapping[str, Any], environment: Mapping[str, Any]) -> list[str]:
    """Why the replays of a file on this machine need not give its scores; empty if they must."""
    there, here = content["provenance"], provenance()
    found = [
        f"It was recorded with {name} {there.get(name)}; this is {here[name]}."
        for name in ("mujoco", "platform")
        if there.get(name) != here[name]
    ]
    return found + differences({**here, "environment": content["judged_in"]}, {**here, "environment": environment})


def _replay(scenes: SceneSet, job: tuple[int, Recording]) -> Score:
    return replay(scenes, *job)


def _compare(claim: Mapping[str, Any], recording: Recording, score: Score) -> list[str]:
    """What differs between an episode of the file and the replay of its actions."""
    found = []
    if Played(score, recording).actions_digest != claim["actions"]:
        found.append("its actions do not have the digest that the file states")
    for name, value in score_values(score).items():
        if claim[name] != value:
            found.append(f"{name} is {claim[name]!r} in the file, {value!r} in the replay")
    return found
