"""Models of robots made for a bridge, kept as files: a `RobotSpec` names the file of its MJCF."""

from __future__ import annotations

import hashlib
from pathlib import Path

import platformdirs


def kept_mjcf(name: str, mjcf: str) -> Path:
    """A file in the user's cache with this text; its name begins as said and depends on the text."""
    folder = Path(platformdirs.user_cache_dir("clutter-env"))
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{name}-{hashlib.sha256(mjcf.encode()).hexdigest()[:16]}.xml"
    file.write_text(mjcf, encoding="utf-8")
    return file
