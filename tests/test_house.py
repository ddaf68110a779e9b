"""What may import what, checked in fresh processes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
GL = ("OpenGL", "OpenGL.GL", "mujoco.egl", "mujoco.osmesa")
LEARNING = ("torch", "stable_baselines3", "ray", "minari")
CASES = [
    ("assets", ("mujoco", "gymnasium", "numba", *LEARNING)),
    ("irm", ("gymnasium", *GL, *LEARNING)),
    ("planners", ("gymnasium", *GL, *LEARNING)),
    ("clutter_env", ("numba", "planners", "irm", *GL, *LEARNING)),
    ("clutter_env.envs.retrieve", ("numba", "planners", "irm", *GL, *LEARNING)),
    ("clutter_env.envs.goal", ("numba", "planners", "irm", *GL, *LEARNING)),
]


@pytest.mark.parametrize(("package", "banned"), CASES, ids=[case[0] for case in CASES])
def test_imports_stay_small(package: str, banned: tuple[str, ...]) -> None:
    code = f"import sys, {package}; print(sorted(set({banned!r}) & set(sys.modules)))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == "[]"


def test_import_contracts_hold() -> None:
    pytest.importorskip("importlinter")
    command = [sys.executable, "-c", "import sys; from importlinter.cli import lint_imports_command as run; run()"]
    result = subprocess.run([*command, "--no-cache"], capture_output=True, text=True, cwd=ROOT)
    assert result.returncode == 0, result.stdout + result.stderr
