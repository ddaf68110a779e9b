"""A policy in a process of its own, so that it cannot reach the environment by which it is scored.

One of the observations track receives observations and public information, and answers with actions. One of the
privileged track plays in an environment of its own, and answers with the recording of the episode. What comes back is
JSON: nothing that a policy returns is executed or unpickled.

The process is no sandbox: a policy has the rights of the user who runs it.
"""

from __future__ import annotations

import json
import math
import os
import pickle
import signal
import struct
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import replace
from importlib.abc import MetaPathFinder
from typing import Any, BinaryIO, NamedTuple

import gymnasium as gym
import numpy as np

from clutter_env.errors import LearningError
from clutter_env.evaluation.recording import Recording
from clutter_env.evaluation.scenes import Scene, scene_for
from clutter_env.evaluation.score import PolicyCrashed, play_scene
from clutter_env.parallel import POLL_INTERVAL
from clutter_env.policies.protocol import PolicyError, PublicInfo, check_public
from clutter_env.policies.registry import PolicyTraits, load_policy

ANSWER_LIMIT = 3600.0
"""[s] of wall time after which a policy that does not answer counts as crashed. An answer is an action, or of the
privileged track a whole episode. The limit ends what hangs. It is too long to decide any result."""
_MOST_BYTES = 2**26
"""Longest answer that is read."""
_MOST_NUMBERS = 10_000
"""Of an action. The largest robot has 19."""
_LENGTH = struct.Struct("!Q")


class _Answer(NamedTuple):
    """The content of an answer: a value, or the text of a refusal or of a crash."""

    value: Any = None
    done: bool = False
    failure: str = ""
    refusal: str | None = None
    crash: str | None = None

    @classmethod
    def of(cls, content: Any) -> _Answer:
        """Read an answer. Raises `KeyError` or `TypeError` for anything else."""
        if "refusal" in content:
            return cls(refusal=str(content["refusal"]))
        if "crash" in content:
            return cls(crash=str(content["crash"]))
        return cls(content["value"], bool(content["done"]), str(content["failure"]))


class PolicyProcess:
    """The process of a policy. It is itself a policy of the observations track, with `play` for the privileged one.

    Attributes:
        traits: what the policy is: its track, the environment that it wants, whether it acts by skills.
        done, failure: of the policy, after its last action.
        has_ended: after an exception of the policy, the end of its process, or `close`.

    Raises:
        PolicyError: there is no such policy.
        PolicyCrashed: its code raised an exception.
    """

    def __init__(
        self,
        policy: str,
        seed: int,
        feasibility: str,
        trust: bool = False,
        python: str = "",
        without: tuple[str, ...] = (),
    ) -> None:
        # Not one of multiprocessing's own processes: those of a worker of loky's cannot start any. In a session of its
        # own, it does not get the terminal's Ctrl-C, and ends together with the processes that it has started.
        self._process = subprocess.Popen(
            [sys.executable, "-X", "faulthandler", "-c", f"from {__name__} import serve; serve()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        )
        self.done, self.failure, self.has_ended, self._deadline = False, "", False, math.inf
        threading.Thread(target=self._watch, daemon=True).start()
        values = self._ask("load", (os.getpid(), policy, seed, feasibility, trust, python, without))
        try:
            self.traits = PolicyTraits.read(values)
        except PolicyError:
            self.close()
            raise

    def check(self, public: PublicInfo) -> None:
        """Send the public information of the next episode."""
        self._ask("check", public)

    def reset(self, info: Mapping[str, Any]) -> None:
        """Start an episode."""
        self._ask("reset", dict(info))

    def act(self, observation: Any) -> Any:
        """The next action."""
        return self._ask("act", observation)

    def play(self, scene: Scene) -> Recording:
        """The recording of an episode of a privileged policy, in an environment of its own.

        It is told this scene alone: of the others, and of the file in which they stand, it learns nothing by it.
        """
        started = time.perf_counter()
        answer = self._ask("play", _picklable(scene))
        try:
            return Recording.from_json({**answer, "wall_s": time.perf_counter() - started})
        except (LearningError, TypeError) as problem:
            raise self._crash(f"{self.traits.place} gave {problem}") from None

    def close(self) -> None:
        """End the process, and those that it has started."""
        self.has_ended = True
        self._end()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            assert stream is not None
            with suppress(OSError):
                stream.close()

    def _watch(self) -> None:
        """End a process that is late, and what is left of one that has died: its forks keep the answers' pipe open."""
        while self._process.poll() is None:
            time.sleep(POLL_INTERVAL)
            if time.monotonic() > self._deadline:
                self._end()
        self._end_group()

    def _end(self) -> None:
        if self._process.returncode is None:  # otherwise its number may be that of another one by now
            self._end_group()
            self._process.kill()

    def _end_group(self) -> None:
        if hasattr(os, "killpg"):
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, signal.SIGKILL)

    def _ask(self, call: str, argument: Any) -> Any:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._deadline = time.monotonic() + ANSWER_LIMIT
        try:
            _send(self._process.stdin, pickle.dumps((call, argument)))
            answer = _Answer.of(json.loads(_receive(self._process.stdout)))
        except (OSError, EOFError):
            raise self._crash(self._how_it_ended()) from None
        except (ValueError, KeyError, TypeError, RecursionError) as problem:
            raise self._crash(f"the policy's process answered with something else than an answer: {problem}") from None
        finally:
            self._deadline = math.inf
        if answer.refusal is not None:
            self.close()
            raise PolicyError(answer.refusal)
        if answer.crash is not None:
            raise self._crash(answer.crash)
        self.done, self.failure = answer.done, answer.failure
        return answer.value

    def _crash(self, text: str) -> PolicyCrashed:
        self.close()
        return PolicyCrashed(text)

    def _how_it_ended(self) -> str:
        if time.monotonic() > self._deadline:
            return f"the policy gave no answer within {ANSWER_LIMIT:.0f} s"
        try:
            code = self._process.wait(POLL_INTERVAL)
        except subprocess.TimeoutExpired:
            return "the policy's process closed the file of its answers, and goes on running"
        by = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        return f"the policy's process {by}"


def serve() -> None:
    """Answer as the process of a policy, until the other side closes the connection."""
    calls, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb", 0)
    # What a policy prints is shown on the error stream; nothing that it reads or prints is part of a call or an answer.
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    host: _Host | None = None
    while True:
        try:
            call, argument = pickle.loads(_receive(calls))  # noqa: S301  # from the process that started this one
        except (EOFError, OSError):
            _end_own_group()
        try:
            if host is None:
                parent, *arguments = argument
                threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
                host, argument = _Host(*arguments), None
            answer = {"value": host.answer(call, argument), "done": host.is_done, "failure": host.failure}
            content = json.dumps(answer)
        except PolicyError as problem:
            content = json.dumps({"refusal": str(problem)})
        except BaseException:  # sys.exit() too is told with its traceback
            content = json.dumps({"crash": traceback.format_exc()})
        try:
            _send(answers, content.encode())
        except OSError:
            _end_own_group()


def _picklable(scene: Scene) -> Scene:
    """The scene with plain dictionaries, which can be pickled."""
    plain: dict[str, Any] = {name: dict(value) for name, value in vars(scene).items() if isinstance(value, Mapping)}
    return replace(scene, **plain)


def _send(stream: Any, content: bytes) -> None:
    data = memoryview(_LENGTH.pack(len(content)) + content)
    while data:
        data = data[stream.write(data) :]
    stream.flush()


def _receive(stream: BinaryIO | Any) -> bytes:
    (length,) = _LENGTH.unpack(_read(stream, _LENGTH.size))
    if length > _MOST_BYTES:
        raise ValueError(f"{length} bytes")
    return _read(stream, length)


def _read(stream: BinaryIO | Any, count: int) -> bytes:
    content = stream.read(count)
    if len(content) < count:
        raise EOFError
    return bytes(content)


def _end_own_group() -> None:
    if hasattr(os, "killpg"):
        os.killpg(0, signal.SIGKILL)
    os._exit(1)


def _end_with(parent: int) -> None:
    """End when the evaluation has been killed, also in the middle of an action."""
    while os.getppid() == parent:
        time.sleep(POLL_INTERVAL)
    _end_own_group()


class _Refused(MetaPathFinder):
    """Refuses the import of modules, and of all that is in them, and forgets those that are loaded."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = tuple(names)
        for loaded in [module for module in sys.modules if self._has(module)]:
            del sys.modules[loaded]

    def _has(self, module: str) -> bool:
        return any(f"{module}.".startswith(f"{name}.") for name in self._names)

    def find_spec(self, fullname: str, path: object = None, target: object = None) -> None:  # noqa: ARG002  the finder's protocol
        """Refuse a module, or leave it to the other finders."""
        if self._has(fullname):
            raise ImportError(
                f"{fullname} may not be imported by a policy whose entry does not declare that it uses the planner; "
                "clutter-env challenge new --uses-planner does"
            )


class _Host:
    """The policy inside its process."""

    def __init__(
        self, name: str, seed: int, feasibility: str, trust: bool, python: str, without: tuple[str, ...]
    ) -> None:
        if without:
            sys.meta_path.insert(0, _Refused(without))
        self._policy, self._feasibility = load_policy(name, seed, trust, python), feasibility
        self._traits = PolicyTraits.of(self._policy)
        self._env: gym.Env[Any, Any] | None = None
        self._env_of: Any = None

    @property
    def is_done(self) -> bool:
        return bool(getattr(self._policy, "done", False))

    @property
    def failure(self) -> str:
        return str(getattr(self._policy, "failure", ""))

    def answer(self, call: str, argument: Any) -> Any:
        policy: Any = self._policy
        if call == "load":
            return vars(self._traits)
        if call == "check":
            return check_public(policy, argument)
        if call == "reset":
            policy.reset(argument)
            return None
        if call == "act":
            action = np.asarray(policy.act(argument))
            if action.dtype.kind not in "fiub" or action.size > _MOST_NUMBERS:
                raise TypeError(f"act() returned no action but {action.dtype} numbers of shape {action.shape}")
            return action.tolist()
        return self._play(argument).to_json()

    def _play(self, scene: Scene) -> Recording:
        played = scene_for(scene, self._traits.acts_by_skills, self._feasibility)
        if self._env is None or self._env_of != (played.env_id, played.keywords):
            self._env, self._env_of = played.make(**self._traits.env_keywords), (played.env_id, played.keywords)
        # Planners announce their own compilation.
        announced = _announced_compilation() if self._traits.acts_by_skills else nullcontext()
        with announced:
            return Recording.of(scene, self._env, play_scene(played, self._env, self._policy))


def _announced_compilation() -> AbstractContextManager[None]:
    from planners.warming import logged_compilation  # most policies need no planner, and it takes long to import

    return logged_compilation()
