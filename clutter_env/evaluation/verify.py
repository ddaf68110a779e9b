"""Verification of a results file: its recorded actions are played again, and must give what the file says."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym

from clutter_env.errors import ClutterEnvError, LearningError
from clutter_env.evaluation.evaluate import Evaluation, Played, judged_in, lower_bounds, replay
from clutter_env.evaluation.recording import CONTROL_MODES, Recording
from clutter_env.evaluation.scenes import SceneSet
from clutter_env.evaluation.score import PolicyCrashed, Score
from clutter_env.evaluation.suite_making import MOST_TRIED, content_of, file_text, qualifying, rules_of
from clutter_env.evaluation.tables import FORMAT, results
from clutter_env.parallel import Crash, Killed, run_jobs
from clutter_env.policies.registry import BUILT_IN, PolicyTraits, load_policy, policy_files
from clutter_env.policies.runs import is_run
from clutter_env.provenance import differences, provenance
from clutter_env.reporting.files import json_text, read_json, write_atomically
from clutter_env.reporting.intervals import Interval
from clutter_env.suites import FILE, suite

_TYPES: Mapping[str, type | tuple[type, ...]] = {
    **dict.fromkeys(("suite", "split", "env_id", "layout", "policy", "track", "grasps", "feasibility"), str),
    **dict.fromkeys(("environment", "judged_in", "provenance", "weights", "summary"), dict),
    **dict.fromkeys(("first_seed", "seed", "obstructed", "objects"), int),
    **dict.fromkeys(("episodes", "recordings"), list),
}
"""Entries of a results file that are used before they are compared."""
_CLAIMED = ("provenance", "recordings")
"""Entries that a replay does not give again."""
_STEP_S = 1e-3
"""[s] A step that is replayed, with 15 objects."""
_CLOSE = 1e-9
"""Relative difference of means and intervals, which processors may round differently."""


@dataclass(frozen=True)
class Verification:
    """Findings about a results file.

    Attributes:
        policy, track: that the file names. A replay proves the scores, not who made them: policy, track and weights
            are claims until the policy itself has been run.
        scenes: name of the scenes, and which of them if they were chosen: some of a suite's, or by their seeds.
        episodes: number of episodes.
        clean: claimed successes.
        differences: one sentence for each difference between the file and its replays. Empty if there is none.
        other_than: in what the environment here is other than that of the file, such as its version of MuJoCo. Replays
            that agree nevertheless confirm the scores. If they differ, the reason is not known.
        fresh: success of the policy itself on fresh scenes, None if it was not run.
        weights: "the same", "different" from those that the file names, or "not here".
    """

    policy: str
    track: str
    scenes: str
    episodes: int
    clean: int
    differences: tuple[str, ...]
    other_than: tuple[str, ...]
    fresh: Interval | None = None
    weights: str = "not here"

    @property
    def is_confirmed(self) -> bool:
        """Whether every score of the file is that of its actions, by the rules that hold here."""
        return not self.differences


def verify(path: Path, workers: int = 1, tick: Callable[[], object] = lambda: None) -> Verification:
    """Play the recorded actions of a results file again, each in a fresh environment of its scene.

    The file must be the one that `evaluate` would write of these replays: scores, summary, lower bounds and digest.

    Args:
        path: file that `clutter-env evaluate` wrote.
        workers: number of processes.
        tick: called after every episode.

    Raises:
        LearningError: the file is no results file of this version, or it is damaged.
        SuiteError: there is no such suite, or no lower bounds for the grasps that the file names.
    """
    content = read_results(path)
    scenes, claims = scenes_of(content), content["episodes"]
    found: list[str] = []
    # An episode without a recording is a crash of the policy, and a failure, whatever the file says of it.
    causes = [str(claim.get("failure", "")).removeprefix(Score.CRASHED) for claim in claims]
    replayed = [
        Played(Score.of_crash(scene.seed, cause), None) for scene, cause in zip(scenes.scenes, causes, strict=True)
    ]
    jobs = ((index, values) for index, values in enumerate(content["recordings"]) if values is not None)
    for (index, _), result in run_jobs(partial(_replay, scenes), jobs, workers):
        if isinstance(result, Crash | Killed):
            raise LearningError(f"the replay of episode {index} failed: {result}")
        if isinstance(result, Played):
            replayed[index] = result
            if result.recording and (extra := len(result.recording.actions) - result.score.steps) > 0:
                found.append(f"episode {index}: {extra} actions after its end")
        else:
            found.append(f"episode {index}: {result}")
        tick()
    made_again = results(_evaluation(content, replayed))
    found += _differences("", {name: value for name, value in content.items() if name not in _CLAIMED}, made_again)
    if content["policy"] in BUILT_IN and PolicyTraits.of(load_policy(content["policy"], 0)).track != content["track"]:
        found.append(f"{content['policy']} is no policy of the {content['track']} track")
    modes = [values.get("control_mode") for values in content["recordings"] if isinstance(values, dict)]
    judge = judged_in(scenes, [mode for mode in modes if mode in CONTROL_MODES and mode != "skill"])
    weights = policy_files(content["policy"])
    return Verification(
        policy=content["policy"],
        track=content["track"],
        scenes=which_scenes(scenes),
        episodes=len(claims),
        clean=sum(bool(claim.get("clean")) for claim in claims),
        differences=tuple(found),
        other_than=tuple(_other_machine(content, judge)),
        weights="not here" if not weights else "the same" if weights == content["weights"] else "different",
    )


def fresh_scenes(path: Path, count: int, first_seed: int, folder: Path, workers: int = 1) -> SceneSet:
    """Fresh scenes of the kind of those of a results file: of a suite, the first that its own rules admit.

    Args:
        path: the results file.
        count: of scenes.
        first_seed: from which seeds are tried.
        folder: where the file of a suite's fresh scenes is written. It stays there while they are played.
        workers: number of processes.

    Raises:
        LearningError: the file is no results file.
        SuiteError: too few of the seeds qualify.
    """
    scenes = scenes_of(read_results(path))
    if not scenes.suite:
        return replace(scenes, count=count, first_seed=first_seed)
    return fresh_suite(scenes.suite, count, first_seed, folder, workers)


def fresh_suite(name: str, count: int, first_seed: int, folder: Path, workers: int = 1) -> SceneSet:
    """The first scenes from a seed on that the rules of a suite admit. Arguments and errors are those of
    `fresh_scenes`."""
    rules, of = rules_of(name), suite(name)
    found = qualifying(rules, range(first_seed, first_seed + MOST_TRIED), count, workers)
    file = folder / f"fresh_{first_seed}{FILE}"
    content = content_of(rules, of.about, f"{of.name} fresh {first_seed}", {"test": found, "validation": []})
    write_atomically(file, file_text(content).encode())
    return SceneSet(str(file))


FRESH_SEEDS = range(5_000_000, 2**31)
"""First seeds of fresh scenes are drawn from these, after those of all suites."""


def read_results(path: Path) -> dict[str, Any]:
    """The content of a results file, with the types of the entries that are used.

    Raises:
        LearningError: it is no results file of this version, or it is damaged.
    """
    try:
        content = dict(read_json(path))
        if content["format"] != FORMAT:
            raise ValueError(f"its format is {content['format']}; this version reads {FORMAT}")
        for name, kind in _TYPES.items():
            if not isinstance(content[name], kind):
                raise TypeError(f"{name}={str(content[name])[:80]!r}")
        if len(content["episodes"]) != len(content["recordings"]):
            raise ValueError("it has not one recording for each episode")
        if not all(isinstance(claim, dict) for claim in content["episodes"]):
            raise TypeError("an episode is no object")
        if not content["policy"].isprintable():
            raise ValueError(f"policy={content['policy']!r}")
        is_run(content["policy"])  # a name that no file can have is an OSError
        # A name with a colon would import a module.
        if not content["suite"] and (":" in content["env_id"] or content["env_id"] not in gym.registry):
            raise ValueError(f"no environment {content['env_id']!r}")
    except OSError as problem:
        raise LearningError(f"{path} cannot be read: {problem.strerror or problem}") from problem
    except (ValueError, KeyError, TypeError, RecursionError) as problem:
        raise LearningError(f"{path} is no results file that can be verified: {problem!r}") from problem
    return content


def replay_seconds(claims: Sequence[Mapping[str, Any]]) -> float:
    """About the time [s] that one process needs to replay episodes of a results file."""
    steps = (claim.get("steps") for claim in claims)
    return _STEP_S * sum(count for count in steps if isinstance(count, int))


def claimed(path: Path) -> Evaluation:
    """Read a results file for tables, without playing anything again.

    Raises:
        LearningError: the file is no results file of this version, or it is damaged.
        SuiteError: there is no such suite, or no lower bounds for the grasps that the file names.
    """
    content = read_results(path)
    names = {field.name: field.default for field in fields(Score) if field.name != "wall_s"}
    newer = {name: default for name, default in names.items() if default is not MISSING}
    try:
        scores = [
            Score(wall_s=values["wall_s"] if values else 0.0, **{name: {**newer, **claim}[name] for name in names})
            for claim, values in zip(content["episodes"], content["recordings"], strict=True)
        ]
    except (KeyError, TypeError) as problem:
        raise LearningError(f"{path} is no results file: an episode lacks {problem}") from None
    return _evaluation(content, [Played(score, None) for score in scores])


def _evaluation(content: Mapping[str, Any], episodes: Sequence[Played]) -> Evaluation:
    """The evaluation of a results file, with these episodes."""
    scenes = scenes_of(content)
    return Evaluation(
        policy=content["policy"],
        scenes=scenes,
        seed=content["seed"],
        feasibility=content["feasibility"],
        traits=PolicyTraits(content["track"], {}, False, content["grasps"], "", ""),
        weights=content["weights"],
        episodes=tuple(episodes),
        floors=lower_bounds(scenes, content["grasps"]) if scenes.has_floors else (),
        provenance={"environment": content["environment"]},
        judged_in=content["judged_in"],
    )


def scenes_of(content: Mapping[str, Any]) -> SceneSet:
    """The scenes of a results file."""
    count = len(content["episodes"])
    if content["suite"]:
        return SceneSet(content["suite"], content["split"], count=count)
    return SceneSet(
        env_id=content["env_id"],
        obstructed=content["obstructed"],
        layout=content["layout"],
        objects=content["objects"],
        task=content.get("task", ""),
        count=count,
        first_seed=content["first_seed"],
    )


def which_scenes(scenes: SceneSet) -> str:
    """The scenes in words. Whoever chooses how many are played, or their seeds, can choose those that are won."""
    first, last, count = scenes.scenes[0].seed, scenes.scenes[-1].seed, len(scenes.scenes)
    if not scenes.suite:
        return f"{scenes.name}, seeds {first} to {last}"
    whole = len(suite(scenes.suite).split(scenes.split))
    return scenes.name if count == whole else f"{scenes.name}, its first {count} of {whole} scenes"


def _other_machine(content: Mapping[str, Any], environment: Mapping[str, Any]) -> list[str]:
    """Reasons why replays of a file on this machine may give other scores. Empty if they must give the same."""
    there, here = content["provenance"], provenance()
    found = [
        f"It was recorded with {name} {there.get(name)}; this is {here[name]}."
        for name in ("mujoco", "platform", "arithmetic")
        if there.get(name, here[name]) != here[name]
    ]
    return found + differences({**here, "environment": content["judged_in"]}, {**here, "environment": environment})


def _replay(scenes: SceneSet, job: tuple[int, Any]) -> Played | str:
    """An episode played again, or why it cannot be."""
    index, values = job
    try:
        recording = Recording.from_json(values)
        return Played(replay(scenes, index, recording), recording)
    except (ClutterEnvError, PolicyCrashed) as problem:
        return str(problem)


def _differences(place: str, claimed: Any, found: Any) -> Iterator[str]:
    """A sentence for every value of the file, and every value of the replay, that the other one lacks."""
    found = json.loads(json_text(found)) if not place else found
    if isinstance(claimed, dict) and isinstance(found, dict):
        for name in {**claimed, **found}:
            if name not in _CLAIMED or place:
                yield from _differences(f"{place} {name}", claimed.get(name), found.get(name))
    elif isinstance(claimed, list) and isinstance(found, list) and len(claimed) == len(found):
        for index, values in enumerate(zip(claimed, found, strict=True)):
            yield from _differences(f"{place} {index}", *values)
    elif type(claimed) is float and type(found) is float and place.startswith(" summary"):
        if not abs(claimed - found) <= _CLOSE * abs(found):
            yield f"{place.strip()} is {claimed!r} in the file, {found!r} in the replay"
    elif type(claimed) is not type(found) or claimed != found:
        yield f"{place.strip()} is {str(claimed)[:200]!r} in the file, {str(found)[:200]!r} in the replay"
