"""The commands of the tutorial on imitation run with LeRobot itself, with two demonstrations and two steps."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
LEROBOT = os.environ.get("LEROBOT_PYTHON", "")
PYTHON = "venv-lerobot/bin/python"
FEWER = {
    "--episodes 100": "--episodes 2",
    "--steps=3000": "--steps=2",
    "--episodes 200": "--episodes 2",
    "--steps=3600": "--steps=2",
    "--scenes 50": "--scenes 1",
    "--eval.n_episodes=10 --eval.batch_size=10": "--eval.n_episodes=1 --eval.batch_size=1",
}


def commands() -> list[str]:
    """Those of the tutorial, but for the installation and the suite's path that stands for the reader's own."""
    text = (ROOT / "docs/tutorials/imitation.md").read_text()
    text = "".join(re.findall(r"^```sh\n(.*?)^```", text, re.DOTALL | re.MULTILINE)).replace("\\\n", " ")
    for full, short in FEWER.items():
        assert full in text, full
        text = text.replace(full, short)
    return [line for line in text.splitlines() if not re.search(r"pip install|-m venv|=?PATH/", line)]


@pytest.mark.slow
@pytest.mark.usefixtures("needs_gl")
@pytest.mark.skipif(not LEROBOT, reason="LEROBOT_PYTHON names no interpreter that has LeRobot")
def test_the_tutorial_leads_from_a_collection_to_scores(tmp_path: Path) -> None:
    lines = commands()
    assert [re.split(r"\W+", line.replace("venv-lerobot/bin/", ""))[1] for line in lines].count("train") == 2
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "HF_HOME": str(tmp_path / "hub"), "HF_HUB_OFFLINE": "1"}
    for line in lines:
        words = [word.replace(PYTHON, LEROBOT) for word in shlex.split(line)]
        if words[0] == "export":
            name, _, value = words[1].partition("=")
            environment[name] = value
            continue
        if words[0] == "clutter-env":
            words[:1] = [sys.executable, "-m", "clutter_env"]
        else:
            words[0] = str(Path(LEROBOT).with_name(Path(words[0]).name))
        done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{line}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
        if "lerobot-eval" in line:
            assert "does not have 'task_description'" not in done.stderr
            assert list((tmp_path / "outputs/lerobot/eval/videos").rglob("*.mp4"))
    for folder in ("compare", "compare-seen"):
        table = (tmp_path / "outputs" / folder / "table.md").read_text()
        assert re.search(r"lerobot:\S+/pretrained_model \| observations \| 1 × 1", table), table
