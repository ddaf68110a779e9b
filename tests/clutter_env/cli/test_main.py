"""The console command: its overview, its version, and help that appears at once."""

from __future__ import annotations

import dataclasses
import importlib
import subprocess
import sys
from importlib import metadata

import pytest

from clutter_env.cli.main import COMMANDS, main

HEAVY = ("h5py", "matplotlib", "mujoco", "numba", "planners", "scipy", "torch")
SCRIPT = """
import sys
from clutter_env.cli.main import main
try:
    main(sys.argv[1:])
except SystemExit as end:
    assert not end.code, end.code
print("heavy:", [name for name in {heavy!r} if name in sys.modules])
"""


@pytest.mark.parametrize("command", ["", "collect", "train", "compare", "table", "warmup"])
def test_help_needs_nothing_heavy(command: str) -> None:
    words = [sys.executable, "-c", SCRIPT.format(heavy=HEAVY), *filter(None, [command]), "--help"]
    result = subprocess.run(words, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert "heavy: []" in result.stdout
    assert ("--seed" if command else "warmup") in result.stdout


@pytest.mark.parametrize("command", COMMANDS)
def test_examples_in_the_help_keep_their_lines(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Those of `train` ran into one another in one paragraph."""
    with pytest.raises(SystemExit):
        main([command, "--help"])
    lines = capsys.readouterr().out.splitlines()
    text = importlib.import_module(f"clutter_env.cli.{command}").__doc__ or ""
    examples = [line.strip() for line in text.splitlines() if line.strip().startswith(f"clutter-env {command}")]
    assert examples
    assert not set(examples) - {line.strip() for line in lines}


@pytest.mark.parametrize("command", COMMANDS)
def test_all_commands_spell_an_option_alike(command: str) -> None:
    arguments = importlib.import_module(f"clutter_env.cli.{command}").Arguments
    names = {entry.name for entry in dataclasses.fields(arguments)}
    assert not names & {"output", "output_dir", "jobs", "processes", "num_workers"}


@pytest.mark.parametrize("module", ["clutter_env", "clutter_env.cli.main"])
def test_the_console_command_is_a_module_too(module: str) -> None:
    """Without a module of that name Python found none; the command's own module ended without a word."""
    result = subprocess.run([sys.executable, "-m", module, "table", "--help"], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert result.stdout.startswith("usage: clutter-env table")


def test_the_overview_lists_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    main([])
    text = capsys.readouterr().out
    assert all(f"  {name} " in text for name in COMMANDS)


def test_the_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--version"])
    assert capsys.readouterr().out == f"clutter-env {metadata.version('clutter-env')}\n"


def test_an_unknown_command_is_refused_with_the_known_ones() -> None:
    with pytest.raises(SystemExit, match=r"no command 'fly'(.|\n)*warmup"):
        main(["fly"])
