"""The examples of the package and of its page run."""

import inspect
import re
import textwrap
from pathlib import Path

import numpy as np

import irm
from irm import Status

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "irm.md"
COARSE = "voxel=0.2, orientations=26, samples=20_000"


def test_the_example_of_the_package_runs():
    names: dict = {}
    exec(inspect.getdoc(irm).split("Example:\n")[1].replace("\n    ", "\n").removeprefix("    "), names)
    assert len(names["placement"]) == 5


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


def test_the_examples_of_other_arms_and_maps_run(tmp_path, monkeypatch, capsys):
    """With a coarse map instead of the one of five centimetres, and a table of one pose."""
    arm, foreign = re.findall(r"```py\n(.*?)```", PAGE.read_text(), re.DOTALL)
    names: dict = {}
    monkeypatch.chdir(ROOT)
    exec(arm.replace("progress=tqdm", COARSE), names)
    assert capsys.readouterr().out == "[2 0]\n"
    assert len(names["bases"]) == 5
    monkeypatch.chdir(tmp_path)
    np.save("robocare_right_reachability_map.npy", [[0.4, 0.1, 0.8, 0, 0, 0, -90, 90, 15, 0.1, 0.0]])
    exec(foreign, names)
    assert len(names["bases"].query((0.0, 0.0, 0.8))) == 1
