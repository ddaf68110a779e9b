"""The scripts about the environments run, print and save what they say."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]


def run(script: str, *arguments: str) -> str:
    command = [sys.executable, str(ROOT / "scripts" / script), *arguments]
    result = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_benchmark_prints_plots_and_saves(tmp_path) -> None:
    plot, data = tmp_path / "plot.png", tmp_path / "data.json"
    text = run("benchmark.py", "--objects", "1", "3", "--steps", "20", "--out", str(plot), "--json", str(data))
    assert "| 3 |" in text
    assert plot.stat().st_size > 1000
    rows = json.loads(data.read_text())["rows"]
    assert [row["objects"] for row in rows] == [1, 3]
    assert all(row["steps_per_s"] > 0 for row in rows)


def test_soak_counts_its_steps(tmp_path) -> None:
    data = tmp_path / "soak.json"
    text = run("soak.py", "--steps", "520", "--json", str(data))
    assert "steps" in text
    assert json.loads(data.read_text())["steps"] >= 520


def test_help_is_there() -> None:
    for script in ("benchmark.py", "soak.py", "layout_pictures.py"):
        assert "--seed" in run(script, "--help")
