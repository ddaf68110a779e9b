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
SCRIPT = ROOT / "examples" / "own_scene.py"
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


def test_the_script_is_short() -> None:
    assert len(SCRIPT.read_text().splitlines()) < 40


def test_own_scene_strategy_and_task_planner(python: Path, tmp_path: Path) -> None:
    script = Path(shutil.copy(SCRIPT, tmp_path))
    where = run([python, "-c", "import planners; print(planners.__file__)"], tmp_path)
    assert not where.startswith(str(ROOT))
    printed = run([python, script], tmp_path)
    assert "made by strategy 'nearest'" in printed
    assert "engine='astar'" in printed
    assert "finished=True" in printed
    assert (tmp_path / "plan.npz").stat().st_size > 0
    assert (tmp_path / "plan.png").stat().st_size > 0


def test_the_console_command_works(python: Path, tmp_path: Path) -> None:
    printed = run([python, "-c", "from clutter_env.cli.main import main; main(['--help'])"], tmp_path)
    assert "episode" in printed
    assert (python.parent.parent / "lib").exists()
