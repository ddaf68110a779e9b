"""`evaluate(policy, scenes)`: episodes of a policy on fixed scenes, and their scores.

The commands `evaluate` and `compare` print its results. An interrupted evaluation continues with its file of records.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import gymnasium as gym

from clutter_env.errors import ClutterEnvError, LearningError, SuiteError
from clutter_env.evaluation.policy_process import PolicyProcess
from clutter_env.evaluation.recording import Recording
from clutter_env.evaluation.scenes import SceneSet, find_floor, scene_for
from clutter_env.evaluation.score import PolicyCrashed, Score, play_scene
from clutter_env.parallel import Crash, Killed, run_jobs
from clutter_env.policies.protocol import AnyPolicy, PolicyError
from clutter_env.policies.registry import PolicyTraits, policy_families, policy_files
from clutter_env.provenance import IMAGES, differences, environment_digest, provenance
from clutter_env.reporting.files import JsonLines
from clutter_env.reporting.intervals import Interval, wilson
from clutter_env.suites import Floor, suite
from clutter_env.task import Task

ResultT = TypeVar("ResultT", "Played", Floor)
EPISODE_S = 4.0
"""[s] Approximate time of an episode with 15 objects, its replay included. Means of policies and suites are 2 to 40."""
_HINT = "--count-crashes counts such episodes as failures"


class Played(NamedTuple):
    """An episode: its score, and the recording from which the score was made, which is None after a crash."""

    score: Score
    recording: Recording | None


@dataclass(frozen=True)
class Evaluation:
    """The result of `evaluate`.

    Attributes:
        policy: its name.
        scenes: the scenes that it played.
        seed: of the built-in random policies.
        feasibility: of the Skill environment, for policies that act by skills.
        traits: what the policy is: its track, and the grasps by whose lower bounds its results are broken down.
        weights: SHA-256 of the files of the policy, by their names.
        episodes: of the scenes, in their order.
        floors: lower bounds of the scenes for these grasps. Empty if they are not known, as outside the suites.
        provenance: version, commit, packages and digest of the environment. See `clutter_env.provenance`.
        judged_in: digest of the environment of the replays.
    """

    policy: str
    scenes: SceneSet
    seed: int
    feasibility: str
    traits: PolicyTraits
    weights: Mapping[str, str]
    episodes: tuple[Played, ...]
    floors: tuple[Floor, ...]
    provenance: Mapping[str, Any]
    judged_in: Mapping[str, Any]

    @property
    def scores(self) -> tuple[Score, ...]:
        """The scores of the episodes."""
        return tuple(episode.score for episode in self.episodes)

    @property
    def num_clean(self) -> int:
        """Number of clean successes."""
        return sum(score.clean for score in self.scores)

    @property
    def clean(self) -> Interval:
        """Clean success, with Wilson's interval."""
        return wilson(self.num_clean, len(self.episodes))


@dataclass(frozen=True)
class _Job:
    """The policy and the scenes of a worker's jobs, one for each index of a scene."""

    policy: str
    scenes: SceneSet
    seed: int = 0
    feasibility: str = ""
    trust: bool = False
    python: str = ""
    without: tuple[str, ...] = ()

    def place(self, index: int) -> str:
        return f"{self.policy} on scene {index} of {self.scenes.name} (seed {self.scenes.scenes[index].seed})"


def evaluate(
    policy: str | AnyPolicy,
    scenes: SceneSet,
    *,
    seed: int = 0,
    feasibility: str = "oracle",
    trust: bool = False,
    python: str = "",
    without: tuple[str, ...] = (),
    workers: int = 1,
    ray: str = "",
    count_crashes: bool = False,
    records: ResultRecords | None = None,
    begin: Callable[[], object] = lambda: None,
    tick: Callable[[], object] = lambda: None,
) -> Evaluation:
    """Play all scenes with a policy, and score the replay of its actions.

    A policy that is given by its name plays in a process of its own. See `policy_process`. Its actions are recorded and
    played again in a fresh environment of the scene, in a process in which no policy has run: the score is that of this
    replay. What a policy does to its own environment does not count.

    In a script it stands below `if __name__ == "__main__":`, because its processes import the script.

    Args:
        policy: a name for `load_policy`, or a policy, which plays in this process.
        scenes: to be played.
        seed: of the built-in random policies.
        feasibility: of the Skill environment, for policies that act by skills: "oracle" or "none".
        trust, python: for policies of Stable-Baselines3 and of LeRobot, see `load_policy`.
        without: modules that a policy which is given by its name may not import.
        workers: number of processes that score, each with one for the policy.
        ray: address of Ray, or "" for processes of this machine.
        count_crashes: whether an exception of the policy is a failed episode. Otherwise it ends the evaluation.
        records: file to which every score is written at once. Scores that are in it are not made again.
        begin: called when the policy has been loaded and fits the scenes, before the first episode.
        tick: called after every episode.

    Raises:
        SuiteError: no such suite or split, or a scene is not the one that the suite was made with.
        PolicyError: no such policy, or it cannot play these scenes.
        PolicyCrashed: the policy raised an exception in another process, which died, or returned no valid action. An
            exception in this process is not caught.
        OSError: the scores cannot be written. Those written before stay.
    """
    job = _Job(
        policy if isinstance(policy, str) else type(policy).__name__, scenes, seed, feasibility, trust, python, without
    )
    if isinstance(policy, str) and scenes.family not in (own := policy_families(policy)):
        raise PolicyError(f"{policy} cannot play {scenes.name} ({scenes.family}); it plays {', '.join(own)}")
    todo: list[tuple[int, PolicyTraits]] = []
    stream = run_jobs(partial(_play_in_worker, job), _traits_first(todo), workers, ray=ray)
    env: gym.Env[Any, Any] | None = None
    try:
        traits = _checked(next(stream)[1], job.policy) if isinstance(policy, str) else PolicyTraits.of(policy)
        assert isinstance(traits, PolicyTraits)
        if "cameras" in traits.env_keywords and scenes.family == "search":
            raise PolicyError("in Search the scenes depend on the cameras: a policy may not choose them")
        if scenes.family == "skill" and feasibility != "oracle":
            raise LearningError(f"feasibility={feasibility!r} is for scenes of Retrieve, which skills play too")
        floors = lower_bounds(scenes, traits.grasps) if scenes.has_floors else ()
        env = scene_for(scenes.scenes[0], traits.acts_by_skills, feasibility).make(**traits.env_keywords)

        def play(missing: Iterable[int]) -> Iterator[tuple[int, Played]]:
            if not isinstance(policy, str):
                yield from _play_here(job, missing, env, policy, traits, count_crashes)
                return
            todo.extend((index, traits) for index in missing)
            for _ in range(len(todo)):
                (index, _), result = next(stream)
                if isinstance(result, PolicyCrashed) and count_crashes:
                    cause = str(result).strip().rpartition("\n")[2]
                    result = Played(Score.of_crash(scenes.scenes[index].seed, cause), None)
                yield index, _checked(result, job.place(index))

        made_with = provenance(env)
        begin()
        played = _complete(job, made_with, records, play, tick)
    finally:
        stream.close()
        if env is not None:
            env.close()
    judge = judged_in(scenes, [episode.recording.control_mode for episode in played if episode.recording])
    files = policy_files(job.policy, traits.file)
    return Evaluation(job.policy, scenes, seed, feasibility, traits, files, tuple(played), floors, made_with, judge)


def _traits_first(todo: Sequence[tuple[int, PolicyTraits]]) -> Iterator[tuple[int, PolicyTraits | None] | None]:
    """The jobs of the workers: what the policy is, then the scenes, which are known once that has been answered."""
    yield -1, None
    while not todo:
        yield None
    yield from todo


def _checked(result: Any, place: str) -> Any:
    """The result of a worker. A failure is raised."""
    if isinstance(result, PolicyCrashed):
        raise PolicyCrashed(f"{place}; {_HINT}\n\n{result}")
    if isinstance(result, ClutterEnvError):
        raise result
    if isinstance(result, Crash | Killed):
        raise PolicyCrashed(f"{place}\n\n{result.detail}")
    return result


def lower_bounds(
    scenes: SceneSet, grasps: str, *, workers: int = 1, ray: str = "", records: ResultRecords | None = None
) -> tuple[Floor, ...]:
    """The lower bound of every scene, the fewest clearances: that of the suite, or found by the planner.

    Raises:
        SuiteError: the suite has none for these grasps.
        LearningError: the planner failed.
    """

    def find(missing: Iterable[int]) -> Iterator[tuple[int, Floor]]:
        for index, result in run_jobs(partial(_find_floor, scenes, grasps), missing, workers, ray=ray):
            if isinstance(result, Crash | Killed):
                raise LearningError(f"lower bound of scene {index} of {scenes.name}: {result.detail}")
            yield index, result

    if scenes.suite:
        return tuple(find_floor(scene, grasps) for scene in scenes.scenes)
    made_with = Task(scenes.env_id, scenes.scenes[0].keywords).provenance()
    return tuple(_complete(_Job(f"minimum for {grasps}", scenes), made_with, records, find))


def _complete(
    job: _Job,
    made_with: Mapping[str, Any],
    records: ResultRecords | None,
    make: Callable[[Iterable[int]], Iterator[tuple[int, ResultT]]],
    tick: Callable[[], object] = lambda: None,
) -> list[ResultT]:
    """The results of all scenes: those in the records, and those that `make` makes of the others' indices.

    A result is written as soon as it is made, but for a crash: the policy will have been mended.
    """
    count = len(job.scenes.scenes)
    keys = _keys(job, made_with)
    known = {} if records is None else records.known
    found = {index: known[key] for index, key in enumerate(keys) if key in known}
    for _ in found:
        tick()
    for index, result in make([index for index in range(count) if index not in found]):
        if records is not None and not (isinstance(result, Played) and result.score.is_crash):
            records.add(keys[index], result)
        found[index] = result
        tick()
    return [found[index] for index in range(count)]


def _play_here(
    job: _Job, missing: Iterable[int], env: gym.Env, policy: AnyPolicy, traits: PolicyTraits, count_crashes: bool
) -> Iterator[tuple[int, Played]]:
    """Play in this process, one scene after the other. The replays are scored in another process."""
    crashed: list[tuple[int, Played]] = []

    def recordings() -> Iterator[tuple[int, Recording]]:
        for index in missing:
            scene = job.scenes.scenes[index]
            played = scene_for(scene, traits.acts_by_skills, job.feasibility)
            try:
                yield index, Recording.of(scene, env, play_scene(played, env, policy))
            except (SuiteError, PolicyError):
                raise
            except Exception as problem:
                if not count_crashes:
                    problem.add_note(f"{job.place(index)}; {_HINT}")
                    raise  # with the traceback of the policy's own code
                cause = f"{type(problem).__name__}: {problem}"
                crashed.append((index, Played(Score.of_crash(scene.seed, cause), None)))

    for (index, recording), score in run_jobs(partial(_replay, job.scenes), recordings(), 1):
        if isinstance(score, Crash | Killed):
            raise LearningError(f"the replay of scene {index} of {job.scenes.name} failed: {score.detail}")
        yield index, Played(score, recording.cut(score.steps))
    yield from crashed


def _play_in_worker(
    job: _Job, task: tuple[int, PolicyTraits | None]
) -> PolicyTraits | Played | ClutterEnvError | PolicyCrashed:
    """Describe the policy, or play a scene and score the replay of the recording."""
    index, traits = task
    try:
        if _process(job).has_ended:  # by a crash
            _process.cache_clear()
        process = _process(job)
        if traits is None:
            return process.traits
        if process.traits != traits:
            raise PolicyCrashed(f"the policy was {traits}, and in another process is {process.traits}")
        scene = job.scenes.scenes[index]
        if traits.track == "privileged":
            recording = process.play(scene)
        else:
            env = _seen_env(job.scenes, traits.acts_by_skills, job.feasibility, json.dumps(traits.env_keywords))
            played = scene_for(scene, traits.acts_by_skills, job.feasibility)
            recording = Recording.of(scene, env, play_scene(played, env, process))
        score = replay(job.scenes, index, recording)
        return Played(score, recording.cut(score.steps))
    except (ClutterEnvError, PolicyCrashed) as problem:
        return problem


@lru_cache(maxsize=1)
def _process(job: _Job) -> PolicyProcess:
    """The policy of a worker, made once for all scenes of a set."""
    return PolicyProcess(job.policy, job.seed, job.feasibility, job.trust, job.python, job.without)


@lru_cache(maxsize=1)
def _seen_env(scenes: SceneSet, acts_by_skills: bool, feasibility: str, keywords: str) -> gym.Env[Any, Any]:
    """The environment whose observations the policy of a worker receives."""
    return scene_for(scenes.scenes[0], acts_by_skills, feasibility).make(**json.loads(keywords))


def _replay(scenes: SceneSet, job: tuple[int, Recording]) -> Score:
    return replay(scenes, *job)


def replay(scenes: SceneSet, index: int, recording: Recording) -> Score:
    """The score of a recorded episode of a scene, in an environment that no policy has touched.

    Raises:
        SuiteError: the first state is not the one that the suite was made with.
        LearningError: the recording is not one of such a scene.
    """
    if (recording.control_mode == "skill") != (scenes.family == "skill"):
        raise LearningError(f"no recording of an episode of {scenes.name}: control mode {recording.control_mode!r}")
    return recording.replay(scenes.scenes[index], _judging_env(scenes, recording.control_mode))


def judged_in(scenes: SceneSet, control_modes: Sequence[str]) -> dict[str, Any]:
    """The digest of the environment in which recordings with these control modes are scored."""
    # Anew, because resets change the time limit.
    with closing(_judging_env.__wrapped__(scenes, (*control_modes, "joint")[0])) as env:
        return {name: part for name, part in environment_digest(env).items() if name != IMAGES}


@lru_cache(maxsize=4)
def _judging_env(scenes: SceneSet, control_mode: str) -> gym.Env[Any, Any]:
    return scenes.scenes[0].make(**({} if scenes.family == "skill" else {"control_mode": control_mode}))


def _find_floor(scenes: SceneSet, grasps: str, index: int) -> Floor:
    return find_floor(scenes.scenes[index], grasps)


class ResultRecords:
    """The scores in a file, one line per policy and scene. Those made so far are found again.

    Attributes:
        known: the `Played` or `Floor` of each key.

    Raises:
        LearningError: the file is damaged, holds something else, or its scores were made with another version. The
            message says what differs.
    """

    def __init__(self, path: Path) -> None:
        self.known: dict[str, Any] = {}
        try:
            self._file = JsonLines(path)
            header, *rows = self._file.values or [{"provenance": provenance()}]
            made_with = header.get("provenance")
            for row in rows:
                self.known[row["key"]] = (
                    Played(Score(**row["score"]), Recording.from_json(row["recording"]))
                    if "score" in row
                    else Floor(**row["floor"])
                )
        except (ValueError, KeyError, TypeError, AttributeError) as problem:
            raise LearningError(f"{path} holds no scores of this package, or it is damaged: {problem!r}") from problem
        if changed := differences(made_with, provenance()):
            raise LearningError(f"{path} cannot be continued. {' '.join(changed)} Choose another --out.")
        if not self._file.values:
            self._file.append(header)

    def add(self, key: str, result: Played | Floor) -> None:
        """Add a result, and write it to the disk. After an `OSError` the earlier results stay."""
        if isinstance(result, Floor):
            self._file.append({"key": key, "floor": result})
        elif result.recording is not None:
            self._file.append({"key": key, "score": result.score, "recording": result.recording.to_json()})
        self.known[key] = result


def _keys(job: _Job, made_with: Mapping[str, Any]) -> list[str]:
    """Identify the results of the scenes. If the policy's files, the suite or the environment changed, it plays
    again."""
    parts, wanted = (made_with["environment"], policy_files(job.policy)), job.scenes
    digests = [hashlib.sha256(json.dumps(part, sort_keys=True).encode()).hexdigest()[:16] for part in parts]
    where = f"{wanted.suite} {suite(wanted.suite).digest} {wanted.split}" if wanted.suite else ""
    policy = f"{job.policy}, seed {job.seed}, {job.feasibility}, environment {digests[0]}, files {digests[1]}"
    return [f"{where} {index if where else scene}: {policy}" for index, scene in enumerate(wanted.scenes)]
