"""The version of this package, which is defined in `pyproject.toml` alone."""

from __future__ import annotations

import tomllib
from functools import cache
from importlib import metadata
from pathlib import Path


@cache
def version() -> str:
    """The version of the checkout that the package runs from, or of the installed distribution."""
    try:
        project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]
        if project["name"] == "clutter-env":
            return str(project["version"])
    except (OSError, ValueError, KeyError):
        pass  # an installed package has no pyproject.toml of ours next to it
    return metadata.version("clutter-env")
