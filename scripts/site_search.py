"""Weights of the documentation's search: what a reader tries first is found first.

`mkdocs.yml` names this file as a hook. The weights are those of mkdocs-material's `search: boost`. They stand here, and
not at the top of each page, so that the pages read the same in a clone.
"""

from __future__ import annotations

from typing import Any

BOOSTS = {
    "tutorials/": 8.0,
    "train_your_own.md": 4.0,
    "add_a_robot.md": 8.0,
    "guides/troubleshooting.md": 4.0,
    "api/": 0.5,
    "notes/": 0.2,
}
"""By the beginning of a page's path. Other pages have 1."""


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Give the page its weight, and leave its text as it is."""
    page.meta.setdefault("search", {}).setdefault("boost", boost_of(page.file.src_uri))
    return markdown


def boost_of(path: str) -> float:
    """The weight of a page of docs/."""
    return next((boost for start, boost in BOOSTS.items() if path.startswith(start)), 1.0)
