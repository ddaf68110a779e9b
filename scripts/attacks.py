"""Ten attacks of policies on whoever verifies them: what each of them gets.

    python -m scripts.attacks

Prints the table of docs/verification.md. Every attack is a policy that is measured as any other one, by `evaluate` or
by a challenge of one scene, and writes what it has found into a file. They do no harm: nothing outside a temporary
directory is written, and nothing but this machine is connected to.
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import tyro

from clutter_env.evaluation.challenge import Checked, Ledger, check, new_challenge, play, register
from clutter_env.evaluation.evaluate import evaluate
from clutter_env.evaluation.scenes import SceneSet
from clutter_env.evaluation.tables import results
from clutter_env.reporting.files import write_json
from clutter_env.reporting.tables import markdown_table

SUITE = "all-25-v3"
"""Of whose kind the fresh scenes are: all qualify, so that a draw takes a second."""
GUESSES = 100_000
"""Nonces that are guessed."""
EASY = SceneSet(env_id="clutter_env/ArmReach-v0", count=1)
POLICIES = '''
import hashlib, json, os, random, secrets, socket, sys, time
from pathlib import Path
import numpy as np

FOUND, SIZE = Path("found.txt"), {"act": 4}


def tell(text):
    FOUND.write_text(str(text))


class Attack:
    """Does nothing for three steps, after the attack."""

    def check(self, public):
        self.size = public.action_space.shape[0]

    def reset(self, info):
        self.done, self.steps = False, 0
        try:
            self.attack()
        except Exception as problem:
            tell(f"no: {type(problem).__name__}")

    def attack(self):
        pass

    def act(self, observation):
        self.steps += 1
        self.done = self.steps == 3
        return np.zeros(self.size, np.float32)


class ParentsMemory(Attack):
    """Overwrites a byte string in the process that scores."""

    def attack(self):
        parent = os.getppid()
        for line in Path(f"/proc/{parent}/maps").read_text().splitlines():
            if "[heap]" in line:
                start = int(line.split("-")[0], 16)
                with open(f"/proc/{parent}/mem", "r+b", 0) as memory:
                    memory.seek(start)
                    old = memory.read(8)
                    memory.seek(start)
                    memory.write(old)
                tell("yes")
                return
        tell("no: no heap")


class Files(Attack):
    """Looks for the scenes to come in files of the verifier."""

    def attack(self):
        seeds = []
        for file in Path.cwd().glob("*.json"):
            content = json.loads(file.read_text())
            if "challenge" in content:
                seeds += [one["seed"] for one in content["scenes"]["test"]]
        tell("yes" if seeds else "no: no seeds")


class Sockets(Attack):
    """Asks an accomplice outside."""

    def attack(self):
        port = int(Path("port").read_text())
        with socket.create_connection(("127.0.0.1", port), 5) as line:
            tell("yes" if line.recv(3) == b"yes" else "no: no answer")


class Time(Attack):
    """Plays otherwise at another time."""

    def act(self, observation):
        return super().act(observation) + np.float32(time.time_ns() % 997 / 1000)


class Imports(Attack):
    """Imports the planner although that is refused."""

    def attack(self):
        sys.meta_path[:] = [one for one in sys.meta_path if type(one).__name__ != "_Refused"]
        import planners
        tell("yes")


class Environment(Attack):
    """Looks for a nonce in the environment, and changes the verifier's by its own."""

    def attack(self):
        os.environ["PYTHONPATH"] = "/nowhere"
        nonce = json.loads(Path("c.json").read_text())["challenge"]["nonce"]
        told = "no: it is not there; changes are those of its own process"
        tell("yes" if any(nonce in text for text in os.environ.values()) else told)


class Detects(Attack):
    """Recognises that it is being verified."""

    def attack(self):
        words = Path(f"/proc/{os.getppid()}/cmdline").read_bytes().decode(errors="replace")
        near = any("challenge" in file.read_text() for file in Path.cwd().glob("*.json"))
        tell("yes" if "clutter" in words or "attacks" in words or near else "no: nothing to be seen")


class Stores(Attack):
    """Draws random actions, and stores them by scene, so that it plays the same again."""

    def act(self, observation):
        super().act(observation)
        key = hashlib.sha256(observation["objects"].tobytes()).hexdigest()[:16]
        file = Path(f"kept-{key}-{self.steps}.json")
        if not file.exists():
            file.write_text(json.dumps([random.SystemRandom().uniform(-1, 1) for _ in range(self.size)]))
        return np.array(json.loads(file.read_text()), np.float32)


class Guesses(Attack):
    """Guesses the nonce from its hash."""

    def attack(self):
        wanted = [json.loads(line).get("commitment") for line in Path("ledger.jsonl").read_text().splitlines()]
        guesses = (k.to_bytes(32, "big") for k in range(GUESSES))
        found = any(hashlib.sha256(one).hexdigest() in wanted for one in guesses)
        tell("yes" if found else "no: not among GUESSES guesses")
'''


class Attempt(NamedTuple):
    """What an attack tried, what it got, and what that means."""

    attack: str
    holds: str
    got: str


def main() -> None:
    """Try all attacks, and print what they get."""
    with TemporaryDirectory() as folder, chdir(folder):
        Path("attacking.py").write_text(POLICIES.replace("GUESSES", str(GUESSES)))
        rows = [[one.attack, one.holds, one.got] for one in _attempts()]
    print(markdown_table(["attack", "holds", "what it got"], rows))


def _attempts() -> Iterator[Attempt]:
    got = _alone("ParentsMemory")
    yield _judged("memory of the process that scores", got, "reads and writes it, as any process of the same user")
    challenged("Files")
    yield _judged("the verifier's files", _found(), "is told no path, finds the challenge's file in its folder")
    with _Accomplice():
        got = _alone("Sockets")
    yield _judged("a socket to an accomplice", got, "is answered")
    seen = challenged("Time")
    yield Attempt(
        "the time decides", _word(not seen.is_measured), f"the same actions again in {seen.same} of {seen.again}"
    )
    challenged("Imports")
    yield _judged("the refused import of the planner", _found(), "takes the refusal away and imports it")
    challenged("Environment")
    yield _judged("the nonce in environment variables", _found(), "reads it")
    challenged("Detects")
    yield _judged("recognising the verifier", _found(), "sees the challenge's file, and who started it")
    seen = challenged("Stores")
    yield Attempt(
        "random actions stored by scene",
        _word(not seen.is_measured),
        f"the same actions again in {seen.same} of {seen.again}: what it stored is there when it is run again",
    )
    yield Attempt("weights that decode to actions", "yes", "nothing on fresh scenes: `scripts/forgeries.py`")
    challenged("Guesses")
    yield _judged("guessing the nonce from its hash", _found(), "guesses it")


def _word(holds: bool) -> str:
    return "yes" if holds else "**no**"


def _judged(attack: str, got: str, success: str) -> Attempt:
    is_won = got == "yes"
    return Attempt(attack, _word(not is_won), success if is_won else got.removeprefix("no: "))


def _found() -> str:
    return Path("found.txt").read_text()


def _alone(name: str) -> str:
    """What an attack finds that is evaluated."""
    Path("found.txt").unlink(missing_ok=True)
    evaluate(f"attacking:{name}", EASY)
    return _found()


def challenged(name: str) -> Checked:
    """What is found of an attack that is measured, on one scene."""
    for file in ("found.txt", "c.json", "ledger.jsonl"):
        Path(file).unlink(missing_ok=True)
    entry = register(f"attacking:{name}", SUITE, 1)
    new_challenge(entry, Path("ledger.jsonl"), Path("c.json"))
    write_json(Path("r.json"), results(play(Path("c.json"), Path("ledger.jsonl"))))
    assert Ledger(Path("ledger.jsonl")).draws(entry.digest)
    return check(Path("c.json"), Path("r.json"), Path("ledger.jsonl"), 1)


class _Accomplice:
    """A server that answers "yes" to whoever asks."""

    def __enter__(self) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        Path("port").write_text(str(self._server.getsockname()[1]))
        threading.Thread(target=self._answer, daemon=True).start()

    def _answer(self) -> None:
        line, _ = self._server.accept()
        with line:
            line.sendall(b"yes")

    def __exit__(self, *_: object) -> None:
        self._server.close()


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
