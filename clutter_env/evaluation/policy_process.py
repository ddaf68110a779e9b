"""A policy in a process of its own, so that it cannot reach the environment by which it is scored.

One of the observations track receives observations and public information, and answers with actions. One of the
privileged track plays in an environment of its own, and answers with the recording of the episode. What comes back is
JSON: nothing that a policy returns is executed or unpickled.
"""

from __future__ import annotations

import json
import os
import pickle
import secrets
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Mapping
from functools import cached_property
from multiprocessing.connection import Client, Connection, Listener
from typing import Any

import gymnasium as gym
import numpy as np

from clutter_env.errors import LearningError
from clutter_env.evaluation.recording import Recording
from clutter_env.evaluation.scenes import SceneSet, scene_for
from clutter_env.evaluation.score import PolicyCrashed, play_scene
from clutter_env.policies.protocol import PolicyError, PublicInfo, check_public
from clutter_env.policies.registry import PolicyTraits, load_policy


class PolicyProcess:
    """The process of a policy; itself a policy of the observations track, with `play` for the privileged one.

    Attributes:
        traits: what the policy is: its track, the environment that it wants, whether it acts by skills.
        done, failure: of the policy, after its last action.

    Raises:
        PolicyError: there is no such policy.
        PolicyCrashed: its code raised an exception.
    """

    def __init__(self, policy: str, seed: int, feasibility: str, trust: bool = False) -> None:
        # Not one of multiprocessing's own processes: those of a worker of loky's cannot start any.
        key = secrets.token_bytes(32)
        with Listener(authkey=key) as listener:
            start = f"from {__name__} import serve; serve()"
            self._process = subprocess.Popen(
                [sys.executable, "-c", start],
                stdin=subprocess.PIPE,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            )
            assert self._process.stdin is not None
            with self._process.stdin as stdin:
                stdin.write(pickle.dumps((listener.address, key, policy, seed, feasibility, trust)))
            self._connection = self._accept(listener)
        self.done, self.failure = False, ""
        self.traits = PolicyTraits(**self._receive())

    def check(self, public: PublicInfo) -> None:
        """Send the public information of the next episode."""
        self._ask("check", public)

    def reset(self, info: Mapping[str, Any]) -> None:
        """Start an episode."""
        self._ask("reset", dict(info))

    def act(self, observation: Any) -> Any:
        """The next action."""
        return self._ask("act", observation)

    @property
    def place(self) -> str:
        """The policy's class and its file."""
        return self.traits.place

    def play(self, scenes: SceneSet, index: int) -> Recording:
        """The recording of an episode of a privileged policy, in an environment of its own."""
        answer = self._ask("play", (scenes, index))
        try:
            return Recording.from_json(answer)
        except LearningError as problem:
            raise PolicyCrashed(f"{self.place} gave {problem}") from None

    def close(self) -> None:
        """End the process."""
        self._connection.close()
        self._process.kill()
        self._process.wait()

    def _accept(self, listener: Listener) -> Connection:
        """The connection to the process; a process that dies before it connects is no reason to wait for ever."""
        accepted: list[Connection] = []
        waiting = threading.Thread(target=lambda: accepted.append(listener.accept()), daemon=True)
        waiting.start()
        while waiting.is_alive() and self._process.poll() is None:
            waiting.join(0.05)
        waiting.join(0.5)
        if not accepted:
            raise PolicyCrashed(f"the policy's process ended with exit code {self._process.poll()}")
        return accepted[0]

    def _ask(self, call: str, argument: Any) -> Any:
        try:
            self._connection.send_bytes(pickle.dumps((call, argument)))
        except OSError:
            raise PolicyCrashed("the policy's process has ended") from None
        return self._receive()

    def _receive(self) -> Any:
        try:
            answer = json.loads(self._connection.recv_bytes())
        except (EOFError, OSError):
            raise PolicyCrashed(f"the policy's process ended with exit code {self._process.wait(1.0)}") from None
        if "refusal" in answer:
            raise PolicyError(answer["refusal"])
        if "crash" in answer:
            raise PolicyCrashed(answer["crash"])
        self.done, self.failure = answer["done"], answer["failure"]
        return answer["value"]


def serve() -> None:
    """Answer as the process of a policy, until the other side closes the connection."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    address, key, *policy = pickle.load(sys.stdin.buffer)
    connection = Client(address, authkey=key)
    host: _Host | None = None
    call, argument = "load", None
    while True:
        try:
            if host is None:
                host = _Host(*policy)
            value = host.answer(call, argument)
            answer = {"value": value, "done": host.is_done, "failure": host.failure}
            content = json.dumps(answer)
        except PolicyError as problem:
            content = json.dumps({"refusal": str(problem)})
        except Exception:
            content = json.dumps({"crash": traceback.format_exc()})
        try:
            connection.send_bytes(content.encode())
            call, argument = pickle.loads(connection.recv_bytes())
        except (EOFError, OSError):
            os._exit(0)  # the evaluation has ended; threads that the policy started do not keep the process alive


class _Host:
    """The policy inside its process."""

    def __init__(self, name: str, seed: int, feasibility: str, trust: bool) -> None:
        self._policy, self._feasibility = load_policy(name, seed, trust), feasibility
        self._env: gym.Env[Any, Any] | None = None
        self._env_of: Any = None

    @property
    def is_done(self) -> bool:
        return bool(getattr(self._policy, "done", False))

    @property
    def failure(self) -> str:
        return str(getattr(self._policy, "failure", ""))

    @cached_property
    def _traits(self) -> PolicyTraits:
        return PolicyTraits.of(self._policy)

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
            if action.dtype.kind not in "fiub":
                raise TypeError(f"act() returned no numbers: {action!r}")
            return action.tolist()
        return self._play(*argument).to_json()

    def _play(self, scenes: SceneSet, index: int) -> Recording:
        played = scene_for(scenes.scenes[index], self._traits.acts_by_skills, self._feasibility)
        if self._env is None or self._env_of != scenes:
            self._env, self._env_of = played.make(**self._traits.env_keywords), scenes
        return Recording.of(scenes.scenes[index], self._env, play_scene(played, self._env, self._policy))
