"""Replay of an episode in a new process: `python -m clutter_env.learning.demonstrations.replay FILE` prints JSON."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

from clutter_env.learning.demonstrations.episode import ReplayResult, replay
from clutter_env.learning.demonstrations.episode_file import read_episode
from clutter_env.learning.errors import LearningError

__all__ = ["replay_in_fresh_process"]


def replay_in_fresh_process(path: Path) -> ReplayResult:
    """Replay the file of an episode in a new Python process.

    Raises:
        LearningError: that process failed; the message ends with its last output.
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(part for part in sys.path if part)}
    command = [sys.executable, "-m", "clutter_env.learning.demonstrations.replay", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    if done.returncode != 0:
        raise LearningError(f"replaying {path} ended with status {done.returncode}: {done.stderr.strip()[-500:]}")
    return ReplayResult(**json.loads(done.stdout.splitlines()[-1]))


if __name__ == "__main__":
    print(json.dumps(asdict(replay(read_episode(Path(sys.argv[1]))))))
