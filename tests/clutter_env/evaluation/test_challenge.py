"""Challenges: nobody looks scenes up, claims other people's actions, or draws until a draw suits him."""

from __future__ import annotations

import json
import pickle
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from clutter_env.cli.main import main
from clutter_env.errors import LearningError, SuiteError
from clutter_env.evaluation import challenge as challenges, policy_process
from clutter_env.evaluation.challenge import Challenge, Checked, Ledger, check, draw, new_challenge, play, register
from clutter_env.evaluation.evaluate import evaluate
from clutter_env.evaluation.policy_process import PolicyProcess
from clutter_env.evaluation.scenes import SceneSet
from clutter_env.evaluation.score import PolicyCrashed, play_scene
from clutter_env.evaluation.tables import results
from clutter_env.reporting.files import write_json
from clutter_env.suites import content_digest, suite

SUITE = "drawer-5-v1"
QUICK = "all-25-v3"
"""Of whose kind every scene qualifies, so that a draw takes a second."""
SHIPPED = Path(__file__).parents[3] / "results" / f"{SUITE}_lookahead-all.json.xz"
POLICIES = '''
import json, lzma
import numpy as np

class Idle:
    """Gives up at once."""
    def reset(self, info): self.done = False
    def act(self, observation):
        self.done = True
        return np.zeros(12, np.float32)

class LooksUp(Idle):
    """Knows a published results file: it plays the actions of the scene that begins with the same objects."""
    def __init__(self):
        from pathlib import Path
        import clutter_env
        from clutter_env.evaluation.recording import Recording
        self.known = {}
        content = json.loads(lzma.decompress(Path("published.json.xz").read_bytes()))
        for scene, values in zip(clutter_env.suite(content["suite"]).test[:2], content["recordings"]):
            env = scene.make()
            observation, _ = scene.reset(env)
            self.known[observation["objects"].tobytes()] = Recording.from_json(values).actions
    def act(self, observation):
        if not hasattr(self, "left") or self.is_first:
            self.left, self.is_first = iter(self.known.get(observation["objects"].tobytes(), ())), False
        action = next(self.left, None)
        self.done = action is None
        return np.zeros(12, np.float32) if action is None else action
    def reset(self, info):
        self.done, self.is_first = False, True

class GivesUpOnce(Idle):
    """Ends its first run by an exception, as one would that sees it go badly, and begins another."""
    def act(self, observation):
        from pathlib import Path
        if not Path("again").exists():
            Path("again").touch()
            raise RuntimeError("this goes badly")
        return super().act(observation)

class Plans(Idle):
    def __init__(self):
        import planners

class Looks(Idle):
    """Of the privileged track: it reads its own environment."""
    is_privileged = True
    def reset(self, info, env): self.size, self.done = env.action_space.shape, False
    def act(self, observation):
        self.done = True
        return np.zeros(self.size, np.float32)

class AlwaysFails(Idle):
    def act(self, observation):
        raise RuntimeError("in every scene")

class PlaysOnce(Idle):
    """Cannot be made again once it has played."""
    def __init__(self):
        from pathlib import Path
        if Path("played").exists():
            raise RuntimeError("not twice")
    def act(self, observation):
        from pathlib import Path
        Path("played").touch()
        return super().act(observation)
'''


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "mine.py").write_text(POLICIES)
    shutil.copy(SHIPPED, tmp_path / "published.json.xz")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def drawn(policy: str, number: int = 2) -> tuple[Challenge, Path, Path]:
    """A challenge of two scenes, its file, and the ledger."""
    entry = register(policy, SUITE, number)
    return new_challenge(entry, Path("ledger.jsonl"), Path("c.json")), Path("c.json"), Path("ledger.jsonl")


def checked(policy: str) -> Checked:
    """A challenge that was drawn, played and checked."""
    _, file, ledger = drawn(policy)
    write_json(Path("r.json"), results(play(file, ledger)))
    return check(file, Path("r.json"), ledger, 2)


@pytest.mark.slow
def test_what_was_played_is_measured() -> None:
    found = checked("mine:Idle")
    assert found.is_measured, found
    assert (found.clean.mean, found.draws, found.earlier, found.same, found.again) == (0.0, 1, 0, 2, 2)


def test_the_scenes_follow_from_nonce_and_entry_and_from_nothing_else() -> None:
    challenge, file, _ = drawn("mine:Idle")
    assert draw(challenge) == json.loads(file.read_text())
    others = [
        replace(challenge, nonce="00" * 32),
        replace(challenge, entry=replace(challenge.entry, policy="mine:Plans")),
    ]
    for other in others:
        assert not {*challenge.seeds[:50]} & {*other.seeds[:50]}
    first = suite(str(file)).test[0]
    assert first.floor_all is not None
    assert first.seed >= 10_000_000
    assert first.max_steps <= max(scene.max_steps for scene in suite(SUITE))


@pytest.mark.slow
def test_one_who_looks_scenes_up_wins_in_public_and_not_on_fresh_ones() -> None:
    public = evaluate("mine:LooksUp", SceneSet(SUITE, count=2))
    assert all(score.clean for score in public.scores), "or nothing is shown"
    found = checked("mine:LooksUp")
    assert (found.is_measured, found.clean.mean) == (True, 0.0)


@pytest.mark.slow
def test_other_peoples_actions_under_an_own_name_are_not_measured() -> None:
    _, file, ledger = drawn("mine:Idle")
    play(file, ledger)
    expert = evaluate("lookahead-all", SceneSet(str(file)))
    assert all(score.clean for score in expert.scores)
    forged = replace(expert, policy="mine:Idle", weights={}, traits=replace(expert.traits, track="observations"))
    write_json(Path("r.json"), results(forged))
    found = check(file, Path("r.json"), ledger, 2)
    assert found.replay.is_confirmed, "the actions are good ones"
    assert (found.is_measured, found.same) == (False, 0)
    main(["leaderboard", "r.json", "--workers=1", f"--ledger={ledger}"])
    measured, claimed = Path("outputs/leaderboard/leaderboard.md").read_text().split("## Claimed")
    assert "mine:Idle" not in measured
    assert "mine:Idle" in claimed


def test_files_that_changed_after_the_draw_are_refused() -> None:
    _, file, ledger = drawn("mine:Idle")
    Path("mine.py").write_text(f"{POLICIES}\n# better\n")
    with pytest.raises(LearningError, match="not those that were registered"):
        play(file, ledger)


@pytest.mark.slow
def test_who_draws_twice_is_counted_twice_and_plays_once() -> None:
    drawn("mine:Idle")
    _, file, ledger = drawn("mine:Idle")
    played = play(file, ledger)
    with pytest.raises(LearningError, match="has been played"):
        play(file, ledger)
    write_json(Path("r.json"), results(played))
    found = check(file, Path("r.json"), ledger, 1)
    assert found.draws == 2
    assert found.clean.high == pytest.approx(challenges.wilson(0, 4).high)
    Path("mine.py").write_text(f"{POLICIES}\n# better\n")
    challenge, *_ = drawn("mine:Idle")
    assert Ledger(ledger).entries_before(challenge.entry) == 1


def test_of_two_challenges_under_one_name_the_one_that_was_played_first_ranks(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Otherwise whoever makes the leaderboard gives the better of them."""
    ledger = Path("ledger.jsonl")
    for number in (1, 2):
        new_challenge(register("mine:Idle", QUICK, number), ledger, Path(f"c{number}.json"))
    for number in (2, 1):
        write_json(Path(f"r{number}.json"), results(play(Path(f"c{number}.json"), ledger)))
    assert Ledger(ledger).first_started("mine:Idle", QUICK) == challenges.read_challenge(Path("c2.json")).commitment
    assert Ledger(ledger).first_started("mine:Idle", "side-15-v3") is None
    main(["leaderboard", "r1.json", "r2.json", "--workers=1", f"--ledger={ledger}", "--json=entries.json"])
    found = {entry["file"]: entry["is_measured"] for entry in json.loads(Path("entries.json").read_text())}
    assert found == {"r1.json": False, "r2.json": True}
    capsys.readouterr()
    main(["leaderboard", "r1.json", "--workers=1", f"--ledger={ledger}"])
    assert "None." in capsys.readouterr().out.split("## Claimed")[0]


@pytest.mark.slow
def test_a_changed_file_of_scenes_and_a_draw_that_no_ledger_knows_are_found() -> None:
    challenge, file, ledger = drawn("mine:Idle")
    write_json(Path("r.json"), results(play(file, ledger)))
    found = check(file, Path("r.json"), Path("other.jsonl"), 1)
    assert found.problems == ("the draw is not in the ledger",)
    easier = draw(replace(challenge, nonce="11" * 32))
    content = {**easier, "challenge": json.loads(file.read_text())["challenge"]}
    content["sha256"] = challenges.suite_content(challenges._plan(SUITE), "", {})["sha256"]
    file.write_text(json.dumps(content))
    assert "the scenes are not those" in check(file, Path("r.json"), ledger, 0).problems[0]


@pytest.mark.slow
def test_results_of_other_scenes_in_a_file_of_the_same_name_are_not_measured() -> None:
    challenge, file, ledger = drawn("mine:Idle")
    play(file, ledger)
    fresh, easy = json.loads(file.read_text()), draw(replace(challenge, nonce="11" * 32))
    content = {**easy, "name": fresh["name"], "challenge": fresh["challenge"]}
    content["scenes"] = {"test": [fresh["scenes"]["test"][0], easy["scenes"]["test"][1]], "validation": []}
    content.pop("sha256")
    Path("elsewhere").mkdir()
    other = Path("elsewhere", file.name)
    other.write_text(json.dumps({**content, "sha256": content_digest(content)}))
    write_json(Path("r.json"), results(evaluate("mine:Idle", SceneSet(str(other)))))
    found = check(file, Path("r.json"), ledger, 1)
    assert found.replay.is_confirmed, "the scores are those of the other scenes"
    assert not found.is_measured
    assert any("other scenes" in one for one in found.problems)


@pytest.mark.slow
def test_other_peoples_actions_after_the_scenes_that_are_played_again_are_not_measured() -> None:
    _, file, ledger = drawn("mine:Idle")
    mine = play(file, ledger)
    expert = evaluate("lookahead-all", SceneSet(str(file)))
    forged = replace(mine, episodes=(mine.episodes[0], expert.episodes[1]))
    write_json(Path("r.json"), results(forged))
    found = check(file, Path("r.json"), ledger, 1)
    assert found.replay.is_confirmed
    assert found.same == 1, "the policy plays the first scene as the file says"
    assert not found.is_measured
    assert found.problems == ("the results are not those that the ledger says were played",)


@pytest.mark.slow
def test_a_policy_that_has_changed_since_is_not_run_again() -> None:
    _, file, ledger = drawn("mine:Idle")
    write_json(Path("r.json"), results(play(file, ledger)))
    Path("mine.py").write_text(f"{POLICIES}\n# better\n")
    found = check(file, Path("r.json"), ledger, 1)
    assert (found.is_measured, found.same) == (False, None)
    assert found.problems == ("the policy's files here are not those that were registered",)


@pytest.mark.slow
def test_results_that_no_run_in_the_ledger_has_made_are_not_measured() -> None:
    _, file, ledger = drawn("mine:Idle")
    write_json(Path("r.json"), results(evaluate("mine:Idle", SceneSet(str(file)))))
    found = check(file, Path("r.json"), ledger, 1)
    assert not found.is_measured
    assert found.problems == ("the results are not those that the ledger says were played",)


@pytest.mark.parametrize(
    "changed",
    [
        {"nonce": "no hexadecimal number"},
        {"nonce": "12"},
        {"nonce": None},
        {"entry": {"policy": "mine:Idle", "files": [], "suite": SUITE, "scenes": 2}},
        {"entry": {"policy": "mine:Idle", "files": {}, "suite": SUITE, "scenes": "2"}},
        {"entry": {"policy": "mine:Idle", "files": {}, "suite": SUITE, "scenes": 0}},
        {"entry": {"policy": "mine:Idle", "files": {}, "suite": 3, "scenes": 2}},
    ],
)
def test_a_challenge_with_other_kinds_of_values_is_none(changed: dict[str, object]) -> None:
    entry = {"policy": "mine:Idle", "files": {}, "suite": SUITE, "scenes": 2}
    Path("c.json").write_text(json.dumps({"challenge": {"entry": entry, "nonce": "11" * 32, **changed}}))
    with pytest.raises(LearningError, match="no file of"):
        challenges.read_challenge(Path("c.json"))


@pytest.mark.slow
def test_runs_that_were_ended_and_begun_again_are_told() -> None:
    _, file, ledger = drawn("mine:GivesUpOnce", 1)
    with pytest.raises(PolicyCrashed, match="goes badly"):
        play(file, ledger)
    write_json(Path("r.json"), results(play(file, ledger)))
    assert check(file, Path("r.json"), ledger, 1).starts == 2


@pytest.mark.slow
def test_counted_exceptions_are_checked_as_any_other_failure() -> None:
    _, file, ledger = drawn("mine:AlwaysFails")
    write_json(Path("r.json"), results(play(file, ledger, count_crashes=True)))
    found = check(file, Path("r.json"), ledger, 2)
    assert found.is_measured
    assert (found.same, found.clean.mean) == (2, 0.0)


@pytest.mark.slow
def test_a_policy_that_cannot_be_run_again_is_not_measured_and_ends_no_leaderboard(
    capsys: pytest.CaptureFixture[str],
) -> None:
    _, file, ledger = drawn("mine:PlaysOnce")
    write_json(Path("r.json"), results(play(file, ledger)))
    found = check(file, Path("r.json"), ledger, 2)
    assert not found.is_measured
    assert any("cannot be run again" in one and "not twice" in one for one in found.problems)
    main(["leaderboard", "r.json", "--workers=1", f"--ledger={ledger}"])
    assert "mine:PlaysOnce" in capsys.readouterr().out.split("## Claimed")[1].split("Confirmed")[0]


@pytest.mark.slow
def test_results_on_an_own_file_of_scenes_are_claimed() -> None:
    _, file, ledger = drawn("mine:Idle")
    content = json.loads(file.read_text())
    content.pop("challenge")
    content.pop("sha256")
    Path("own.json").write_text(json.dumps({**content, "sha256": content_digest(content)}))
    write_json(Path("r.json"), results(evaluate("mine:Idle", SceneSet("own.json"))))
    main(["leaderboard", "r.json", "--workers=1", f"--ledger={ledger}", "--json=entries.json"])
    (entry,) = json.loads(Path("entries.json").read_text())
    assert (entry["problem"], entry["is_measured"]) == ("", False)


@pytest.mark.parametrize("policy", ["mine:Idle", "mine:Looks"])
def test_the_policys_process_is_told_neither_the_challenges_file_nor_other_scenes(
    policy: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = Path("c.json")
    challenge = new_challenge(register(policy, QUICK, 2), Path("ledger.jsonl"), file)
    sent = list[bytes]()
    send = policy_process._send

    def noting(stream: Any, content: bytes) -> None:
        sent.append(content)
        send(stream, content)

    monkeypatch.setattr(policy_process, "_send", noting)
    process = PolicyProcess(policy, 0, "oracle")
    scenes = SceneSet(str(file.absolute()))
    if policy == "mine:Looks":
        process.play(scenes.scenes[0])
    else:
        play_scene(scenes.scenes[0], scenes.scenes[0].make(), process)
    process.close()
    told = b"".join(sent)
    assert b"c.json" not in told
    assert challenge.nonce.encode() not in told
    assert not any(pickle.dumps(scene.seed)[2:-1] in told for scene in scenes.scenes[1:])


def test_a_planner_that_was_not_declared_is_refused() -> None:
    with pytest.raises(PolicyCrashed, match="uses the planner"):
        PolicyProcess("mine:Plans", 0, "oracle", without=challenges.PLANNER)
    process = PolicyProcess("mine:Plans", 0, "oracle")
    process.close()


def test_misuse_is_a_clear_error() -> None:
    with pytest.raises(SuiteError, match="suites: side-15-v3"):
        register("mine:Idle", "side-15", 2)
    with pytest.raises(LearningError, match="has no files here"):
        register("elsewhere:Idle", SUITE, 2)
    with pytest.raises(LearningError, match="scenes=0"):
        register("mine:Idle", SUITE, 0)
    Path("ledger.jsonl").write_text('{"a": 1}\n')
    with pytest.raises(LearningError, match="no ledger"):
        Ledger(Path("ledger.jsonl"))
    with pytest.raises(LearningError, match="no file of"):
        challenges.read_challenge(Path("mine.py"))


def test_the_commands(capsys: pytest.CaptureFixture[str]) -> None:
    ledger = "--ledger=l.jsonl"
    policy = ["--policy=mine:Idle", f"--suite={SUITE}", "--scenes=1"]
    main(["challenge", "new", *policy, "--out=c.json", "--workers=1", ledger])
    main(["challenge", "run", "c.json", "--workers=1", ledger])
    main(["challenge", "check", "c.json", "c_results.json", "--again=1", "--workers=1", ledger])
    said = capsys.readouterr().out
    assert "measured mine:Idle" in said
    assert "draws of this entry: 1\n" in said
    with pytest.raises(SystemExit):
        main(["challenge", "check", "c.json", "c_results.json", "--again=0", "--workers=1", ledger])
    assert "the policy was not run again" in capsys.readouterr().out
    main(["leaderboard", "c_results.json", "--workers=1", ledger])
    measured, claimed = capsys.readouterr().out.split("## Claimed")
    assert "mine:Idle" in measured
    assert "mine:Idle" not in claimed.split("Confirmed")[0]
