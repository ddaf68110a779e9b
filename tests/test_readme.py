"""The README's Python, run from top to bottom as a reader would."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
BLOCKS = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
CHECK = """
assert answer.poses.shape[1] == 3
assert Solution.load("plan.npz") == solution
"""


def run_blocks(folder: Path, **variables: str) -> str:
    """What the blocks print, run in one fresh process."""
    code = "\n".join((*BLOCKS, CHECK))
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **variables}
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, cwd=folder)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout + result.stderr


def test_every_block_runs_and_the_expert_succeeds(tmp_path: Path) -> None:
    assert "scored=True" in run_blocks(tmp_path)


@pytest.mark.slow
def test_every_block_runs_where_nothing_is_compiled_yet(tmp_path: Path) -> None:
    """Compiling takes minutes; it does not count against the planner's time limit, and the user is told."""
    printed = run_blocks(tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "kernels"), CLUTTER_ENV_CACHE=str(tmp_path / "maps"))
    assert "scored=True" in printed
    assert "compiling" in printed
