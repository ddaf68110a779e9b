"""The examples of the package and of its page run."""

import inspect
import re
import textwrap
from pathlib import Path

import pytest

import irm
from irm import Status

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "irm.md"
COARSE = "voxel=0.2, orientations=26, samples=20_000"


@pytest.mark.slow
def test_the_example_of_the_package_runs():
    names: dict = {}
    exec(inspect.getdoc(irm).split("Example:\n")[1].replace("\n    ", "\n").removeprefix("    "), names)
    assert len(names["placement"]) == 5


@pytest.mark.slow
def test_the_examples_of_the_page_run_and_give_what_they_say(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    for block in blocks:
        exec(textwrap.dedent(block), names)
    said = [
        line.split("  # ")[1].strip() for line in "".join(blocks).splitlines() if line.lstrip().startswith("print(")
    ]
    assert capsys.readouterr().out.splitlines() == said
    assert names["answer"].status is Status.YES
    assert names["many"].count.min() >= 0
    assert len(names["pick"]) == len(names["both"]) == 5
    assert isinstance(names["rank"], int)
