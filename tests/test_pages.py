"""Every page of the documentation: its Python runs, its commands can be read, and the site has it."""

from __future__ import annotations

import importlib
import importlib.util
import os
import pkgutil
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import tyro

import clutter_env.cli
from clutter_env.cli.main import COMMANDS, main

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = {str(path.relative_to(ROOT)): path.read_text() for path in (ROOT / "README.md", *sorted(DOCS.rglob("*.md")))}
RUN_ELSEWHERE = {
    "README.md": "test_readme.py",
    "docs/add_a_robot.md": "test_docs.py",
    "docs/environments/pick.md": "test_docs.py",
    "docs/environments/reach.md": "test_docs.py",
    "docs/environments/skill.md": "test_docs.py",
    "docs/extend.md": "test_docs.py",
    "docs/irm.md": "irm/test_examples.py",
    "docs/planners.md": "planners/test_page.py",
    "docs/your_own_scene.md": "test_your_own_scene.py",
}
"""Pages whose Python is run, and checked more closely, by another test."""


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", PAGES[page], re.DOTALL | re.MULTILINE)


def runs_here(page: str) -> bool:
    return page not in RUN_ELSEWHERE and bool(blocks(page, "python"))


def run_page(page: str, folder: Path) -> None:
    code = "\n".join(blocks(page, "python"))
    code = f"if __name__ == '__main__':\n{'    '.join(('', *code.splitlines(keepends=True)))}"
    script = folder / "page.py"
    script.write_text(code)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    result = subprocess.run([sys.executable, script], capture_output=True, text=True, env=environment, cwd=folder)
    assert result.returncode == 0, result.stdout + result.stderr


@pytest.mark.parametrize("page", [page for page in PAGES if runs_here(page) and page != "docs/learning.md"])
def test_the_python_of_a_page_runs_from_top_to_bottom(page: str, tmp_path: Path) -> None:
    run_page(page, tmp_path)


@pytest.mark.slow
def test_the_python_of_the_learning_page_runs_after_its_collection(tmp_path: Path) -> None:
    """With one episode in place of two hundred."""
    collect = next(
        line for block in blocks("docs/learning.md", "sh") for line in block.splitlines() if "collect" in line
    )
    words = shlex.split(collect.replace("--episodes 200", "--episodes 1"))
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", "from clutter_env.cli.main import main; main()", *words[1:]]
    subprocess.run(command, check=True, cwd=tmp_path, env=environment)
    run_page("docs/learning.md", tmp_path)


def test_pages_that_are_run_elsewhere_are_read_there() -> None:
    for page, test in RUN_ELSEWHERE.items():
        assert Path(page).stem in (ROOT / "tests" / test).read_text(), (page, test)


def commands(page: str) -> Iterator[list[str]]:
    """The package's own commands in the shell blocks of a page, without comments."""
    for block in blocks(page, "sh"):
        for line in block.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            if words[:1] == ["nice"]:
                words = words[1:]
            if words[:1] == ["clutter-env"] or (words[:1] == ["python"] and words[1][:1] != "-"):
                yield words


@pytest.fixture
def only_read(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Commands read their arguments and do nothing else; what they read is collected."""
    read: list[Any] = []

    def read_arguments(_name: str, arguments: Any, _function: Any, _text: Any, words: Any = None) -> None:
        read.append(tyro.cli(arguments, args=words))

    for module in pkgutil.walk_packages(clutter_env.cli.__path__, "clutter_env.cli."):
        loaded = importlib.import_module(module.name)
        if hasattr(loaded, "run_command"):
            monkeypatch.setattr(loaded, "run_command", read_arguments)
    return read


@pytest.mark.parametrize("page", [page for page in PAGES if any(commands(page))])
def test_the_commands_of_a_page_can_be_read(page: str, only_read: list[Any]) -> None:
    """Their names and arguments are valid; scripts are the commands of the same name."""
    for words in commands(page):
        before = len(only_read)
        if words[0] == "python":
            spec = importlib.util.spec_from_file_location("script", ROOT / words[1])
            assert spec is not None
            assert spec.loader is not None
            script = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(script)
            script.main(words[2:])
        elif words[1:] and words[1] in COMMANDS and "--help" not in words:
            main(words[1:])
        else:
            assert words[1] in ("--help", "--version", "COMMAND") or words[2:] == ["--help"], words
            continue
        assert len(only_read) == before + 1, words


def test_every_page_is_in_the_sites_contents() -> None:
    contents = set(re.findall(r": ([\w/]+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE))
    assert contents == {str(path.relative_to(DOCS)) for path in DOCS.rglob("*.md")}


@pytest.mark.parametrize("page", PAGES)
def test_every_link_to_a_file_of_the_project_resolves(page: str) -> None:
    for link in re.findall(r"\]\((?!https?:|mailto:|#)([^)#\s]+)", PAGES[page]):
        assert ((ROOT / page).parent / link).is_file(), link
