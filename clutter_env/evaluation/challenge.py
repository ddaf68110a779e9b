"""Challenges: fresh scenes of a suite's kind, drawn by whoever verifies after the entrant's files are known.

1. The verifier registers an entry: the policy's name and the SHA-256 of its files. Its digest goes into the ledger.
2. He draws a nonce, and writes its SHA-256 into the ledger. The scenes follow from SHA-256 of nonce and entry, by the
   suite's own rules for what qualifies: neither side could choose them.
3. He plays the policy on them. The nonce stands in the challenge's file, which is published with the results.
4. Anyone draws the scenes again from the nonce, replays the recorded actions, and runs the policy again.

Every draw in the ledger counts: the scenes of all other draws of the entry are failures, whether they were played or
not. Who may draw again and again, and
shows the best, reaches 0.81 with a policy of 0.70.
"""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from clutter_env.errors import LearningError, SuiteError
from clutter_env.evaluation.evaluate import Evaluation, evaluate
from clutter_env.evaluation.scenes import SceneSet
from clutter_env.evaluation.score import PolicyCrashed
from clutter_env.evaluation.suite_making import MOST_TRIED, PLANS, file_text, qualifying, suite_content
from clutter_env.evaluation.tables import results as results_of
from clutter_env.evaluation.verify import Verification, read_results, verify
from clutter_env.policies.protocol import PolicyError
from clutter_env.policies.registry import BUILT_IN, policy_files
from clutter_env.reporting.files import JsonLines, read_json, write_atomically
from clutter_env.reporting.intervals import Interval, wilson

PLANNER = ("planners",)
"""Packages that a policy may import only if its entry declares it."""
_SEEDS = range(10_000_000, 2**31)
"""Fresh scenes have seeds from these, after those of all suites."""
_NONCE = 32
"""Bytes of a nonce."""
_KINDS = {"policy": str, "files": dict, "suite": str, "scenes": int, "uses_planner": bool}
"""Types of an entry's fields in a file."""


@dataclass(frozen=True)
class Entry:
    """A policy that is to be measured, as it was registered.

    Attributes:
        policy: its name, as for `clutter-env evaluate`.
        files: SHA-256 of its files, by their names.
        suite: name of the suite whose kind of scenes it plays.
        scenes: how many.
        uses_planner: whether it declares that it imports the package's planner.
    """

    policy: str
    files: Mapping[str, str]
    suite: str
    scenes: int
    uses_planner: bool = False

    @property
    def digest(self) -> str:
        """SHA-256 of all that."""
        return hashlib.sha256(json.dumps(asdict(self), sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class Challenge:
    """An entry, and the nonce that was drawn for it.

    Attributes:
        entry: that was registered before.
        nonce: 64 hexadecimal digits.
    """

    entry: Entry
    nonce: str

    @property
    def commitment(self) -> str:
        """SHA-256 of the nonce: what the ledger says of it before it is revealed."""
        return hashlib.sha256(bytes.fromhex(self.nonce)).hexdigest()

    @property
    def seeds(self) -> list[int]:
        """Seeds of scenes, which qualify or not, in their order."""
        secret, entry = bytes.fromhex(self.nonce), bytes.fromhex(self.entry.digest)
        hashes = (hashlib.sha256(secret + entry + k.to_bytes(4, "big")).digest() for k in range(MOST_TRIED))
        return [_SEEDS[int.from_bytes(one[:8], "big") % len(_SEEDS)] for one in hashes]


@dataclass(frozen=True)
class Checked:
    """Findings about a challenge's results.

    Attributes:
        challenge: which one.
        replay: of the recorded actions.
        problems: one sentence for everything that is not as it should be.
        same: of the scenes that the policy played again, those with the same actions. None if it was not run.
        again: scenes that it played again.
        draws: of this entry in the ledger. The scenes of all other draws are failures.
        starts: how often the draw has begun to be played. More than once if runs ended before their last scene.
        earlier: other entries under the policy's name for this suite, in the ledger before this one.
        clean: clean success over all draws.
    """

    challenge: Challenge
    replay: Verification
    problems: tuple[str, ...]
    same: int | None
    again: int
    draws: int
    starts: int
    earlier: int
    clean: Interval

    @property
    def is_measured(self) -> bool:
        """Whether the figure stands in the table of what was measured: fresh scenes, replayed, the policy run again."""
        return not self.problems and self.replay.is_confirmed and self.same == self.again > 0


def register(policy: str, suite: str, scenes: int, files: Sequence[Path] = (), uses_planner: bool = False) -> Entry:
    """The entry of a policy, with the digests of its files as they are now.

    Args:
        policy: a name for `clutter-env evaluate`.
        suite: name of a suite of the package.
        scenes: how many it will play.
        files: more files that it is made of, such as modules that its module imports, and weights.
        uses_planner: see `Entry`.

    Raises:
        SuiteError: there is no such suite.
        LearningError: the policy has no files, or they have the same names.
        OSError: a file cannot be read.
    """
    _plan(suite)
    if scenes < 1:
        raise LearningError(f"scenes={scenes} is not valid; it must be at least 1")
    return Entry(policy, _digests(policy, files), suite, scenes, uses_planner)


def _digests(policy: str, files: Sequence[Path]) -> dict[str, str]:
    known = policy_files(policy)
    for path in files:
        if path.name in known:
            raise LearningError(f"two files are named {path.name}; the entry names each by its name alone")
        known[path.name] = hashlib.sha256(path.read_bytes()).hexdigest()
    if not known and policy not in BUILT_IN:
        raise LearningError(f"policy {policy!r} has no files here that can be registered; name them with --files")
    return known


def _plan(suite: str) -> Any:
    plans = {plan.name: plan for plan in PLANS}
    if suite not in plans:
        raise SuiteError(f"no suite {suite!r} of which fresh scenes can be drawn; suites: {', '.join(plans)}")
    return plans[suite]


def draw(challenge: Challenge, workers: int = 1, tick: Callable[[], object] = lambda: None) -> dict[str, Any]:
    """The content of the challenge's file: that of a suite, with the entry and the nonce.

    Raises:
        SuiteError: too few of the seeds qualify.
    """
    entry = challenge.entry
    plan = _plan(entry.suite)
    scenes = qualifying(plan.rules, challenge.seeds, entry.scenes, workers, tick)
    name = f"{entry.suite} fresh {challenge.commitment[:8]}"
    return suite_content(plan, name, {"test": scenes, "validation": []}, challenge=asdict(challenge))


def new_challenge(
    entry: Entry, ledger: Path, file: Path, workers: int = 1, tick: Callable[[], object] = lambda: None
) -> Challenge:
    """Draw a nonce for an entry, write both into the ledger, and the scenes into a file. See the module's text.

    Raises:
        OSError: a file cannot be written. What is in the ledger by then counts.
    """
    challenge, book = Challenge(entry, secrets.token_hex(_NONCE)), Ledger(ledger)
    book.note_draw(challenge)
    write_atomically(file, file_text(draw(challenge, workers, tick)).encode())
    return challenge


def read_challenge(file: Path) -> Challenge:
    """The challenge of a file.

    Raises:
        LearningError: it is no such file.
    """
    try:
        content = read_json(file)["challenge"]
        found = Challenge(Entry(**content["entry"]), content["nonce"])
        if len(bytes.fromhex(found.nonce)) != _NONCE:
            raise ValueError(f"nonce={found.nonce!r}")
        for name, kind in _KINDS.items():
            if type(getattr(found.entry, name)) is not kind:
                raise TypeError(f"{name}={getattr(found.entry, name)!r}")
        if found.entry.scenes < 1:
            raise ValueError(f"scenes={found.entry.scenes}")
        return found
    except (OSError, ValueError, KeyError, TypeError) as problem:
        raise LearningError(f"{file} is no file of `clutter-env challenge new`: {problem!r}") from problem


def play(file: Path, ledger: Path, files: Sequence[Path] = (), **chosen: Any) -> Evaluation:
    """Play a challenge with its policy, whose files must be those that were registered, and note it in the ledger.

    Args:
        file: the challenge's.
        ledger: of the draw.
        files: as of `register`.
        chosen: more arguments of `clutter_env.evaluation.evaluate.evaluate`.

    Raises:
        LearningError: the policy's files have changed, or the draw is not in the ledger, or was played already.
    """
    challenge, book = read_challenge(file), Ledger(ledger)
    entry = challenge.entry
    if _digests(entry.policy, files) != entry.files:
        raise LearningError(f"the files of {entry.policy} are not those that were registered; register them anew")
    if challenge.commitment not in book.draws(entry.digest):
        raise LearningError(f"{ledger} knows nothing of the draw of {file}")
    if challenge.commitment in book.played:
        raise LearningError(f"{file} has been played: {ledger} says so. Each draw is played once")
    book.note_started(challenge)
    found = _evaluated(challenge, file, entry.scenes, **chosen)
    book.note_played(challenge, found.num_clean, results_of(found)["digest"])
    return found


def _evaluated(challenge: Challenge, file: Path, count: int, **chosen: Any) -> Evaluation:
    without = () if challenge.entry.uses_planner else PLANNER
    return evaluate(challenge.entry.policy, SceneSet(str(file), count=count), without=without, **chosen)


def check(
    file: Path,
    results: Path,
    ledger: Path,
    again: int = 10,
    *,
    workers: int = 1,
    tick: Callable[[], object] = lambda: None,
    **chosen: Any,
) -> Checked:
    """Draw a challenge's scenes again, replay its results, and run the policy again on the first scenes.

    Args:
        file, results, ledger: the challenge, its results file, and the verifier's ledger.
        again: scenes that the policy plays again. With 0 nothing is measured.
        workers: number of processes.
        tick: called after every episode that is replayed.
        chosen: more arguments of `clutter_env.evaluation.evaluate.evaluate`.

    Raises:
        LearningError: a file is none of its kind.
    """
    challenge, content, book = read_challenge(file), read_results(results), Ledger(ledger)
    entry = challenge.entry
    problems, drawn = [], read_json(file)
    if draw(challenge, workers) != drawn:
        problems.append("the scenes are not those that follow from nonce and entry")
    if Path(content["suite"]).name != file.name or content["policy"] != entry.policy:
        problems.append(f"the results are of {content['policy']} on {content['suite']}, not of this challenge")
    elif content.get("suite_sha256") != drawn.get("sha256"):
        problems.append(f"the results are of other scenes, those of {content['suite']}")
    if content["weights"] and not content["weights"].items() <= entry.files.items():
        problems.append("the policy's files are not those that were registered")
    if not policy_files(entry.policy).items() <= entry.files.items():
        problems.append("the policy's files here are not those that were registered")
    if len(content["episodes"]) < entry.scenes:
        problems.append(f"{len(content['episodes'])} of {entry.scenes} scenes were played")
    draws = book.draws(entry.digest)
    if challenge.commitment not in draws:
        problems.append("the draw is not in the ledger")
    replayed = _replayed(results, content, workers, tick)
    same = None
    if again and not problems:
        try:  # exceptions count as in `run --count-crashes`: who ends with one there does so here
            found = _evaluated(challenge, file, min(again, entry.scenes), workers=workers, **chosen, count_crashes=True)
        except (PolicyCrashed, PolicyError) as problem:
            problems.append(f"the policy cannot be run again: {problem}")
        else:
            digests = [one.recording.digest if one.recording else "" for one in found.episodes]
            claims = content["episodes"]
            same = sum(digest == claim["actions"] for digest, claim in zip(digests, claims, strict=False))
    if challenge.commitment in draws and content["digest"] != book.played.get(challenge.commitment):
        problems.append("the results are not those that the ledger says were played")
    clean = wilson(replayed.clean, max(len(draws), 1) * entry.scenes)
    earlier = book.entries_before(entry)
    counted = min(again, entry.scenes)
    starts = book.starts(challenge)
    return Checked(challenge, replayed, tuple(problems), same, counted, len(draws), starts, earlier, clean)


def _replayed(results: Path, content: Mapping[str, Any], workers: int, tick: Callable[[], object]) -> Verification:
    """The replay of results. If their scenes cannot be read, this is the problem found."""
    try:
        return verify(results, workers, tick)
    except SuiteError as problem:
        played = content["policy"], content["track"], content["suite"], len(content["episodes"])
        return Verification(*played, clean=0, differences=(str(problem),), other_than=())


class Ledger:
    """A verifier's file of everything that was registered, drawn and played, one JSON value a line.

    Raises:
        LearningError: the file is no ledger.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._lines = JsonLines(path)
            self._rows: list[tuple[str, Mapping[str, Any]]] = [(row["kind"], row) for row in self._lines.values]
        except (ValueError, KeyError, TypeError) as problem:
            raise LearningError(f"{path} is no ledger of challenges: {problem!r}") from problem

    def note_draw(self, challenge: Challenge) -> None:
        """Write the entry, if it is new, and the draw, before anybody knows the nonce."""
        entry = challenge.entry
        if not any(kind == "entry" and row["digest"] == entry.digest for kind, row in self._rows):
            self._append("entry", digest=entry.digest, **asdict(entry))
        self._append("draw", entry=entry.digest, commitment=challenge.commitment)

    def note_started(self, challenge: Challenge) -> None:
        """Write that a draw begins to be played: who ends a run that goes badly, and begins again, is seen."""
        self._append("started", commitment=challenge.commitment)

    def starts(self, challenge: Challenge) -> int:
        """Number of times that a draw has begun to be played."""
        return sum(kind == "started" and row["commitment"] == challenge.commitment for kind, row in self._rows)

    def first_started(self, policy: str, suite: str) -> str | None:
        """The commitment of the first draw that began to be played, of all entries of a policy's name for a suite."""
        of = {
            row["digest"]
            for kind, row in self._rows
            if kind == "entry" and (row["policy"], row["suite"]) == (policy, suite)
        }
        drawn = {row["commitment"] for kind, row in self._rows if kind == "draw" and row["entry"] in of}
        started = (row["commitment"] for kind, row in self._rows if kind == "started")
        return next((commitment for commitment in started if commitment in drawn), None)

    def note_played(self, challenge: Challenge, clean: int, digest: str) -> None:
        """Write that a draw has been played, and the digest of its results."""
        self._append("played", commitment=challenge.commitment, clean=clean, digest=digest)

    def draws(self, entry: str) -> list[str]:
        """The commitments of all draws of an entry, named by its digest."""
        return [row["commitment"] for kind, row in self._rows if kind == "draw" and row["entry"] == entry]

    @property
    def played(self) -> dict[str, str]:
        """The digests of the results of the draws that were played, by their commitments. "" if none was noted."""
        return {row["commitment"]: row.get("digest", "") for kind, row in self._rows if kind == "played"}

    def entries_before(self, entry: Entry) -> int:
        """Number of earlier entries of a policy of that name for that suite."""
        found = 0
        for kind, row in self._rows:
            if kind == "entry" and row["digest"] == entry.digest:
                break
            found += kind == "entry" and (row["policy"], row["suite"]) == (entry.policy, entry.suite)
        return found

    def _append(self, kind: str, **values: Any) -> None:
        self._lines.append({"kind": kind, **values})
        self._rows.append((kind, self._lines.values[-1]))
