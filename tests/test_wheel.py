"""The wheel without the repository: the console command, and a scene, strategy and task planner of one's own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An interpreter in which the wheel is installed; the dependencies are those of this interpreter."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    ignored = shutil.ignore_patterns(".git", ".venv", "outputs", "__pycache__", "*.egg-info", "build")
    shutil.copytree(ROOT, source, ignore=ignored)
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(folder), str(source)]
    subprocess.run(build, check=True)
    venv.create(folder / "venv", with_pip=False, symlinks=True)
    found = folder / "venv" / "bin" / "python"
    site = Path(
        subprocess.check_output([found, "-c", "import site; print(site.getsitepackages()[0])"], text=True).strip()
    )
    wheel = next(folder.glob("*.whl"))
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(site), str(wheel)], check=True
    )
    dependencies = Path(pytest.__file__).resolve().parents[1]
    (site / "dependencies.pth").write_text(f"{dependencies}\n")
    return found


def run(command: list[str | Path], folder: Path) -> str:
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    result = subprocess.run(command, capture_output=True, text=True, cwd=folder, env=environment)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


def test_own_scene_strategy_and_task_planner(python: Path, tmp_path: Path) -> None:
    script = Path(shutil.copy(EXAMPLES / "own_scene.py", tmp_path))
    where = run([python, "-c", "import planners; print(planners.__file__)"], tmp_path)
    assert not where.startswith(str(ROOT))
    printed = run([python, script], tmp_path)
    assert "made by strategy 'nearest'" in printed
    assert "TaskPlan(actions=" in printed
    assert "Clearances: 1" in printed
    assert "finished=True" in printed
    assert (tmp_path / "plan.npz").stat().st_size > 0
    assert (tmp_path / "plan.png").stat().st_size > 0


@pytest.mark.parametrize(
    ("script", "says"),
    [
        ("run_expert.py", "success: True"),
        ("collect.py", "seed 4"),
        ("evaluate.py", "greedy"),
        ("clone.py", "success of the clone: "),
    ],
)
def test_the_examples_run_outside_the_repository(python: Path, tmp_path: Path, script: str, says: str) -> None:
    assert says in run([python, shutil.copy(EXAMPLES / script, tmp_path)], tmp_path)


def test_a_robot_of_the_users_own_solves_an_episode(python: Path, tmp_path: Path) -> None:
    shutil.copytree(EXAMPLES / "own_robot", tmp_path, dirs_exist_ok=True)
    printed = run([python, "ur5e_mobile.py"], tmp_path)
    assert "solved" in printed


def test_scripts_and_tests_are_not_installed(python: Path, tmp_path: Path) -> None:
    listed = run([python, "-c", "import clutter_env, os; print(os.listdir(clutter_env.__path__[0] + '/..'))"], tmp_path)
    assert "'clutter_env'" in listed
    assert "'scripts'" not in listed
    assert "'tests'" not in listed
    assert "episode" in run([python, "-m", "clutter_env", "--help"], tmp_path)
