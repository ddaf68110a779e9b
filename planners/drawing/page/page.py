"""Writes a recording as one HTML file: template, style and scripts of this folder, and the content."""

from __future__ import annotations

import html
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path

from planners.drawing.page.content import page_text
from planners.expert.report import Recording

__all__ = ["episode_title", "page_html", "write_page"]

_SCRIPTS = (
    "matrix.js",
    "shapes.js",
    "renderer.js",
    "data.js",
    "marks.js",
    "scene.js",
    "camera.js",
    "timeline.js",
    "panel.js",
    "page.js",
)


def write_page(path: Path, recording: Recording, rows: Mapping[str, str], result: str = "", title: str = "") -> None:
    """Write a page.

    Args:
        path: the file; it is replaced if it exists.
        recording: what is shown.
        rows: the report, names and values.
        result: as for `page_text`.
        title: of the page; made from the recording if not given.

    Raises:
        OSError: the file cannot be written.
    """
    title = title or episode_title(recording)
    path.write_text(page_html(title, page_text(recording, title, rows, result)), encoding="utf-8")


def episode_title(recording: Recording) -> str:
    """Such as "object_03 out of 15 objects"."""
    return f"{recording.target} out of {len(recording.objects)} objects"


def page_html(title: str, content: str, address: str = "") -> str:
    """The page.

    Args:
        title: of the window.
        content: JSON text as from `ArrayBlock.text`.
        address: of the events of a running episode, on the server that the page comes from; "" for none.
    """
    folder = files(__package__) / "static"
    scripts = "\n".join((folder / name).read_text(encoding="utf-8") for name in _SCRIPTS)
    parts = {
        "TITLE": html.escape(title),
        "ADDRESS": html.escape(address),
        "CONNECT": "'self'" if address else "'none'",
        "STYLE": (folder / "page.css").read_text(encoding="utf-8"),
        "SCRIPT": scripts,
        "CONTENT": content,
    }
    text = (folder / "page.html").read_text(encoding="utf-8")
    for name, part in parts.items():
        text = text.replace(f"@{name}@", part)
    return text
