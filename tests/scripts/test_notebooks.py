"""The notebooks are the tutorials, whose Python `test_docs.py` runs and whose commands it reads."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from scripts.notebooks import ROOT, TUTORIALS, notebook


@pytest.mark.parametrize("name", TUTORIALS)
def test_a_notebook_is_its_tutorial(name: str) -> None:
    """`python scripts/notebooks.py` makes them anew."""
    content = json.loads((ROOT / "docs/notebooks" / f"{name}.ipynb").read_text(encoding="utf-8"))
    assert content == notebook(TUTORIALS[name])
    tutorial = (ROOT / "docs/tutorials" / f"{TUTORIALS[name]}.md").read_text(encoding="utf-8")
    for cell in content["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "code" and source[0] not in "!%":
            compile(source, name, "exec")
            assert source in tutorial
        assert "](../" not in source
        assert "my_module" not in source or cell["cell_type"] == "markdown"


SHORTER = {"--episodes 20": "--episodes 2", "--steps 6000": "--steps 400", "--checkpoint-every 2000": ""}
SHORTER |= {"--scenes 20": "--scenes 1", "--scenes 10": "--scenes 1", "--scenes 5": "--scenes 1"}
"""Commands that take minutes, and what takes their place in the test."""


@pytest.mark.slow
@pytest.mark.parametrize("name", TUTORIALS)
def test_the_cells_of_a_notebook_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In their order, but for the first, which installs."""
    for needed in ("torch", "h5py"):
        pytest.importorskip(needed)
    (tmp_path / "clutter-env").write_text(
        f"#!/bin/sh\nexec {sys.executable} -c 'from clutter_env.cli.main import main; main()' \"$@\"\n"
    )
    (tmp_path / "clutter-env").chmod(0o755)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    path = os.pathsep.join((str(tmp_path), str(Path(sys.executable).parent), os.environ["PATH"]))
    environment = {**os.environ, "PATH": path, "PYTHONPATH": str(ROOT)}
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "__main__"}
    install, *others = (
        "".join(cell["source"]) for cell in notebook(TUTORIALS[name])["cells"] if cell["cell_type"] == "code"
    )
    assert install.startswith("%pip install")
    for source in others:
        if not source.startswith("!"):
            exec(compile(source, name, "exec"), names)
            continue
        for long, short in (SHORTER | {"python clone.py": "python examples/clone.py"}).items():
            source = source.replace(long, short)
        for line in source.splitlines():
            if "curl" not in line:
                subprocess.run(line.removeprefix("!"), shell=True, env=environment, check=True)
