"""Models of robots made for a bridge, kept as files: a `RobotSpec` names the file of its MJCF."""

from __future__ import annotations

import hashlib
from pathlib import Path

from irm import cache_folder


def kept_mjcf(name: str, mjcf: str) -> Path:
    """A file in `irm.cache_folder` with this text. Its name has the given beginning and depends on the text."""
    folder = cache_folder()
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{name}-{hashlib.sha256(mjcf.encode()).hexdigest()[:16]}.xml"
    file.write_text(mjcf, encoding="utf-8")
    return file
