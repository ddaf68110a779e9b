"""The README's Python, run from top to bottom as a reader would."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
CHECK = """
from pathlib import Path

assert answer.poses.shape[1] == 3
assert Path("episode.html").stat().st_size > 20_000
env.close()
"""

README = (ROOT / "README.md").read_text()
URL = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["urls"]["Homepage"]
"""The one place that says where the project lives."""
BLOCKS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


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


def test_links_are_absolute_and_lead_to_files_of_the_project() -> None:
    """On a package index a relative link leads nowhere."""
    links = re.findall(r"\]\(([^)\s]+)\)", README)
    assert len(links) > 10
    for link in links:
        kind, _, rest = link.removeprefix(f"{URL}/").partition("/main/")
        file, _, anchor = rest.partition("#")
        assert kind == ("raw" if file.endswith((".png", ".gif")) else "blob"), link
        assert (ROOT / file).is_file(), link
        headings = re.findall(r"^#+ (.*)$", (ROOT / file).read_text(), re.MULTILINE) if anchor else []
        assert anchor in ("", *(heading.lower().replace(" ", "-") for heading in headings)), link


def test_figures_are_those_of_the_pages() -> None:
    """What README says of learned policies and of physics stands in the pages that it names."""
    results = (ROOT / "docs" / "learning_results.md").read_text()
    rows = re.findall(r"^\|[^|\n]*`([\w-]+)`[^|\n]*\|[^|\n]*\| ([^|\n]+) \| ([^|\n]+) \|$", README, re.MULTILINE)
    assert [name for name, _, _ in rows] == ["lookahead", "keyframes", "greedy", "bulldozer"]
    for name, clean, lifted in rows:
        assert re.search(rf"^\| `{name}` \|[^|]*\|[^|]*\| {re.escape(clean)} \| {lifted} \|", results, re.MULTILINE), (
            name
        )
    table = (ROOT / "docs" / "clearance_table.md").read_text()
    cleared = re.findall(r"^\| (\d+) \| (\d+) \| ([\d.]+) \| (.*solves.*) \|$", README, re.MULTILINE)
    assert len(cleared) >= 3
    for objects, scenes, floor, cells in cleared:
        means = r"[^|]*\| ".join(re.escape(cell.split(",")[0]) + " " for cell in cells.split(" | "))
        assert re.search(rf"^\| {objects} \| {scenes} \| {floor} \| {means}", table, re.MULTILINE), objects
    planned = (ROOT / "docs" / "planners.md").read_text()
    said = " ".join(README.split())
    for words, command in (
        ("in 50 of 50 scenes with 15 objects", "| `--objects 15 --grasps side` | 50 of 50 |"),
        ("in 50 of 50 with 40", "| `--objects 40 --grasps side` | 50 of 50 |"),
        ('"ee" control in 50 of 50', "| `--objects 15 --grasps side --control-mode ee` | 50 of 50 |"),
        ("and in 49 of 50 of an earlier run", "`--objects 15 --grasps side --control-mode ee --seed 2200000` 49 of 50"),
    ):
        assert words in said
        assert command in planned


def test_the_project_has_one_address() -> None:
    files = (ROOT / name for name in ("README.md", "CITATION.cff", "mkdocs.yml", "CHANGELOG.md", "CONTRIBUTING.md"))
    for page in (*files, *(ROOT / "docs").rglob("*.md")):
        for address in re.findall(r"https://github\.com/clutter-env[^\s)\"'`]*", page.read_text()):
            assert address == URL or address.startswith(f"{URL}/"), (page.name, address)
