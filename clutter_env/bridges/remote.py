"""An environment that needs other versions of its libraries: it runs in a process of another Python environment."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

from clutter_env.errors import ClutterEnvError

WORKERS = Path(__file__).parent / "workers"


class BridgeError(ClutterEnvError):
    """Somebody's environment cannot be used: it cannot be started, has raised something, or asks for the impossible."""


class Remote:
    """A worker script of `workers/` in another interpreter; calls and answers are JSON objects, one a line.

    Example:
        with Remote("venv-kinder/bin/python", "kinder_worker.py") as kinder:
            print(kinder("reset", id="kinder/PickPlace3D-o1-v0", seed=0)["goal"])
    """

    def __init__(self, python: str | Path, worker: str) -> None:
        """Start it; raises `BridgeError` if the interpreter is not there."""
        self._name = f"{python} {worker}"
        try:
            self._process = subprocess.Popen(
                [str(python), str(WORKERS / worker)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
        except OSError as problem:
            raise BridgeError(f"{self._name} cannot be started: {problem}") from problem

    def __call__(self, call: str, **arguments: Any) -> dict[str, Any]:
        """Call a method of the worker.

        Raises:
            BridgeError: it raised something, or it has ended.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(json.dumps({"call": call, **arguments}) + "\n")
            self._process.stdin.flush()
            line = self._process.stdout.readline()
        except BrokenPipeError:
            line = ""
        if not line:
            raise BridgeError(f"{self._name} has ended with code {self._process.wait()}: run it by hand to see why")
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise BridgeError(f"{self._name}: {answer['error']}")
        return answer

    def close(self) -> None:
        """End the worker."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        self._process.wait()

    def __enter__(self) -> Remote:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
