"""The notebooks are the tutorials, whose Python `test_docs.py` runs and whose commands it reads."""

from __future__ import annotations

import json

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
