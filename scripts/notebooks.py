"""Make the notebooks of docs/notebooks from the tutorials: the same text and code, ready for Colab without a GPU.

    python scripts/notebooks.py

Python blocks become cells, and so do commands, each line with "!", but for those with files of the reader's own. What a
block prints is left out: the notebook prints it. The first cell installs the package, in place of the tutorial's own
lines about that.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
TUTORIALS = {
    "first_episode": "quickstart",
    "plan_and_goals": "planning",
    "train_and_compare": "learning",
    "base_placement": "base_placement",
    "find_hidden_target": "search",
}
"""Notebooks by name, and the tutorials that they are made of."""
REPOSITORY = "https://github.com/clutter-env/clutter-env"
_RAW = "https://raw.githubusercontent.com/clutter-env/clutter-env/main"
_OWN = "my_"
"""In the names of files of the reader's own, which a notebook does not have."""
_INSTALL = f'%pip install --quiet "clutter-env[all] @ git+{REPOSITORY}"'
_BLOCK = re.compile(r"^```(\w+)\n(.*?)^```\n", re.DOTALL | re.MULTILINE)


def notebook(tutorial: str) -> dict[str, Any]:
    """The notebook of a page of docs/tutorials, in Jupyter's format 4.5."""
    text = (ROOT / "docs/tutorials" / f"{tutorial}.md").read_text(encoding="utf-8")
    text = re.sub(r"^## Install\n.*?(?=^## )", "", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"^pip install -c constraints\.txt .*\n", "", text, flags=re.MULTILINE)
    cells, at = [("code", _INSTALL)], 0
    for block in _BLOCK.finditer(text):
        cells.append(("markdown", _with_addresses(text[at : block.start()])))
        language, content = block.groups()
        if _OWN in content:
            cells.append(("markdown", block.group()))
        elif language == "sh":
            content = re.sub(
                r"^python examples/(\S+)", rf"curl -sO {_RAW}/examples/\1\npython \1", content, flags=re.MULTILINE
            )
            cells.append(("code", re.sub(r"^(?=\S)", "!", content, flags=re.MULTILINE)))
        elif language == "python":
            cells.append(("code", content))
        at = block.end()
    cells.append(("markdown", _with_addresses(text[at:])))
    shown = [(kind, source.strip()) for kind, source in cells if source.strip()]
    return {
        "cells": [
            {"cell_type": kind, "id": f"cell-{number}", "metadata": {}, "source": source.splitlines(keepends=True)}
            | ({"execution_count": None, "outputs": []} if kind == "code" else {})
            for number, (kind, source) in enumerate(shown)
        ],
        "metadata": {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}},
        "nbformat": 4,
        "nbformat_minor": 5,
    }


def _with_addresses(text: str) -> str:
    """The text with links to other pages, and images, as addresses of the repository."""
    text = text.replace("](../images/", f"]({_RAW}/docs/images/")
    return re.sub(
        r"\]\((?!https?:|#)(\.\./)?", lambda at: f"]({REPOSITORY}/blob/main/docs/{'' if at[1] else 'tutorials/'}", text
    )


def main() -> None:
    """Write all notebooks."""
    for name, tutorial in TUTORIALS.items():
        file = ROOT / "docs/notebooks" / f"{name}.ipynb"
        file.parent.mkdir(exist_ok=True)
        file.write_text(json.dumps(notebook(tutorial), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
