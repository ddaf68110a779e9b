"""An environment that needs other versions of its libraries: it runs in a process of another Python environment."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from pathlib import Path
from typing import Any

from clutter_env.errors import ClutterEnvError

WORKERS = Path(__file__).parent / "workers"
_LINES = 40
"""Last lines of what a worker that has ended wrote to standard error that its user is told."""


class BridgeError(ClutterEnvError):
    """Somebody's environment cannot be used: it cannot be started, has raised something, or asks for the impossible."""


def _without_our_packages() -> dict[str, str]:
    """The environment variables, without those that would make another interpreter import this one's packages."""
    return {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME")}


class Remote:
    """The `Worker` of a file of `workers/` in another interpreter. See `workers/answer.py`.

    Example:
        with Remote("venv-kinder/bin/python", "kinder_worker.py") as kinder:
            print(kinder("reset", id="kinder/PickPlace3D-o1-v0", seed=0)["goal"])
    """

    def __init__(self, python: str | Path, worker: str) -> None:
        """Start it. Raises `BridgeError` if the interpreter is not there."""
        self._name = f"{python} {worker}"
        self._errors = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")  # noqa: SIM115  until `close`
        try:
            self._process = subprocess.Popen(
                [str(python), str(WORKERS / "answer.py"), str(WORKERS / worker)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                text=True,
                env=_without_our_packages(),
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
            code = self._process.wait()
            self._errors.seek(0)
            said = "\n".join(self._errors.read().splitlines()[-_LINES:])
            raise BridgeError(
                f"{self._name} has ended with code {code}:\n{said or 'it wrote nothing to standard error'}"
            )
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise BridgeError(f"{self._name}: {answer['error']}")
        return answer

    def close(self) -> None:
        """End the worker."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        self._process.wait()
        self._errors.close()

    def __enter__(self) -> Remote:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
