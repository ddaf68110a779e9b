"""The suites in vla-eval, by the commands of the page: with VLA_EVAL_PYTHON, an interpreter that has both packages."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PYTHON = os.environ.get("VLA_EVAL_PYTHON", "")


def test_the_page_shows_the_configuration_of_the_example() -> None:
    text = (ROOT / "examples" / "vla_eval.yaml").read_text()
    assert text in (ROOT / "docs" / "guides" / "vla_eval.md").read_text()


@pytest.mark.slow
@pytest.mark.skipif(not PYTHON, reason="VLA_EVAL_PYTHON names no interpreter")
@pytest.mark.parametrize(("name", "said"), [("model", "Pick up the object 01."), ("policy", "mean success: 1.0")])
def test_the_examples_run(name: str, said: str, tmp_path: Path) -> None:
    command = [PYTHON, str(ROOT / "examples" / f"vla_eval_{name}.py")]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    ended = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    assert said in ended.stdout
